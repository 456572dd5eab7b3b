"""Which effects explain the gap: screening, forward selection, cross-validation."""

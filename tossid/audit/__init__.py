"""Checks of the diagnosis on cases whose effect is withheld from it."""

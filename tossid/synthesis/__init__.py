"""Tosses and films that are made, with their truth."""

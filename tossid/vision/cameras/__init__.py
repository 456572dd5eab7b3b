"""Cameras: projection, lenses, shutters, rigs."""

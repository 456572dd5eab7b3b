"""Experiments on simulated tosses, whose truth is known."""

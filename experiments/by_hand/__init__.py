"""Recordings analysed by hand: fits to stretches of flight, without a simulator and without the diagnosis."""

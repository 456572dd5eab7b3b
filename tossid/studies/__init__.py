"""Studies: a training and its evaluation for each model, each value of a setting and each seed.

`cells` has what is computed, how, and where it is kept. `study` runs it. `result` is what comes back, with its tables
(`tables`) and figures.
"""

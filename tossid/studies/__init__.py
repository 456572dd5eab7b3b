"""Studies: a training and its evaluation for each model, each value of a setting and each seed.

`cells` has what is computed and how. `kept` has its folder, from which an interrupted study goes on. `study` runs it.
`result` is what comes back, with its tables (`tables`) and figures (`figures`).
"""

"""Evaluation: rollouts beside measured tosses, exports beside MuJoCo's rollouts, and the statistics of studies."""

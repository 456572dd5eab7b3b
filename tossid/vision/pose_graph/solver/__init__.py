"""The least squares of a pose graph: damped Gauss-Newton steps, and covariances at the minimum."""

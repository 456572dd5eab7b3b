"""How likely recorded tosses are under a simulator: windows, residuals, whitening, fits."""

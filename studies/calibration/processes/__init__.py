"""Gaussian processes of residuals over the parameters."""

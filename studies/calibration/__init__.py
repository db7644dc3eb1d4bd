"""Calibration: screened on a surrogate and polished on the physical model, or adaptive on it alone."""

"""How sure a calibration is: identifiability, noise, a posterior sample corrected by the physical model, bands."""

"""How sure a calibration is: noise, identifiability, and a posterior sample that the model has simulated."""

"""How sure a calibration is: noise, identifiability, and a posterior sample that the model has simulated.

Residuals are seen as a first-order autoregressive process, whose variance and correlation follow from the
residuals themselves (noise.py). Slopes of the residuals at the calibrated point give linearised intervals,
and directions without slope give the parameters that compensate each other (identifiability.py). A
posterior is sampled by tempered particles (annealing.py, sample.py), on state equations where they are
known, else on a Gaussian process of the residuals (density.py). The model then simulates a part of the
sample, and the process learns from that, until the sample's weights agree with the model (assess.py). Bands
of the outputs are quantiles of these simulations, with the noise for a measurement (bands.py). findings.py
puts it into classes that readers know.
"""

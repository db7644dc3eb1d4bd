"""Gaussian processes of residuals over the parameters.

A process predicts the vector of all residuals at a point: a mean, and a variance that all residuals share
but for their amplitudes. Its kernel (kernel.py) is a Gaussian bump, a line and a constant over linear and
logarithmic coordinates (`Features`). Lengths, slope and noise are the most probable ones by the likelihood
of the simulations and a prior. Residuals enter as coordinates in a basis of the simulations (process.py).
`ProcessGroups` has one process for the leading principal components and one for the others, per experiment
with parameters of its own. It expands the expected mean square of the residuals to second order around a
point. `PosteriorSample` draws functions that agree with the simulations.
"""

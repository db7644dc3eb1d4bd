"""Calibration: which parameters fit a measurement best, and how sure that is.

A `CalibrationProblem` (problem.py) poses a model, a measurement and what is known beforehand (prior.py) in
the unit cube. A `Recorder` asks it and counts. The paper's method stands at the door: screen.py searches
all of the bounds on a surrogate, polish.py or another optimizer (optimizers.py) goes on from there on the
physical model, two_phase.py joins them, and ledger.py says what each part has cost. `search` needs no
surrogate; `processes`, `state_equations` and `hidden_network` say where a low error is expected.
`uncertainty` says how sure a calibrated point is, sobol.py which parameters the outputs depend on. Of our
packages, this one imports `simulation` alone.
"""

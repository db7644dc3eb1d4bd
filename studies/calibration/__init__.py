"""Calibration: screen a model over the whole box, polish on the physical model."""

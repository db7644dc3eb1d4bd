"""What we ask of both: studies, tracking, calibration, reports, and the command line."""

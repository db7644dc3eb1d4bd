"""What is there: studies, trials, calibrations, row sets, found by name and told on the terminal."""

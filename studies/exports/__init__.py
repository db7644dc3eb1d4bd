"""What a study found, in files that simulators and other programs read."""

"""How a physical model answers: cases, FMUs, designs, trajectories."""

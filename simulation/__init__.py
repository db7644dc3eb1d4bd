"""How a physical model answers: cases, FMUs, designs, trajectories."""

import sys

if sys.platform != "linux":
    raise ImportError("simulations need Linux, for their locks, shared memory and processes; use a container")

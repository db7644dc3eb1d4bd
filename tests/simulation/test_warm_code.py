"""A process that is told what another had compiled has it in memory before it needs it."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from simulation.case import load_case
from simulation.workers.warm_code import learnt

ROOT = Path(__file__).parents[2]
TOLD = """
import sys
from simulation.workers import warm_code
warm_code.remember(sys.stdin.buffer.read())
print("simulation.fmi.fmu" in sys.modules, sum(bool(loop.signatures) for _, _, loop in warm_code._loops()))
"""


def test_what_one_process_compiled_the_next_has_at_once(decay_case: Path):
    with load_case(decay_case).open_model() as model:
        model.simulate(np.array([[1e-4, 0.0]]))
    done = subprocess.run(
        [sys.executable, "-c", TOLD],
        input=learnt(),
        capture_output=True,
        check=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    imported, n_compiled = done.stdout.split()
    assert imported == b"True"
    assert int(n_compiled) >= 1

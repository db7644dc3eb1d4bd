"""ModestPy 0.1.1 (Arendt, Jradi, Wetter and Veje, American Modelica Conference 2018) in its own environment.

Its packages must be older than this project's, so it runs beside it and asks for every simulation:

    python -m venv modestpy
    modestpy/bin/pip install 'numpy<2' 'pandas<2' 'pyDOE<0.9' scipy matplotlib fmpy modestga
    modestpy/bin/pip install --no-deps modestpy
    MODESTPY_PYTHON=modestpy/bin/python python tests/benchmarks/fewest_calls --methods modestpy
"""

import json
import os
import subprocess
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np

from fewest_calls.counted import Asked
from studies.calibration.problem import CalibrationProblem

PYTHON = "MODESTPY_PYTHON"
SIDE = Path(__file__).with_name("modestpy_side.py")
# Of what it offers this needed fewest calls (office, wall, slab, oscillator; other seeds): its default, 1,500
# genetic calls and a pattern search, shorter ones of that kind, and L-BFGS-B need several times as many.
OPTIONS = {
    "methods": ["MODESTGA", "SCIPY"],
    "modestga_opts": {"workers": 1, "generations": 1, "pop_size": 10, "trm_size": 2},
    "scipy_opts": {"solver": "SLSQP", "options": {"maxiter": 500}},
}


def modestpy(problem: CalibrationProblem, seed: int, max_calls: int) -> None:
    """Its genetic algorithm, then SLSQP, over the unit cube; again when it has converged."""
    asked = Asked(problem)
    command = [os.environ[PYTHON], "-W", "ignore", str(SIDE), str(asked.n_parameters), str(seed)]
    with (
        TemporaryFile("w+") as said,
        subprocess.Popen(
            [*command, json.dumps(OPTIONS)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=said,
            text=True,
        ) as side,
    ):
        assert side.stdin is not None
        assert side.stdout is not None
        try:
            for question in side.stdout:
                side.stdin.write(f"{asked.mse(np.array(json.loads(question))) ** 0.5!r}\n")
                side.stdin.flush()
        finally:
            side.kill()
        said.seek(0)
        raise RuntimeError(said.read().strip()[-200:])

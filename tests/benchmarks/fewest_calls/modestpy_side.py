"""ModestPy's side of `peers_modestpy`: estimates in an environment of its own and asks for every simulation.

    PYTHON modestpy_side.py NUMBER_OF_PARAMETERS SEED OPTIONS_AS_JSON

A point of the unit cube leaves as a line of JSON, its root mean squared error comes back as another. Their
class of FMUs is replaced by that question: genetic algorithm, searches and bookkeeping stay their own.
"""

import json
import os
import random
import sys
import tempfile
import types

import numpy as np
import pandas as pd


class Model:
    """What ModestPy wants of an FMU, whose output is one plus the error: an ideal of zero it refuses."""

    tmpdir_file = "tmp_dirs.txt"

    def __init__(self, fmu_path, opts=None):
        self.model = fmu_path
        self.parameters = {}

    def set_input(self, inputs):
        """Inputs are those of the problem."""

    inputs_from_df = set_outputs = specify_outputs = set_input

    def set_param(self, values):
        """Take parameters that their frame holds; the others keep their values."""
        self.parameters.update({name: float(values[name].iloc[0]) for name in values})

    parameters_from_df = set_param

    def simulate(self, reset=True):
        """Ask for one simulation."""
        u = [self.parameters[name] - SHIFT for name in NAMES]
        ASKED.write(json.dumps(u) + "\n")
        ASKED.flush()
        answer = sys.stdin.readline()
        if not answer:
            # Their genetic algorithm catches every Exception.
            raise SystemExit
        return pd.DataFrame({"error": 1.0 + float(answer)}, index=TIMES)


# Their pattern search steps by a share of the value, which must not be near zero.
SHIFT = 1.0
TIMES = pd.Index([0, 1], name="time")
N_PARAMETERS, SEED, OPTIONS = int(sys.argv[1]), int(sys.argv[2]), json.loads(sys.argv[3])
NAMES = [f"u{i:02d}" for i in range(N_PARAMETERS)]
# What they print goes to another stream.
ASKED = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)

if __name__ == "__main__":
    os.environ["MPLBACKEND"] = "agg"
    replaced = types.ModuleType("modestpy.fmi.model")
    replaced.Model = Model
    sys.modules["modestpy.fmi.model"] = replaced
    from modestpy import Estimation

    random.seed(SEED)
    np.random.seed(SEED)  # noqa: NPY002 - what their genetic algorithm draws from
    while True:
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            Estimation(
                folder,
                "",
                inp=pd.DataFrame({"none": 0.0}, index=TIMES),
                known={},
                est={name: (SHIFT + random.random(), SHIFT, SHIFT + 1.0) for name in NAMES},
                ideal=pd.DataFrame({"error": 1.0}, index=TIMES),
                **OPTIONS,
            ).estimate()
            os.chdir("/")

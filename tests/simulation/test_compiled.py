"""Machine code in numba's cache is as new as every file that it was compiled from."""

import os
import pickle
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from exchange_for_tests import MODES, build, settings

from simulation import Parameter, ParameterSpace
from simulation.experiments import ExperimentRows
from simulation.fmi.call import SOURCES
from simulation.fmi.fmu import FmuSettings
from simulation.layout import Experiment, Layout

ROOM = Path(__file__).parents[2] / "simulation"
COMPILE = """
from simulation.fmi.loop import set_inputs
set_inputs.compile("UniTuple(int64, 2)(int64, int64[:,:], int64)")
print(sum(set_inputs.stats.cache_hits.values()))
"""


@pytest.mark.slow
def test_a_change_of_what_a_loop_is_compiled_from_compiles_it_again(tmp_path: Path):
    shutil.copytree(ROOM, tmp_path / "simulation", ignore=shutil.ignore_patterns("__pycache__"))
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    def n_from_cache() -> str:
        command = [sys.executable, "-c", COMPILE]
        return subprocess.run(
            command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True
        ).stdout

    assert [n_from_cache(), n_from_cache()] == ["0\n", "1\n"]
    call = tmp_path / "simulation" / "fmi" / "call.py"
    call.write_text(call.read_text() + "# Another text.\n")
    assert n_from_cache() == "0\n"


def test_every_module_with_machine_code_counts():
    for file in (ROOM / "fmi").glob("*.py"):
        text = file.read_text()
        if "@compiled" in text or "@_callback" in text or " = intrinsic(" in text:
            assert file.stem in SOURCES


OPENED = """
import pickle, sys
from simulation.fmi import exchange_loop, loop
make_model, row = pickle.load(sys.stdin.buffer)
model = make_model()
loops = loop.step_through, exchange_loop.simulate_row
compiled = [len(one.signatures) for one in loops]
failures = model.simulate(row).failures
model.close()
print(failures, compiled, compiled == [len(one.signatures) for one in loops])
"""


def test_no_row_waits_until_its_loop_is_compiled(decay_fmu: Path, tmp_path: Path):
    """The time of a row may be limited; compiling takes seconds where nothing is cached."""
    exchange = settings(build(tmp_path, "2.0"), MODES[0], edges=np.arange(5.0))
    scenario = replace(exchange.scenario, input_names=("u",))
    space = ParameterSpace((Parameter("k", 0.0, 1.0), Parameter("x0", 0.0, 1.0)))
    stepped = FmuSettings(decay_fmu, space, scenario, ("y",), np.zeros(1))
    columns = np.arange(2)
    parts = [Experiment(str(k), columns, np.arange(n), 5) for k, n in enumerate((1, 2))]
    layout = Layout(("one", "two"), ("y@0", "y@1", "n@1"), scenario.time, tuple(parts))
    both = ExperimentRows(layout, (stepped, exchange))
    done = subprocess.run(
        [sys.executable, "-c", OPENED],
        # A row of the second experiment, the one by model exchange.
        input=pickle.dumps((both.open, np.array([[1.0, 0.0, 0.0]]))),
        env=os.environ | {"PYTHONPATH": str(ROOM.parent)},
        capture_output=True,
        check=True,
    )
    assert done.stdout.decode().strip() == "('',) [1, 1] True"

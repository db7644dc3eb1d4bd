"""Machine code in numba's cache is as new as every file that it was compiled from."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from simulation.fmi.call import SOURCES

ROOM = Path(__file__).parents[2] / "simulation"
COMPILE = """
from simulation.fmi.loop import set_inputs
set_inputs.compile("UniTuple(int64, 2)(int64, int64[:,:], int64)")
print(sum(set_inputs.stats.cache_hits.values()))
"""


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

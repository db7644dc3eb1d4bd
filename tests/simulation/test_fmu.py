"""The FMU runner: right numbers, independent rows, failures as rows with a reason, nothing left behind."""

import dataclasses
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

from simulation import FmuModel, InputError, load_case
from simulation.fmi.runner import NeedsFreshProcess

# Modes of the test FMU, see decay.c.
STEP_ERROR, STEP_DISCARD, STEP_FATAL, NAN_OUTPUT, REFUSE_INIT = 1.0, 2.0, 3.0, 4.0, 5.0


@pytest.fixture
def model(decay_case: Path):
    with load_case(decay_case).open_model() as model:
        yield model


def _unpacked() -> set[str]:
    return {path.name for path in Path(tempfile.gettempdir()).glob("simulation-fmus-*")}


def test_the_numbers_are_those_of_the_closed_form(decay_case: Path):
    case = load_case(decay_case)
    with case.open_model() as model:
        answer = model.simulate(np.array([[1e-4, 0.0], [4e-4, 0.0]]))
    h, time_s = 600.0, np.arange(49) * 1800.0
    heating = 1e-3 * np.cos(time_s / 2e4)
    for k, y in zip((1e-4, 4e-4), answer.y[:, :, 0], strict=True):
        x = 20 + np.sin(0.25 * 86400 / 1e4) + 273.15
        expected = [x]
        for step in range(72):
            edge = 0.25 * 86400 + step * h
            # The mean of a straight line is its middle value; 600 s steps never straddle a sample.
            u = np.interp(edge + h / 2, time_s, heating)
            x = x * np.exp(-k * h) + u * (1 - np.exp(-k * h)) / k
            expected.append(x)
        # The CSV holds six to nine decimals.
        np.testing.assert_allclose(y, np.array(expected[::3]) - 273.15, atol=2e-6)
    assert answer.time[0] == 0.25 * 86400
    assert answer.time[-1] == 0.75 * 86400
    assert len(answer.time) == 25


@pytest.mark.parametrize(
    ("mode", "reason"),
    [
        (STEP_ERROR, r"^fmi2DoStep returned fmi2Error at 30000 s: gave up at 30000 s$"),
        (STEP_DISCARD, r"^fmi2DoStep returned fmi2Discard at 30000 s"),
        (NAN_OUTPUT, r"^output y is nan at 30600 s$"),
        (REFUSE_INIT, r"^fmi2EnterInitializationMode returned fmi2Error"),
    ],
)
def test_a_row_that_fails_says_why_and_leaves_its_neighbors_alone(model: FmuModel, mode: float, reason: str):
    good = model.simulate(np.array([[1e-4, 0.0]]))
    mixed = model.simulate(np.array([[1e-4, 0.0], [1e-4, mode], [1e-4, 0.0]]))
    assert re.search(reason, mixed.failures[1])
    assert np.isnan(mixed.y[1]).all()
    assert mixed.failures[0] == mixed.failures[2] == ""
    assert np.array_equal(mixed.y[0], good.y[0])
    assert np.array_equal(mixed.y[2], good.y[0])


def test_after_a_fatal_error_rows_need_another_process(model: FmuModel):
    rows = np.array([[1e-4, 0.0], [1e-4, STEP_FATAL]])
    answer = model.simulate(rows)
    assert answer.failures == ("", "fmi2DoStep returned fmi2Fatal at 30000 s: gave up at 30000 s")
    assert np.isfinite(answer.y[0]).all()
    assert np.isnan(answer.y[1]).all()
    for _ in range(2):
        with pytest.raises(NeedsFreshProcess, match="after fmi2Fatal"):
            model.simulate(rows[:1])


GROWTH = """
import sys
import numpy as np
import psutil
from simulation.case import load_case
with load_case(sys.argv[1]).open_model() as model:
    rows = np.column_stack([np.linspace(2e-5, 5e-4, 300), np.zeros(300)])
    bad = rows.copy()
    bad[::2, 1] = float(sys.argv[2])
    sizes = []
    for _ in range(6):
        model.simulate(rows)
        model.simulate(bad)
        sizes.append(psutil.Process().memory_info().rss)
print(sizes[-1] - sizes[1])
"""


def test_three_hundred_rows_leave_no_memory_behind(decay_case: Path):
    # In a process that has nothing else, as torch and MLflow in this one take memory when they like.
    command = [sys.executable, "-c", GROWTH, str(decay_case), str(STEP_ERROR)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    # 900 new instances and 2,400 rows; the allocator's own breathing stays below a quarter of a megabyte.
    assert int(done.stdout) < 2**18


def test_nothing_is_left_after_close_or_when_forgotten_or_when_loading_fails(decay_case: Path):
    before = _unpacked()
    case = load_case(decay_case)
    case.open_model().close()
    assert _unpacked() == before
    model = case.open_model()
    assert _unpacked() != before
    del model
    assert _unpacked() == before
    missing = dataclasses.replace(case.settings, output_names=("Y",))
    with pytest.raises(InputError, match="did you mean y"):
        missing.open()
    assert _unpacked() == before


def test_the_loop_compiles_where_nothing_can_be_cached(decay_case: Path, tmp_path: Path):
    script = (
        "import numpy as np\nfrom simulation.case import load_case\n"
        f"with load_case({str(decay_case)!r}).open_model() as model:\n"
        "    print(model.simulate(np.array([[1e-4, 0.0]])).failures)"
    )
    home = tmp_path / "home"
    home.write_text("a file, so that no cache folder can be made in it")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(home / "cache"), "HOME": str(home)}
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout.strip()) == (0, "('',)"), done.stderr

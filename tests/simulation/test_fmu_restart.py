"""Every row as if it were the first, also where the FMU does what it can to prevent it."""

import ctypes
from pathlib import Path

import kinds_fmu
import numpy as np
import pytest

from simulation.fmi.runner import NeedsFreshProcess

ROWS = np.array([[1e-4, 300.0], [4e-4, 290.0], [1e-4, 300.0], [2e-4, 310.0], [9e-4, 250.0]])


@pytest.fixture(params=kinds_fmu.KINDS)
def kind(request: pytest.FixtureRequest) -> dict:
    return request.param


def _expected(settings, rows=ROWS) -> np.ndarray:
    return np.array([kinds_fmu.closed_form(settings, *row) + 2 for row in rows])[:, :, None]


@pytest.mark.parametrize(
    ("again", "said", "way"),
    [
        ("HONEST", {}, "reset"),
        ("HONEST", {"once": True}, "reset"),
        ("KEEPS_STATE", {}, "new instance"),
        ("KEEPS_STATE", {"once": True}, "new instance"),
        ("KEEPS_FIRST", {}, "new instance"),
        ("REFUSES", {}, "new instance"),
    ],
)
def test_all_rows_are_right_however_the_fmu_has_to_be_started_over(
    tmp_path: Path, kind: dict, again: str, said: dict, way: str
):
    settings = kinds_fmu.kinds_settings(kinds_fmu.build_kinds_fmu(tmp_path, **kind, again=again, **said))
    with settings.open() as model:
        assert model.way == "undecided"
        answer = model.simulate(ROWS)
        assert model.way == way
        more = model.simulate(ROWS[::-1])
    assert answer.failures == more.failures == ("",) * len(ROWS)
    np.testing.assert_allclose(answer.y, _expected(settings), rtol=1e-13)
    assert np.array_equal(answer.y[::-1], more.y)


@pytest.mark.parametrize("again", ["STATIC", "ONE_INSTANCE"])
def test_where_only_another_process_helps_no_row_is_handed_out(tmp_path: Path, kind: dict, again: str):
    settings = kinds_fmu.kinds_settings(kinds_fmu.build_kinds_fmu(tmp_path, **kind, again=again))
    with settings.open() as model:
        first = model.simulate(ROWS[:1])
        for _ in range(2):
            with pytest.raises(NeedsFreshProcess):
                model.simulate(ROWS[1:])
    np.testing.assert_allclose(first.y, _expected(settings, ROWS[:1]), rtol=1e-13)


@pytest.mark.parametrize("again", ["DIES_AT_RESET", "DIES_AT_END"])
def test_nothing_is_called_after_a_fatal_status(tmp_path: Path, kind: dict, again: str):
    settings = kinds_fmu.kinds_settings(kinds_fmu.build_kinds_fmu(tmp_path, **kind, again=again))
    with settings.open() as model:
        library = getattr(model._runner._instance, "_library", None)
        with pytest.raises(NeedsFreshProcess, match=f"after fmi{kind['fmi']}Fatal"):
            model.simulate(ROWS)
    if library is None:
        pytest.skip("the FMU counts in another process")
    assert ctypes.c_int.in_dll(library, "n_calls_after_fatal").value == 0

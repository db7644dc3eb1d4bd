"""Every row as if it were the first, also where the FMU does what it can to prevent it."""

import ctypes
from pathlib import Path

import kinds_fmu
import numpy as np
import pytest

from simulation import InputError
from simulation.fmi.runner import NeedsFreshProcess

ROWS = np.array([[1e-4, 300.0], [4e-4, 290.0], [1e-4, 300.0], [2e-4, 310.0], [9e-4, 250.0]])


@pytest.fixture(params=[2, 3], ids=["FMI 2.0", "FMI 3.0"])
def fmi(request: pytest.FixtureRequest) -> int:
    return request.param


def _expected(settings, rows=ROWS) -> np.ndarray:
    return np.array([kinds_fmu.closed_form(settings, *row) + 2 for row in rows])[:, :, None]


@pytest.mark.parametrize(
    ("again", "said", "way"),
    [
        ("HONEST", {}, "reset"),
        ("HONEST", {"state": True}, "reset"),
        ("HONEST", {"once": True}, "reset"),
        ("KEEPS_STATE", {}, "new instance"),
        ("KEEPS_STATE", {"state": True}, "state"),
        ("KEEPS_STATE", {"once": True}, "new instance"),
        ("KEEPS_STATE", {"once": True, "state": True}, "state"),
        ("KEEPS_FIRST", {}, "new instance"),
        ("KEEPS_FIRST", {"state": True}, "state"),
        ("REFUSES", {}, "new instance"),
        ("REFUSES", {"state": True}, "state"),
        ("ONE_INSTANCE", {"state": True, "once": True}, "state"),
    ],
)
def test_all_rows_are_right_however_the_fmu_has_to_be_started_over(
    tmp_path: Path, fmi: int, again: str, said: dict, way: str
):
    settings = kinds_fmu.kinds_settings(kinds_fmu.build_kinds_fmu(tmp_path, fmi=fmi, again=again, **said))
    with settings.open() as model:
        assert model.way == "undecided"
        answer = model.simulate(ROWS)
        assert model.way == way
        more = model.simulate(ROWS[::-1])
    assert answer.failures == more.failures == ("",) * len(ROWS)
    np.testing.assert_allclose(answer.y, _expected(settings), rtol=1e-13)
    assert np.array_equal(answer.y[::-1], more.y)


@pytest.mark.parametrize("again", ["STATIC", "ONE_INSTANCE"])
def test_where_only_another_process_helps_no_row_is_handed_out(tmp_path: Path, fmi: int, again: str):
    settings = kinds_fmu.kinds_settings(kinds_fmu.build_kinds_fmu(tmp_path, fmi=fmi, again=again))
    with settings.open() as model:
        first = model.simulate(ROWS[:1])
        for _ in range(2):
            with pytest.raises(NeedsFreshProcess):
                model.simulate(ROWS[1:])
    np.testing.assert_allclose(first.y, _expected(settings, ROWS[:1]), rtol=1e-13)


def test_rows_that_share_a_warm_up_start_from_its_end(tmp_path: Path, fmi: int):
    fmu = kinds_fmu.build_kinds_fmu(tmp_path, fmi=fmi, state=True)
    settings = kinds_fmu.kinds_settings(fmu, names=("k",), n_warmup=9, warmup_theta=np.array([2e-4]))
    rows = np.array([[1e-4], [4e-4], [1e-4]])
    with settings.open() as model:
        answer = model.simulate(rows)
        assert model.way == "state"
    assert answer.failures == ("", "", "")
    first = 9 * settings.scenario.output_every
    at_end = kinds_fmu.closed_form(settings, 2e-4, 300.0)[9]
    for (k,), y in zip(rows, answer.y[:, :, 0], strict=True):
        x = [at_end]
        for u in settings.scenario.inputs[first:, 0]:
            x.append(x[-1] * np.exp(-k * 600.0) + u * (1 - np.exp(-k * 600.0)) / k)
        np.testing.assert_allclose(y, np.array(x[:: settings.scenario.output_every]) + 2, rtol=1e-13)


@pytest.mark.parametrize(
    ("names", "state", "message"),
    [
        (("k",), False, "needs a co-simulation FMU that can get and set its state"),
        (("k", "x0"), True, r"x0 can only be set before the warm-up \(it is continuous, not tunable\)"),
    ],
)
def test_a_warm_up_that_cannot_be_shared_is_refused(
    tmp_path: Path, fmi: int, names: tuple[str, ...], state: bool, message: str
):
    fmu = kinds_fmu.build_kinds_fmu(tmp_path, fmi=fmi, state=state)
    warmup_theta = np.full(len(names), 2e-4)
    settings = kinds_fmu.kinds_settings(fmu, names=names, n_warmup=9, warmup_theta=warmup_theta)
    with pytest.raises(InputError, match=message):
        settings.open()


@pytest.mark.parametrize("again", ["DIES_AT_RESET", "DIES_AT_END"])
def test_nothing_is_called_after_a_fatal_status(tmp_path: Path, fmi: int, again: str):
    settings = kinds_fmu.kinds_settings(kinds_fmu.build_kinds_fmu(tmp_path, fmi=fmi, again=again))
    with settings.open() as model:
        library = model._runner._instance._library
        with pytest.raises(NeedsFreshProcess, match=f"after fmi{fmi}Fatal"):
            model.simulate(ROWS)
    assert ctypes.c_int.in_dll(library, "n_calls_after_fatal").value == 0

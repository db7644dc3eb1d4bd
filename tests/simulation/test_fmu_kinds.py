"""FMUs of both versions with parameters of every type: set as meant, or refused in one line."""

import re
import shutil
import tempfile
from pathlib import Path

import kinds_fmu
import numpy as np
import pytest

FIXED = {"n": 3, "b": True, "c": "high", "s": "four"}
ROWS = np.array([[1e-4, 300.0], [4e-4, 290.0], [1e-4, 310.0]])


@pytest.fixture(scope="module", params=kinds_fmu.KINDS)
def fmu(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return kinds_fmu.build_kinds_fmu(tmp_path_factory.mktemp("kinds"), **request.param)


def test_folders_may_have_any_name(fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The FMU looks its resources up: by a URI in FMI 2.0, by a path in FMI 3.0."""
    folder = tmp_path / "Büro 1 – 50% & mehr#2"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    copy = shutil.copy(fmu, folder / "Zimmer Süd.fmu")
    with kinds_fmu.kinds_settings(copy).open() as model:
        assert model.simulate(ROWS).failures == ("", "", "")


def test_every_kind_of_parameter_arrives_and_a_start_value_is_calibrated(fmu: Path):
    settings = kinds_fmu.kinds_settings(fmu, fixed=FIXED)
    with settings.open() as model:
        answer = model.simulate(ROWS)
    assert answer.failures == ("", "", "")
    for row, y in zip(ROWS, answer.y[:, :, 0], strict=True):
        expected = kinds_fmu.closed_form(settings, *row) + 3 + 7 + 4 + 1000 + 2
        # The same formula in the same order; exp differs by an ulp between C and NumPy.
        np.testing.assert_allclose(y, expected, rtol=1e-13)


def test_a_structural_parameter_is_set_in_its_own_mode(tmp_path: Path):
    fmu = kinds_fmu.build_kinds_fmu(tmp_path, fmi=3)
    settings = kinds_fmu.kinds_settings(fmu, fixed={"size": 5})
    with settings.open() as model:
        y = model.simulate(ROWS).y[:, :, 0]
    expected = [kinds_fmu.closed_form(settings, *row) + 5 for row in ROWS]
    np.testing.assert_allclose(y, expected, rtol=1e-13)


@pytest.mark.parametrize(
    ("n", "reason"),
    [
        (-1, r"^the FMU ended the simulation by itself in the step at 30000 s$"),
        (-2, r"^the FMU returned early, at 30300 s, from the step at 30000 s$"),
        (-3, r"^fmi.DoStep returned fmi.Discard at 30000 s$"),
    ],
)
def test_a_simulation_that_stops_early_is_a_failed_row(fmu: Path, n: int, reason: str):
    if n == -2 and fmu.stem == "kinds2":
        pytest.skip("a step of FMI 2.0 cannot return early")
    with kinds_fmu.kinds_settings(fmu, fixed={"n": n}).open() as model:
        answer = model.simulate(ROWS)
    assert np.isnan(answer.y).all()
    assert all(re.search(reason, failure) for failure in answer.failures), answer.failures

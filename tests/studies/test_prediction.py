"""A calibrated model with other inputs: its own inputs give the calibration again, others something else."""

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_once import made_once
from project_for_tests import DAY, copy_of, make_judged_wall

from simulation.case import load_case
from simulation.errors import InputError
from simulation.other_inputs import settings_with_inputs
from studies.cli import main
from studies.results.outcome import read_outcome
from studies.results.stage_results import Calibration, Uncertainty

ROOT = Path(__file__).resolve().parents[2]
INPUTS = ROOT / "data" / "wall" / "inputs.csv"
WALL = ("wall", *DAY, "--jobs", "1")
RESULTS = Path("mlruns/results/wall-quick-d1-2")


@pytest.fixture
def here(tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project with a calibrated wall whose uncertainty is known, and without predictions."""
    judged = made_once(tmp_path_factory, "judged-wall", make_judged_wall)
    return copy_of(judged, tmp_path / "project", monkeypatch)


def predicted(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    capsys.readouterr()
    assert main(["predict", *WALL, "--json", *words]) == 0
    (stage,) = json.loads(capsys.readouterr().out)["stages"]
    assert isinstance(stage, dict)
    return stage


def table_of(stage: dict[str, Any]) -> dict[str, np.ndarray]:
    header, *rows = csv.reader(Path(stage["table"]).read_text("utf-8").splitlines())
    return dict(zip(header, np.array(rows, dtype=np.float64).T, strict=True))


def test_its_own_inputs_give_calibration_and_bands_again(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stage = predicted(capsys, "--inputs", str(INPUTS))
    table = table_of(stage)
    calibrated = read_outcome(RESULTS, "calibrate-adaptive", Calibration)
    judged = read_outcome(RESULTS, "uncertainty-adaptive", Uncertainty)
    assert calibrated is not None
    assert judged is not None
    rows = np.isin(table["time_s"], calibrated.result.time)
    assert rows.sum() == len(calibrated.result.time) < len(rows)
    for k, name in enumerate(("TMasonry", "QRoom")):
        np.testing.assert_array_equal(table[name][rows], calibrated.result.y[:, k])
        for band in ("simulated", "predictive"):
            ends = np.stack([table[f"{name} {band} {end}"][rows] for end in ("low", "high")])
            np.testing.assert_allclose(ends, getattr(judged.result, band)[:, :, k], rtol=1e-9, atol=1e-9)
    assert stage["level"] == judged.result.level
    assert stage["n_sample"] == len(judged.result.weights)

    again = predicted(capsys, "--inputs", str(INPUTS))
    assert again["finished_before"]
    assert table_of(again).keys() == table.keys()


def test_other_inputs_give_other_outputs(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = INPUTS.read_text("utf-8").splitlines()
    warmer = [f"{t},{room},{float(out) + 5.0}" for t, room, out in (one.split(",") for one in lines[1:97])]
    Path("warm & dry.csv").write_text("\n".join([lines[0], *warmer]) + "\n", encoding="utf-8")
    stage = predicted(capsys, "--inputs", "warm & dry.csv")
    assert re.fullmatch(r"predict-adaptive-warm___dry-[0-9a-f]{8}\.csv", Path(stage["table"]).name)
    cold, warm = table_of(predicted(capsys, "--inputs", str(INPUTS))), table_of(stage)
    assert len(warm["time_s"]) == 95 * 3 + 1
    assert warm["TMasonry"][-1] > cold["TMasonry"][len(warm["time_s"]) - 1] + 0.5


@pytest.mark.slow
def test_recordings_of_one_name_have_a_prediction_each(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = INPUTS.read_text("utf-8").splitlines()[:97]
    for folder, rows in (("first", lines), ("second", lines[:49])):
        Path(folder).mkdir()
        Path(folder, "next.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    stages = [predicted(capsys, "--inputs", f"{folder}/next.csv") for folder in ("first", "second")]
    tables = [table_of(one) for one in stages]
    assert [len(one["time_s"]) for one in tables] == [95 * 3 + 1, 47 * 3 + 1]
    assert predicted(capsys, "--inputs", "first/next.csv")["finished_before"]
    # One file with another content in its place, as of a forecast that comes every day.
    Path("first/next.csv").write_text("\n".join(lines[:73]) + "\n", encoding="utf-8")
    stages.append(predicted(capsys, "--inputs", "first/next.csv"))
    assert len({one["table"] for one in stages}) == len({one["file"] for one in stages}) == 3
    assert [len(table_of(one)["time_s"]) for one in stages] == [95 * 3 + 1, 47 * 3 + 1, 71 * 3 + 1]


def test_without_an_uncertainty_there_are_no_bands(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (RESULTS / "uncertainty-adaptive.json").unlink()
    assert list(table_of(predicted(capsys, "--inputs", str(INPUTS)))) == ["time_s", "TMasonry", "QRoom"]
    assert main(["predict", *WALL, "--inputs", str(INPUTS)]) == 0
    assert (
        "No bands: type studies uncertainty wall --window 1-2, then this command again"
        in capsys.readouterr().out
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,TRoom_degC\n0,20\n1800,20\n", "TOutdoor_degC"),
        ("time_s,TRoom_degC,TOutdoor_degC\n0,20,5\n300,20,5\n", "has 0 output steps of 600 s; 1 to"),
        (
            "time_s,TRoom_degC,TOutdoor_degC\n0,20,5\n600,20,5\n1200,,5\n1800,20,5\n2400,20,5\n3000,20,5\n",
            "line 4",
        ),
    ],
)
def test_a_recording_that_does_not_fit_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "other.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        settings_with_inputs(load_case(ROOT / "fmus" / "wall"), tmp_path / "other.csv")

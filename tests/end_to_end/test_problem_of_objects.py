"""A case made of objects: an FMU, series and bounds; the same numbers as its case file gives."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from mlflow_store_for_tests import give_store

from studies import InputError, Problem, calibrate, load_case

ROOT = Path(__file__).parents[2]
WALL = ROOT / "fmus" / "wall" / "Wall.fmu"


def recorded(file: str, column: str) -> "pd.Series[float]":
    return pd.read_csv(ROOT / "data" / "wall" / f"{file}.csv", index_col="time_s")[column]


def wall(**changes: Any) -> Problem:
    """The embedded wall, from its recording and the bounds of its case file."""
    inputs = {"TIn": recorded("inputs", "TRoom_degC"), "TOut": recorded("inputs", "TOutdoor_degC")}
    measured = {"TMasonry": ("degC", 0.05), "QRoom": ("W", 2.0)}
    keys: dict[str, Any] = {
        "inputs": {name: {"values": values, "unit": "degC"} for name, values in inputs.items()},
        "outputs": {
            name: {"values": recorded("measured", f"{name}_{unit}"), "unit": unit, "uncertainty": uncertainty}
            for name, (unit, uncertainty) in measured.items()
        },
        "parameters": {
            one.name: {"lower": one.lower, "upper": one.upper, "unit": one.unit, "scale": one.scale}
            for one in load_case("wall").parameter_space.parameters
        },
        "fixed": {"GOut": 200.0},
        "step_s": 60.0,
        "window_s": (86400.0, 5 * 86400.0),
        "name": "objects",
        "keys": {"time": {"output_step_s": 600.0}, "note": "from objects"},
    }
    return Problem(WALL, **(keys | changes))


@pytest.fixture(autouse=True)
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    give_store(tmp_path)
    (tmp_path / "studies.toml").write_text("schema = 1\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_it_is_calibrated_as_its_case_file_is(project: Path) -> None:
    problem = wall()
    result = calibrate(problem, max_calls=30, seed=1, jobs=1)
    expected = calibrate("wall", max_calls=30, seed=1, jobs=1)
    assert result.name == "objects-quick-seed1/adaptive"
    assert (result.mse, result.note) == (expected.mse, "from objects")
    assert result.theta["value"].to_dict() == expected.theta["value"].to_dict()
    # Its cost there is the error, and the values go on to other programs.
    assert problem.cost(result.theta["value"].to_dict()) == result.mse
    assert result.write("wall.ssv").read_text("utf-8").count("<ssv:Real") >= 7
    assert problem.path.is_relative_to(project / "mlruns")


def test_inputs_of_a_prediction_may_be_a_frame() -> None:
    result = calibrate(wall(), max_calls=12, seed=1, jobs=1, state_equations=False)
    frame = pd.read_csv(ROOT / "data" / "wall" / "inputs.csv", index_col="time_s")
    table = result.predict(frame.rename(columns={"TRoom_degC": "TIn", "TOutdoor_degC": "TOut"})).table
    at = result.trajectories["TMasonry", "calibrated"].index.intersection(table.index)
    assert len(at) > 100
    shown = result.trajectories["TMasonry", "calibrated"]
    np.testing.assert_allclose(table.loc[at, "TMasonry"], shown.loc[at], rtol=0, atol=1e-9)


def test_timestamps_count_from_their_first_one() -> None:
    def stamped(values: "pd.Series[float]") -> "pd.Series[float]":
        return values.set_axis(pd.Timestamp("2024-01-01") + pd.to_timedelta(values.index, unit="s"))

    plain = wall(name="plain")
    rooms = {
        room: {name: {**one, "values": stamped(one["values"])} for name, one in getattr(plain, room).items()}
        for room in ("inputs", "outputs")
    }
    expected, measured = (one.case.measurement.outputs[0] for one in (plain, wall(**rooms, name="stamped")))
    np.testing.assert_array_equal(measured.samples.time, expected.samples.time)
    np.testing.assert_array_equal(measured.samples.values, expected.samples.values)


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"outputs": {"TMasonry": [1.0, 2.0]}}, "TMasonry: its values are a list; give a pandas series"),
        ({"outputs": {"TMasonry": {"uncertainty": 1.0}}}, "outputs: none has `values`"),
        ({"fixed": {"GOut": object()}}, "a case file cannot hold <object"),
        ({"parameters": {"GIN": (1.0, 2.0)}}, "did you mean GIn"),
    ],
)
def test_what_is_wrong_is_said_in_a_line(changes: dict[str, Any], line: str) -> None:
    with pytest.raises(InputError, match=line):
        _ = wall(**changes).case

"""What outputs are compared with, from case file to results: normalized, limits, correlated errors."""

from pathlib import Path

import numpy as np
import pytest
from project_for_tests import DAY, Run, add_case, copy_of, edit
from test_cli_experiments import with_experiments

from simulation.case import load_case

CALIBRATE = ("calibrate", "wall", "--jobs", "1", "--max-calls", "8")
SHORT = (*DAY, "--jobs", "1")
WALL = Path("fmus", "wall", "case.toml")
MASONRY, FLOW = "uncertainty = 0.05\n", "uncertainty = 2\n"
PRIOR = 'name = "GIn"\n'
BOTH = 'file = "measured.csv"\n'
FLOW_MEASURED = f'{BOTH}column = "QRoom_W"\n'


@pytest.fixture
def project(hasty_wall: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return copy_of(hasty_wall, tmp_path / "project", monkeypatch)


def test_normalized_errors_count_and_are_shown(project: Path, studies: Run) -> None:
    plain = studies(*CALIBRATE, "--json").stage
    file = edit(project / WALL, *((key, f'{key}normalize = "range"\n') for key in (MASONRY, FLOW)))
    found = studies(*CALIBRATE, "--json").stage
    case = load_case(file)
    series = [one.samples.values for one in case.outputs]

    assert not found["finished_before"]
    sizes = np.array([np.ptp(values) for values in series])
    relative = np.array([found["outputs"][one.name]["nrmse"] for one in case.outputs])
    rmse = np.array([found["outputs"][one.name]["rmse"] for one in case.outputs])
    np.testing.assert_allclose(relative, rmse / sizes, rtol=1e-12)
    # The error is the sum of squared NRMSE, in the first output's unit.
    shares = (np.array([0.05, 2.0]) / sizes) ** 2
    assert found["mse"] == pytest.approx(0.05**2 * np.sum(relative**2) / shares.sum(), rel=1e-9)
    assert found["mse"] != plain["mse"]
    assert found["outputs"]["TMasonry"]["cv_rmse"] is None
    assert found["outputs"]["QRoom"]["cv_rmse"] == pytest.approx(rmse[1] / series[1].mean(), rel=1e-2)
    assert case.validation is not None
    np.testing.assert_array_equal(case.validation.measurement.weights, case.measurement.weights)
    assert "of the measured values: TMasonry NRMSE 3 %; QRoom NRMSE" in studies(*CALIBRATE).out
    assert studies("report", "wall").code == 0
    page = (project / "mlruns" / "reports" / "wall-quick" / "index.html").read_text(encoding="utf-8")
    assert "TMasonry NRMSE" in page


@pytest.mark.slow
def test_only_what_lies_above_a_limit_counts(project: Path, studies: Run) -> None:
    case = load_case(project / "fmus" / "wall" / "case.toml")
    limit = float(np.quantile(case.measurement.outputs[1].samples.values, 0.9))
    # Beside the measurement a limit pulls, alone it is all that is known of the heat flow.
    plain = studies(*CALIBRATE, "--json").stage["outputs"]["QRoom"]
    file = edit(project / WALL, (FLOW, f"{FLOW}at_most = {limit:g}\n"))
    beside = studies(*CALIBRATE, "--json").stage["outputs"]["QRoom"]
    assert beside["largest_excess"] > 0.0
    assert beside["rmse"] > 1.01 * plain["rmse"]
    assert f"QRoom is outside its limits (at most {limit:.4g} W) for" in studies(*CALIBRATE).out
    edit(project / WALL, (FLOW_MEASURED, ""))
    alone = studies(*CALIBRATE, "--json").stage["outputs"]["QRoom"]
    assert alone["largest_excess"] < 0.1 * beside["largest_excess"]
    assert alone["nrmse"] is None
    assert load_case(file).measurement.measured == (0,)
    assert studies("report", "wall").code == 0
    assert studies("check", "wall").code == 0
    assert studies("calibrate", "wall", *SHORT).code == 0
    judged = studies("uncertainty", "wall", *SHORT, "--max-calls", "30")
    assert judged.code == 0, judged.err


@pytest.mark.slow
def test_correlated_errors_widen_the_intervals(project: Path, studies: Run) -> None:
    def widths() -> np.ndarray:
        found = studies("calibrate", "wall", *SHORT)
        assert ("whitened MSE" in found.out) == is_correlated
        judge = ("uncertainty", "wall", *SHORT, "--noise", "sensor", "--max-calls", "30", "--json")
        stage = studies(*judge).stage
        ends = [one["linear"] for one in stage["parameters"].values()]
        return np.diff(np.log(ends), axis=1)[:, 0]

    is_correlated = False
    independent = widths()
    edit(project / WALL, *((key, f"{key}correlation_time_s = 7200\n") for key in (MASONRY, FLOW)))
    is_correlated = True
    # Samples 35 minutes apart have the correlation 0.75: of a constant, seven count as one.
    ratio = widths() / independent
    assert ratio.max() > 1.5
    assert ratio.max() < np.sqrt(7.5)


def test_experiments_have_scales_limits_and_correlations_of_their_own(new_project: Path) -> None:
    add_case(new_project)
    file = edit(
        new_project / WALL,
        (MASONRY, f'{MASONRY}normalize = "range"\ncorrelation_time_s = 7200\n'),
        (FLOW, f'{FLOW}normalize = "mean"\nat_most = 100.0\n'),
    )
    with_experiments(file)
    case, rng = load_case(file), np.random.default_rng(0)
    assert case.layout is not None
    joined, parts = case.measurement, case.layout.experiments
    y = rng.normal(50.0, 40.0, (2, len(joined.time), 4))
    errors, shares = np.zeros(2), 0.0
    for part, one in zip(parts, case.experiments, strict=True):
        own = one.measurement
        share = own.weights.sum()
        # Both have the same first uncertainty.
        errors += share * own.mse(np.ascontiguousarray(y[:, : part.n_times, part.outputs]))
        shares += share
    np.testing.assert_allclose(joined.mse(y), errors / shares, rtol=1e-12)
    sizes = [[np.ptp(its.samples.values) for its in one.outputs] for one in case.experiments]
    assert sizes[0][0] != sizes[1][0]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (FLOW, f'{FLOW}normalize = "range"\n', "outputs[TMasonry] has no normalize and others have"),
        (MASONRY, f'{MASONRY}normalize = "mean"\n', "outputs[QRoom] has no normalize"),
        (FLOW, f"{FLOW}at_most = 5\nat_least = 6\n", "at_least = 6 is not below at_most = 5"),
        (FLOW_MEASURED, "", "keys file and column are missing; add them, or a limit: at_most = ..."),
        ('column = "QRoom_W"\n', "", "key column is missing; add it"),
        (FLOW, f"{FLOW}correlation_time_s = 60\nerror_lasts_s = 60\n", "drop error_lasts_s"),
        (FLOW, f'{FLOW}correlation_time_s = 60\nloss = "huber"\n', "beside a robust loss"),
        (FLOW, f"{FLOW}correlation_time = 60\n", "did you mean correlation_time_s?"),
        (f"{FLOW_MEASURED}{FLOW}", f"{FLOW}at_most = 9\ncorrelation_time_s = 60\n", "nothing is measured"),
        (BOTH, f'{BOTH}normalize = "mean"\n', "the zero of a temperature is a convention"),
        (PRIOR, f"{PRIOR}prior = {{ about = 75, within = 0.1 }}\n", "write within_factor"),
        (PRIOR, f"{PRIOR}prior = {{ abut = 75, within_factor = 2 }}\n", "abut (did you mean about?)"),
        (
            PRIOR,
            f"{PRIOR}prior = {{ about = 7500, within_factor = 2 }}\n",
            "7500 lies outside the bounds",
        ),
        (PRIOR, f"{PRIOR}prior = {{ about = 75, within_factor = 0.5 }}\n", "0.5; give a number above 1"),
    ],
)
def test_what_is_wrong_is_one_line(old: str, new: str, message: str, new_project: Path, studies: Run) -> None:
    file = add_case(new_project)
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new), encoding="utf-8")
    answer = studies("check", "wall")

    assert answer.code == 2
    assert message in answer.err
    assert len(answer.err.strip().splitlines()) == 1

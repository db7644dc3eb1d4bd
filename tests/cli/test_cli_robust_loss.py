"""A case with a robust loss, or with samples of uncertainties of their own: what is printed of it."""

import re
from pathlib import Path

import pandas
import pytest
from project_for_tests import Run, add_case, edit

WALL = ("calibrate", "wall", "--jobs", "1", "--max-calls", "5")
PLAIN = "(?<!R)MSE"


@pytest.mark.slow
def test_results_are_named_mean_losses_and_outliers_are_counted(project: Path, studies: Run) -> None:
    case = add_case(project)
    # The masonry has one wrong sample, 30 K off on day 2.
    file = project / "data" / "wall" / "measured.csv"
    table = pandas.read_csv(file)
    later = (table["time_s"] >= 172_800.0) & table["TMasonry_degC"].notna()
    table.loc[later.idxmax(), "TMasonry_degC"] += 30.0
    table.to_csv(file, index=False)
    by_squares = studies(*WALL)
    assert "MSE " in by_squares.out
    # It is named as what would help against that sample, not as what the numbers are.
    assert "mean loss" not in by_squares.out
    assert 'loss = "huber"' in by_squares.out
    sensor = "uncertainty = 0.05"
    edit(case, (sensor, f'{sensor}\nloss = "huber"\nloss_scale = 0.2'))
    robust = studies(*WALL)
    assert robust.code == 0, robust.err
    assert not re.search(PLAIN, robust.out)
    assert re.search(r"wall-quick: mean loss 0\.\d+ K² after", robust.out)
    said = (
        r"TMasonry has the huber loss with scale 0\.200 K: 1 of \d+ samples differ by more and count less, "
    )
    largest = r"the largest, -(29\.9|30\.\d) K, at time_s = 17\d{4}"
    assert re.search(rf"{said}none is left out; {largest}", robust.out)
    assert "QRoom has" not in robust.out
    assert "mean loss" in studies("best").out
    (status,) = studies("status", "--json").document["calibrations"]
    assert status["error_name"] == "mean loss"
    assert "final mean loss" in studies("status").out
    assert studies("report", "wall").code == 0
    page = (project / "mlruns" / "reports" / "wall-quick" / "index.html").read_text(encoding="utf-8")
    assert "mean loss" in page
    assert not re.search(PLAIN, re.sub(r"<script.*?</script>", "", page, flags=re.S))
    assert "has the huber loss" in page


def test_samples_of_uncertainties_of_their_own_are_named(project: Path, studies: Run) -> None:
    sensor = "uncertainty = 0.05"
    edit(add_case(project), (sensor, f"{sensor}\nuncertainty_share = 0.001"))
    answer = studies(*WALL)
    assert answer.code == 0, answer.err
    assert "% of it within the uncertainty of each sample" in answer.out
    assert studies("report", "wall").code == 0

"""A case with a robust loss: what is printed is a mean loss, and outliers are counted."""

import csv
import re
from pathlib import Path

from project_for_tests import Run, add_case

WALL = ("calibrate", "wall", "--jobs", "1", "--max-calls", "5")
PLAIN = "(?<!R)MSE"


def test_results_are_named_mean_losses_and_outliers_are_counted(project: Path, studies: Run) -> None:
    case = add_case(project)
    # The masonry has one wrong sample, 30 K off on day 2.
    file = project / "data" / "wall" / "measured.csv"
    with file.open(newline="") as stream:
        rows = list(csv.reader(stream))
    (wrong,) = [row for row in rows[1:] if row[1] and float(row[0]) >= 172_800.0][:1]
    wrong[1] = f"{float(wrong[1]) + 30.0:.2f}"
    with file.open("w", newline="") as stream:
        csv.writer(stream).writerows(rows)
    text = case.read_text(encoding="utf-8")
    by_squares = studies(*WALL)
    assert "MSE " in by_squares.out
    assert "loss" not in by_squares.out
    sensor = "uncertainty = 0.05"
    case.write_text(text.replace(sensor, f'{sensor}\nloss = "huber"\nloss_scale = 0.2'), encoding="utf-8")
    robust = studies(*WALL)
    assert robust.code == 0, robust.err
    assert not re.search(PLAIN, robust.out)
    assert re.search(r"wall-quick: mean loss 0\.\d+ K² after", robust.out)
    said = (
        r"TMasonry has the huber loss with scale 0\.200 K: 1 of \d+ samples differ by more and count less, "
    )
    assert re.search(rf"{said}none is left out; the largest, -(29\.9|30\.\d) K, at day 2", robust.out)
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

"""Tables of the pages have the numbers of the stored benchmarks."""

import json
import re
import statistics
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DATA = ROOT / "data" / "benchmarks"
sys.path.insert(0, str(ROOT / "tests" / "benchmarks"))

from fewest_calls.kept import Kept  # noqa: E402
from fewest_calls.table import RIGHT, counts_to  # noqa: E402
from fewest_calls.table import cell as median_and_worst  # noqa: E402

ROUNDED, ROUNDED_MUCH = 6e-3, 0.5  # to three digits; to one
SURROGATES = {"refined (layers)": "refined", "pca + autoemulate's best": "autoemulate"}
OLD = {"pca-gp": "gaussian-process"}  # of version 0.2, in the table of large sizes
PROBLEMS = {"office": "office", "white box": "white-box", "oscillator": "vanderpol", "wall": "wall"}
CALIBRATIONS = {
    "`studies calibrate`": "adaptive, state equations",
    "the same without state equations": "adaptive",
    "Levenberg-Marquardt, Broyden": "broyden",
    "DFO-LS": "dfols",
    "LS-TRF, signed, logarithmic": "trf",
    "ModestPy": "modestpy",
    "BoTorch, composite (60 calls)": "botorch",
    "Py-BOBYQA": "bobyqa",
    "CMA-ES": "cma-es",
}
FAMILIES = {
    "office, recorded": ["office-recorded"],
    "office, drawn": ["office instances"],
    "white box, 21 parameters": ["white box"],
    "wall, two outputs": ["wall"],
    "oscillator": ["vanderpol"],
    "slab, two basins": ["two basins"],
    "weather inside": ["office inside", "wall inside", "house inside"],
}


def tables(page: Path, head: str) -> list[list[list[str]]]:
    """Return the cells of the tables whose first cell begins with some words, without emphasis."""
    text = page.read_text(encoding="utf-8").replace("**", "")
    blocks = re.findall(rf"^\| {re.escape(head)}.*\n(?:\|.*\n)+", text, re.MULTILINE)
    assert blocks
    lines = [[line for line in block.splitlines() if "---" not in line] for block in blocks]
    return [[[cell.strip() for cell in line.strip("|").split("|")] for line in block] for block in lines]


def test_errors_of_surrogates_are_those_of_the_file() -> None:
    runs = json.loads((DATA / "surrogate_rivals.json").read_text(encoding="utf-8"))["runs"]
    n_checked = 0
    for head, *rows in tables(DATA / "README.md", "test MAE"):
        problem, columns = "", list[tuple[str, int]]()
        for words in head[1:]:
            problem = next((PROBLEMS[name] for name in PROBLEMS if words.startswith(name)), problem)
            columns.append((problem, int(words.replace(",", "").split()[-1])))
        is_old = any("version 0.2)" in row[0] for row in rows)
        for row in rows:
            name = re.split(r"(?<=\))?,? ?(?:\d+ November|version 0\.2|\(ours)", row[0])[0].strip()
            method = SURROGATES.get(name, OLD.get(name, name) if is_old else name)
            for (problem, size), cell in zip(columns, row[1:], strict=True):
                found = [
                    run["mae"]
                    for run in runs
                    if (run["problem"], run["method"], run["size"]) == (problem, method, size)
                ]
                stated, _, spread = cell.replace(" ¹", "").partition(" ± ")
                where = f"{row[0]}, {problem}, {size}"
                assert float(stated) == pytest.approx(statistics.median(found), rel=ROUNDED), where
                if spread:
                    assert float(spread) == pytest.approx(statistics.stdev(found), rel=ROUNDED_MUCH), where
                n_checked += 1
    assert n_checked == 176


def test_calls_of_calibrations_are_those_of_the_file() -> None:
    kept = Kept(DATA / "fewest_calls.json")
    ((head, *rows),) = tables(ROOT / "docs" / "calibration.md", "method | office")
    for row in rows:
        for column, stated in zip(head[1:], row[1:], strict=True):
            families = FAMILIES.get(column, [column])
            counts = [
                count
                for problem in kept.problems.values()
                if problem.family in families
                for count in counts_to(kept, problem.name, CALIBRATIONS[row[0]], RIGHT)
            ]
            assert stated in (median_and_worst(counts), "as above ¹"), (row[0], column)

"""Numbers of the pages are those of stored runs, or the page says how and when they were measured."""

import json
import math
import re
import statistics
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DATA, DOCS, PAPER = ROOT / "data" / "benchmarks", ROOT / "docs", ROOT / "data" / "paper-results"
README, CALIBRATION, BENCHMARKS = ROOT / "README.md", DOCS / "calibration.md", DATA / "README.md"
sys.path.insert(0, str(ROOT / "tests" / "benchmarks"))

from fewest_calls.counted import Run  # noqa: E402
from fewest_calls.kept import Kept  # noqa: E402
from fewest_calls.table import FACTORS, OURS, RIGHT, USUAL_CALLS, counts_to  # noqa: E402
from fewest_calls.table import cell as median_and_worst  # noqa: E402

from studies.paper import fig6, fig7, table4  # noqa: E402
from studies.paper.items import Cell, Shown, read_sizes  # noqa: E402
from studies.paper.published import TABLE_4, USUAL_MSE  # noqa: E402

ROUNDED, ROUNDED_MUCH = 6e-3, 0.5  # to three digits; to one
WITHOUT = "adaptive"
SURROGATES = {
    "refined (layers)": "refined",
    "paper (layers as published)": "paper",
    "pca + autoemulate's best": "autoemulate",
}
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
    "slab, two minima": ["two basins"],
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
        for row in rows:
            name = re.split(r",? ?\d+ November", row[0])[0].strip()
            method = SURROGATES.get(name, name)
            for (problem, size), cell in zip(columns, row[1:], strict=True):
                found = [
                    run["mae"]
                    for run in runs
                    if (run["problem"], run["method"], run["size"]) == (problem, method, size)
                ]
                if not cell:
                    continue
                stated, _, spread = cell.replace(" ¹", "").partition(" ± ")
                where = f"{row[0]}, {problem}, {size}"
                assert float(stated) == pytest.approx(statistics.median(found), rel=ROUNDED), where
                if spread:
                    assert float(spread) == pytest.approx(statistics.stdev(found), rel=ROUNDED_MUCH), where
                n_checked += 1
    assert n_checked >= 160


@cache
def kept() -> Kept:
    return Kept(DATA / "fewest_calls.json")


def counts(families: list[str], method: str, factor: float = RIGHT) -> list[float]:
    """Return the calls to a multiple of the best error, of all runs of a method on some families."""
    names = [problem.name for problem in kept().problems.values() if problem.family in families]
    return [count for name in names for count in counts_to(kept(), name, method, factor)]


def ended(families: list[str], method: str) -> Iterator[tuple[Run, float]]:
    """Yield the runs that ended by themselves, with the best error known of their problem."""
    for problem in kept().problems.values():
        if not families or problem.family in families:
            yield from ((run, problem.best) for run in kept().runs(problem.name, method) if run.said)


@pytest.mark.parametrize("page", [README, CALIBRATION], ids=lambda page: page.name)
def test_calls_of_calibrations_are_those_of_the_file(page: Path) -> None:
    n_checked = 0
    ((head, *rows),) = tables(page, "method | office")
    for row in rows:
        if (method := CALIBRATIONS.get(row[0])) is None:
            assert "the paper" in row[0], "which the test of the paper's Table 4 looks at"
            continue
        for column, stated in zip(head[1:], row[1:], strict=True):
            if stated.startswith("as above"):
                continue
            families = FAMILIES.get(column.replace("<br>", " "), [column])
            assert stated == median_and_worst(counts(families, method)), (row[0], column)
            n_checked += 1
    assert n_checked >= 19


SMOOTH = ["wall", "vanderpol", "wall inside", "two basins"]
MANY = ["office-recorded", "office", "office instances", "office inside", "house inside"]
SWITCHING = ["thermostat", "heating circuit", "heat pump"]


@pytest.mark.parametrize(
    ("row", "method", "families"),
    [
        ("`studies calibrate`", OURS, []),
        ("of these thermostats, heating circuits and heat pumps", OURS, SWITCHING),
        ("of these white boxes", OURS, ["white box"]),
        ("without state equations, up to eight parameters", WITHOUT, SMOOTH),
        ("without them, 14 or 16 parameters", WITHOUT, MANY),
        ("without them, thermostats (seeds 90 and 91)", WITHOUT, ["thermostat"]),
    ],
)
def test_ends_of_calibrations_are_those_of_the_file(row: str, method: str, families: list[str]) -> None:
    ((_, *rows),) = tables(CALIBRATION, "| runs")
    runs = [*ended(families, method)]
    right = [(run, best) for run, best in runs if run.first(RIGHT * best) is not None]
    n_usual = sum(run.calls_to(RIGHT * best) <= USUAL_CALLS for run, best in right)
    n_said = sum(run.converged is True for run, _ in right)
    n_wrong = sum(run.converged is True for run, _ in runs) - n_said
    (stated,) = (cells[1:] for cells in rows if cells[0] == row)
    assert [int(cell.split()[0]) for cell in stated] == [len(runs), len(right), n_usual, n_said, n_wrong]


def calls_in_all(families: list[str], method: str) -> list[int]:
    return [run.n_calls for run, _ in ended(families, method)]


def span(values: list[int]) -> list[int]:
    return [min(values), max(values)]


def test_numbers_in_sentences_are_those_of_the_file() -> None:
    equations = [
        one.family for one in kept().problems.values() if one.family not in ("white box", "heat pump")
    ]
    without = [*calls_in_all(["white box"], OURS), *calls_in_all([*SMOOTH, *MANY], WITHOUT)]
    every = [run for method in (OURS, WITHOUT) for run, _ in ended([], method)]
    offices, inside = MANY[:3], ["office inside", "house inside"]
    to_right, to_near = (counts(offices, WITHOUT, factor) for factor in (RIGHT, FACTORS[0]))
    n_slabs, n_offices = ([*ended(one, WITHOUT)] for one in (["two basins"], offices))
    missed = [sum(run.first(RIGHT * best) is None for run, best in one) for one in (n_slabs, n_offices)]
    for page, words, expected in (
        (README, r"took \*\*(\d+) to (\d+) simulations\*\*", span(calls_in_all(equations, OURS))),
        (README, r"minimum run time took (\d+) to (\d+)", span(calls_in_all(["heat pump"], OURS))),
        (README, r"without such equations took (\d+) to (\d+)", span(without)),
        (README, r"thermostats (\d+) to (\d+)", span(calls_in_all(["thermostat"], WITHOUT))),
        (
            README,
            r"(\d+) of (\d+) runs took more than 100",
            [sum(run.n_calls > 100 for run in every), len(every)],
        ),
        (BENCHMARKS, r"median of ([\d.]+) calls to", [statistics.median(to_near)]),
        (BENCHMARKS, r"best error \(worst (\d+)\) and", [max(to_near)]),
        (BENCHMARKS, r"and (\d+) to 1\.02 times \((\d+) runs", [statistics.median(to_right), len(to_right)]),
        (BENCHMARKS, r"runs, (\w+) never\)", [NUMBERS[to_right.count(math.inf)]]),
        (BENCHMARKS, r"take (\d+) to 1\.02", [statistics.median(counts(inside, WITHOUT))]),
        (BENCHMARKS, r"runs, worst (\d+)\)", [max(counts(inside, WITHOUT))]),
        (README, r"(\w+) of six slabs", [NUMBERS[missed[0]]]),
        (README, r"(\w+) of 22 offices", [NUMBERS[missed[1]]]),
    ):
        found = re.search(words, page.read_text(encoding="utf-8").replace("\n", " "))
        assert found, words
        assert [*found.groups()] == [f"{one:g}" if not isinstance(one, str) else one for one in expected], (
            words
        )


NUMBERS = ("none", "one", "two", "three", "four", "five", "six")


def test_the_table_of_examples_is_that_of_the_golden_results() -> None:
    golden = json.loads((DATA / "golden_results.json").read_text(encoding="utf-8"))
    best = {problem.name: problem.best for problem in kept().problems.values()}
    ((_, *rows),) = tables(CALIBRATION, "case | FMU calls")
    n_checked = 0
    for row in rows:
        name = re.split("[, (]", row[0])[0]
        if name not in golden:
            assert name == "office-recorded", "whose recording is not shipped"
            continue
        runs = [golden[name][f"calibrate, seed {seed}"] for seed in range(3)]
        assert row[1] == ", ".join(str(run["n_rounds"]) for run in runs), name
        ratios = (run["mse"] / best.get(name, best.get(f"{name}, days 0-10", math.nan)) for run in runs)
        assert row[3] == ", ".join(f"{ratio:.2f}" for ratio in ratios), name
        n_checked += 1
    assert n_checked == 4


@cache
def repeated(item: str) -> Shown:
    """Return what `studies reproduce-paper --only ITEM --from data/paper-results/ITEM` prints."""
    module = {"fig6": fig6, "fig7": fig7, "table4": table4}[item]
    shown: Shown = module.shown(*read_sizes(PAPER / item, module.SIZE))
    return shown


def agrees(stated: str, value: Cell) -> bool:
    """Say whether a cell of a page is a value, rounded as pages do."""
    if value is None:
        return stated == ""
    number = float(re.sub(r"[ %,]", "", stated)) / (100.0 if stated.endswith("%") else 1.0)
    tolerance = (
        0.006 if stated.endswith("%") else 0.51 if isinstance(value, float) and value >= 100.0 else 0.0
    )
    return number == pytest.approx(float(value), rel=ROUNDED, abs=tolerance)


FIG_6 = ("MAE", *fig6.SETTINGS, "MAE untuned", "gain", "PCA+GP MAE")
TABLE = (
    *("test MAE", "MSE surrogate", "MSE screened", "final MSE", "calls"),
    *(f"calls to {USUAL_MSE}", "calls to the paper's final", "final MSE, squared residuals"),
    *("paper: screened", "paper: final", "paper: calls"),
)


def test_fig_6_is_that_of_its_files() -> None:
    shown = repeated("fig6")
    ((_, *rows),) = tables(DOCS / "paper.md", "n | trials")
    assert len(rows) == len(shown.rows) == 9
    for row, values in zip(
        rows, (dict(zip(shown.columns, row, strict=True)) for row in shown.rows), strict=True
    ):
        mae, p90 = re.findall(r"[\d.]+", row[2])
        n_trials, n_pruned = re.findall(r"\d+", row[1])
        assert [int(row[0].replace(",", "")), int(n_trials), int(n_pruned)] == [
            values[name] for name in ("n_train", "trials", "pruned")
        ]
        assert agrees(p90, values["P90"])
        for name, stated in zip(FIG_6, [mae, *row[3:10]], strict=True):
            value = values[name]
            assert agrees(stated, -value if name == "gain" and isinstance(value, float) else value), (
                row[0],
                name,
            )


def test_table_4_is_that_of_its_files() -> None:
    shown = repeated("table4")
    ((_, *rows),) = tables(DOCS / "paper.md", "n (seeds)")
    for row, cells in zip(rows, shown.rows, strict=True):
        values = dict(zip(shown.columns, cells, strict=True))
        n, n_seeds = re.findall(r"\d+", row[0].replace(",", ""))
        assert [int(n), int(n_seeds)] == [values["n_train"], values["seeds"]]
        for name, stated in zip(TABLE, row[1:], strict=True):
            assert agrees(stated, values[name]), (row[0], name)


def test_fig_7_is_that_of_its_files() -> None:
    rows_of = {
        (row[0], row[1]): dict(zip(repeated("fig7").columns, row, strict=True))
        for row in repeated("fig7").rows
    }
    ((head, *rows),) = tables(DOCS / "paper.md", "n | whole box")
    for row in rows:
        for name, stated in zip(head[1:], row[1:], strict=True):
            kind = "all" if name.startswith("(b)") else "important"
            spread = float(name.partition("=")[2] or 1.0)
            value = rows_of[kind, int(row[0].replace(",", ""))][f"δ = {spread:.1f}"]
            assert agrees(stated, value), (row[0], name)


def test_table_3_is_that_of_its_file() -> None:
    items = json.loads((PAPER / "office-recorded.json").read_text(encoding="utf-8"))["items"]
    n_checked = 0
    for _, published, stated in tables(DOCS / "paper.md", "| the paper")[0]:
        for n_calls, mse in re.findall(r"^([\d,]+) calls, ([\d.]+) K²$", published):
            paper = {"n_calls": int(n_calls.replace(",", "")), "mse": float(mse)}
            rows = [one for one in items["table3"]["numbers"]["rows"].values() if one["paper"] == paper]
            assert stated in {f"{row['n_calls']:,} calls, {row['mse']:#.3g} K²" for row in rows}
            n_checked += 1
    assert n_checked == 3


def test_calls_of_the_paper_s_method_are_those_of_table_4() -> None:
    _, sizes = read_sizes(PAPER / "table4", table4.SIZE)
    counted = [sizes[0].n_train + one.calls_to(USUAL_MSE) for one in sizes[0].calibrations]
    (row,) = (row for row in tables(README, "method | office")[0] if "the paper" in row[0])
    assert row[1] == f"{median_and_worst(counted)}, the paper {TABLE_4[32].total}"


def test_coverage_of_intervals_is_that_of_the_file() -> None:
    runs = json.loads((DATA / "interval_coverage.json").read_text(encoding="utf-8"))
    groups = dict[str, list[bool]]()
    for name, run in runs.items():
        groups.setdefault(name.partition(" | ")[0], []).extend(run["held"])
    held = {name: sum(one) / len(one) for name, one in groups.items()}
    stated, case = dict[str, str](), ""
    for cells in tables(DOCS / "uncertainty.md", "case | experiments")[0][1:]:
        case = cells[0] or case
        of_its_own = f" in {cells[1]} of its own" if cells[1] != "7" else ""
        name = {"two-rooms": f"two-rooms{of_its_own}", "office": f"office in {cells[1]} of 1.25 d"}.get(case)
        stated |= {name: cells[2]} if name else {}
    assert stated == {name: f"{share:.0%}".replace("%", " %") for name, share in held.items()}
    text = README.read_text(encoding="utf-8").replace("\n", " ")
    for case, words in (
        ("two-rooms", r"(\d+) to (\d+) % \(`two-rooms`\)"),
        ("office", r"(\d+) to (\d+) % \(office\)"),
    ):
        shares = [round(100 * share) for name, share in held.items() if name.startswith(case)]
        found = re.search(words, text)
        assert found, case
        assert [*map(int, found.groups())] == span(shares), case


MEASURED = re.compile(
    r"\b\d+(?:\.\d+)? (?:K²?|V|W|%)(?!\w)|\b\d+(?:\.\d+)? (?:\(\d+\) )?(?:calls|times)\b|\b0\.\d{2,}\b"
)
ORIGIN = re.compile(r"^```sh|python tests/benchmarks|data/[\w/-]+|November 2026", re.MULTILINE)
COMPARED = {"## Calibration in fewest calls": README, "## How sure is the result?": README}
SETTINGS = {
    "## What Optuna tunes": README,
    "## Where state equations are found": CALIBRATION,
    "## A mean as the best surrogate": DOCS / "tuning.md",
}
"""Sections whose numbers the tests above compare, and those whose numbers are settings."""


@pytest.mark.parametrize(
    "page",
    [README, CALIBRATION, BENCHMARKS, DOCS / "paper.md", DOCS / "uncertainty.md", DOCS / "tuning.md"],
    ids=lambda page: str(page.relative_to(ROOT)),
)
def test_measured_numbers_say_where_they_come_from(page: Path) -> None:
    for section in re.split(r"^(?=## )", page.read_text(encoding="utf-8"), flags=re.MULTILINE):
        heading = section.partition("\n")[0]
        if MEASURED.search(re.sub(r"^```.*?^```$", "", section, flags=re.MULTILINE | re.DOTALL)):
            is_known = {**COMPARED, **SETTINGS}.get(heading) == page
            assert is_known or ORIGIN.search(section), f"{page.name}: {heading}"
        assert "version 0.2" not in section or heading == "## Tables and figures", (
            "of the paper, by the FMU alone"
        )

"""Whether intervals shrink as `studies next` promises, on synthetic truths.

Run `python tests/benchmarks/next_experiment.py [office two-rooms heat-pump] [--truths 4]`. Every truth is
drawn evenly in the middle of the box, simulated by the FMU and disturbed by white noise. The present
measurement (office: four days; two-rooms: one experiment; heat pump: a day) is calibrated, `next_experiment`
ranks what may be measured next (other days; experiments; weather), and the best one is added and calibrated.

Per truth it prints the geometric mean over the parameters of half the posterior's 90 % intervals after that,
by `studies uncertainty`, over the promised half widths, and the same with linearised intervals; how
many intervals hold the truth; and what mean half widths at the truth the chosen, all (a random one) and the
best candidate in hindsight would leave, by differences of the FMU. Every truth is kept in the JSON file as
soon as it ends; gates nothing.
"""

import argparse
import json
import os
import re
import shutil
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT)]

from simulation import Case, load_case  # noqa: E402
from simulation.arrays import FloatArray  # noqa: E402
from simulation.case import named_experiments  # noqa: E402
from simulation.other_inputs import settings_with_inputs  # noqa: E402
from studies import calibrate, next_experiment, uncertainty  # noqa: E402
from studies.calibration.differences import difference_rows, difference_slopes  # noqa: E402
from studies.calibration.uncertainty.information import covariance, half_widths  # noqa: E402
from studies.words.console import Console  # noqa: E402

STEP = 0.01
DAYS = ((0, 4), (4, 8), (8, 12), (12, 16), (16, 20))
ROOMS = ("heater-1", "cooling", "heater-2", "in-turn", "random", "together")
WEATHER = {
    "base": (0.0, 3.0),
    "cold": (-8.0, 3.0),
    "mild": (7.0, 2.0),
    "swing": (0.0, 9.0),
    "warm": (14.0, 3.0),
}


def office_text() -> str:
    """Return the office's case file, for four days."""
    text = (ROOT / "fmus" / "office" / "case.toml").read_text("utf-8")
    text = text[: text.index("# Best errors known")].replace('"office"', '"now"', 1)
    text = text.replace("uncertainty = 0.5", "uncertainty = 0.1").replace("[0, 10]", "[0, 4]")
    text = text.replace('{ first_measured = "TAir" }', "296.15")
    return text.replace("Office.fmu", str(ROOT / "fmus/office/Office.fmu")).replace(
        "../../data/office", "../../data"
    )


def rooms_text() -> str:
    """Return the case file of the two rooms, all experiments but the first held out."""
    text = (ROOT / "fmus" / "two-rooms" / "case.toml").read_text("utf-8").replace('"two-rooms"', '"now"', 1)
    head, *tables = text.split("[[experiments]]")
    head = re.sub(r'\[\[parameters\]\]\nname = "TWallStart".*?(?=\n\[)', "", head, flags=re.S)
    head = head.replace('{ first_measured = "TRoom1" }', "293.15").replace(
        '{ first_measured = "TRoom2" }', "293.15"
    )
    head = head.replace("GDoor = 0.0", "GDoor = 0.0\nTWallStart = 291.15")
    by_name = {table.split('"')[1]: table.rstrip() + "\n" for table in tables}
    kept = [by_name[name] + ("held_out = true\n" if name != ROOMS[0] else "") + "\n" for name in ROOMS]
    text = "[[experiments]]".join([head, *kept])
    text = text.replace("TwoRooms.fmu", str(ROOT / "fmus/two-rooms/TwoRooms.fmu"))
    return text.replace("../../data/two-rooms", "../../data")


def pump_text() -> str:
    """Return the heat pump's case file."""
    folder = ROOT / "tests" / "benchmarks" / "fewest_calls" / "heat_pump"
    text = (folder / "case.toml").read_text("utf-8").replace('"heat-pump"', '"now"', 1)
    return text.replace("HeatPump.fmu", str(folder / "HeatPump.fmu")).replace(
        'data = "."', 'data = "../../data/base"'
    )


TEXTS = {"office": office_text, "two-rooms": rooms_text, "heat-pump": pump_text}


def columns_of(file: Path) -> tuple[list[str], FloatArray]:
    """Read a CSV file of numbers."""
    head, *rows = file.read_text("utf-8").splitlines()
    return head.split(","), np.array([[float(cell or "nan") for cell in row.split(",")] for row in rows])


def write_csv(file: Path, names: Sequence[str], values: FloatArray) -> None:
    """Write a CSV file of numbers; what is not finite is left empty."""
    rows = [",".join("" if np.isnan(cell) else f"{cell:.10g}" for cell in row) for row in values]
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("\n".join([",".join(names), *rows]) + "\n", "utf-8")


def prepare(name: str, folder: Path) -> Case:
    """Write a project with the case and inputs whose outputs are still to be measured."""
    place = folder / "fmus" / "now"
    place.mkdir(parents=True, exist_ok=True)
    (folder / "studies.toml").write_text("schema = 1\n", "utf-8")
    (place / "case.toml").write_text(TEXTS[name](), "utf-8")
    if name == "heat-pump":
        time = np.arange(0.0, 86401.0, 300.0)
        for kind, (mean, swing) in WEATHER.items():
            outdoor = mean + swing * np.sin(2.0 * np.pi * (time / 86400.0 - 0.4))
            values = np.column_stack([time, outdoor, np.full(len(time), 20.0), np.zeros(len(time))])
            write_csv(
                folder / "data" / kind / "measured.csv",
                ("time_s", "TOutdoor_degC", "TAir_degC", "heat_kWh"),
                values,
            )
            shutil.copy(folder / "data" / kind / "measured.csv", folder / f"{kind}.csv")
    else:
        shutil.copytree(ROOT / "data" / name, folder / "data", dirs_exist_ok=True)
    return load_case(place)


def measurable(name: str, case: Case, folder: Path) -> dict[str, Case]:
    """Return what may be measured by its name, the present measurement first."""
    if name == "office":
        loaded = (load_case(case.path, window_d=days) for days in DAYS)
        return {f"days-{days[0]}-{days[1]}": one for days, one in zip(DAYS, loaded, strict=True)}
    if name == "two-rooms":
        return dict(named_experiments(case))
    found = {}
    for kind in WEATHER:
        settings = settings_with_inputs(case, folder / f"{kind}.csv")
        found[kind] = replace(case, settings=settings, scenario=settings.scenario)
    return found


def measure(
    name: str, every: dict[str, Case], theta: FloatArray, folder: Path, rng: np.random.Generator
) -> None:
    """Write what a truth would have shown, with noise."""
    for kind, case in every.items():
        with case.open_model() as model:
            answer = model.simulate(theta)
        y = answer.y[0] + case.measurement.uncertainty * rng.standard_normal(answer.y[0].shape)
        file = (
            folder
            / "data"
            / {"office": "recording_1800s.csv", "two-rooms": "recording.csv"}.get(
                name, f"{kind}/measured.csv"
            )
        )
        names, values = columns_of(file)
        columns = {"office": ["TRoom_degC"], "two-rooms": ["TRoom1_degC", "TRoom2_degC"]}.get(
            name, ["TAir_degC", "heat_kWh"]
        )
        rows = np.searchsorted(values[:, 0], answer.time - 1e-6)
        for column, series in zip(columns, y.T, strict=True):
            values[rows, names.index(column)] = series
        write_csv(file, names, values)


def hindsight(every: dict[str, Case], u: FloatArray) -> dict[str, FloatArray]:
    """Return the half widths that each measurement beside the present one leaves at the truth."""
    found, p = {}, len(u)
    for kind, case in every.items():
        rows = difference_rows(u, STEP)
        with case.open_model() as model:
            y = model.simulate(case.parameter_space.from_unit(rows)).y / case.measurement.uncertainty
        slopes = difference_slopes(rows, y.reshape(len(rows), -1))
        found[kind] = slopes @ slopes.T
    present, *others = found
    return {kind: half_widths(covariance(found[present] + found[kind], None)) for kind in others if p}


def one(name: str, folder: Path, seed: int) -> dict[str, Any]:
    """Draw a truth, calibrate, plan, add the best experiment, calibrate again."""
    rng = np.random.default_rng([621, seed])
    case = prepare(name, folder)
    every = measurable(name, case, folder)
    space = case.parameter_space
    u = 0.2 + 0.6 * rng.random(space.n_parameters)
    measure(name, every, space.from_unit(u[None]), folder, rng)
    quiet = Console(as_json=True, quiet=True)
    before = calibrate(str(folder / "fmus" / "now"), console=quiet)
    others = [folder / f"{kind}.csv" for kind in list(every)[1:]] if name == "heat-pump" else None
    planned = next_experiment(str(folder / "fmus" / "now"), inputs=others, console=quiet)
    found = planned.outcome.result
    best, promised = found.candidates[0], np.array(list(found.candidates[0].half_widths.values()))
    text = (folder / "fmus" / "now" / "case.toml").read_text("utf-8").replace('"now"', '"then"', 1)
    if name == "two-rooms":
        text = re.sub(
            rf'(name = "{best.name}"\n[^\[]*(?:\[[^\]\[]*\][^\[]*)*?)held_out = true\n', r"\1", text, count=1
        )
    else:
        text += "\n" + (folder / found.block).read_text("utf-8")
    if name == "heat-pump":
        text = text.replace('data = "..."', f'data = "../../data/{best.name}"')
    place = folder / "fmus" / "then"
    place.mkdir(exist_ok=True)
    (place / "case.toml").write_text(text, "utf-8")
    again = {"vary": ["TAmb=-5:5"]} if name == "office" else {"inputs": others} if others else {}
    after = calibrate(str(place), console=quiet)
    assert [*after.theta.index] == [*space.names], "the same parameters"
    widths = next_experiment(str(place), console=quiet, **again).half_widths["now"].to_numpy()
    sure = uncertainty(str(place), console=quiet).outcome.result
    low, high = space.to_unit(np.array([known.interval for known in sure.parameters.values()]).T)
    later = {kind: float(one.mean()) for kind, one in hindsight(every, u).items()}
    return {
        "best": best.name,
        "by_equations": best.by_equations,
        "calls": [before.calls, found.n_calls, after.calls],
        "shrinks_to": best.shrinks_to,
        "kept": float(np.exp(np.mean(np.log(0.5 * (high - low) / promised)))),
        "kept_linear": float(np.exp(np.mean(np.log(widths / promised)))),
        "held": int(((low <= u) & (u <= high)).sum()),
        "of": len(u),
        "hindsight": later,
    }


def main() -> None:
    """Judge all truths and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cases", nargs="*", default=list(TEXTS))
    parser.add_argument("--truths", type=int, default=4)
    parser.add_argument("--first-seed", type=int, default=300)
    parser.add_argument("--folder", type=Path, default=ROOT / "mlruns" / "benchmarks" / "next_experiment")
    options = parser.parse_args()
    folder = options.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "found.json"
    print("| case | truth | best | widths / promised (linear) | hold | hindsight: chosen random best | FMU |")
    print("|---|---:|---|---:|---:|---|---|")
    for name in options.cases:
        ratios = []
        for seed in range(options.first_seed, options.first_seed + options.truths):
            kept: dict[str, Any] = json.loads(file.read_text()) if file.is_file() else {}
            key = f"{name} {seed}"
            if key not in kept:
                project = folder / name / str(seed)
                shutil.rmtree(project, ignore_errors=True)
                project.mkdir(parents=True)
                os.chdir(project)
                kept[key] = one(name, project, seed)
                part = file.with_suffix(".part")
                part.write_text(json.dumps(kept, indent=1) + "\n")
                part.replace(file)
            found = kept[key]
            ratios.append(found["kept"])
            later = found["hindsight"]
            cells = [
                name,
                str(seed),
                found["best"],
                f"{found['kept']:.2f} ({found['kept_linear']:.2f})",
                f"{found['held']} of {found['of']}",
                f"{later[found['best']]:.3f} {np.mean(list(later.values())):.3f} {min(later.values()):.3f}",
                "+".join(map(str, found["calls"])),
            ]
            print(f"| {' | '.join(cells)} |", flush=True)
        print(f"{name}: median of widths over promised {np.median(ratios):.2f}", flush=True)


if __name__ == "__main__":
    main()

"""Which of four structures `studies choose` chooses, where the true one is known.

Run `python tests/benchmarks/structure_choice.py [--truths 16] [--noise 0.1]`. The structures are the office
with seven resistances and four capacities (R7C4), without the wall (R5C3), without the internal masses too
(R4C2), and with a core of the ceiling (R8C5). Their Modelica sources are cut from that of the embedded office
and compiled as it is, which needs gcc and the extra `modelica`. Truths are drawn of one structure after the
other, evenly in the middle of its box, simulated by its FMU and disturbed by white noise.

Beforehand each truth is simulated without noise and calibrated with every structure: with the squares L that
structure j leaves there, in noise, its BIC is expected to lie L + (k_j - k) (ln m - 1) above that of the
truth. Where the least of these is above `SEPARATED`, the noise separates the structures. Every truth is kept
in the JSON file as soon as it ends and not repeated. Prints a table; gates nothing.
"""

import argparse
import contextlib
import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT)]

from simulation import Case, Measurement, load_case  # noqa: E402
from studies import choose  # noqa: E402
from studies.calibration.problem import CalibrationProblem  # noqa: E402
from studies.calibration.search.adaptive import Adaptive  # noqa: E402
from studies.calibration.state_equations.experiments_ode import learned_ode, watched_model  # noqa: E402
from studies.calibration.state_equations.states import watching_states  # noqa: E402
from studies.words.console import Console  # noqa: E402

SEPARATED = 6.0
"""Difference of BIC that is strong evidence (Kass and Raftery 1995, doi:10.1080/01621459.1995.10476572)."""
STRUCTURES = ("r4c2", "r5c3", "r7c4", "r8c5")
WALL = ("wall", "wallInside", "wallOutside", "ambientWall")
WITHOUT = {
    "r4c2": (*WALL, "masses", "massesToAir", "zone", "gainMasses"),
    "r5c3": WALL,
    "r7c4": (),
    "r8c5": (),
}
GONE = {
    "r4c2": ("cExt1", "rExt1", "rExt2", "cInt", "rInt", "TAmbEq"),
    "r5c3": ("cExt1", "rExt1", "rExt2", "TAmbEq"),
    "r7c4": (),
    "r8c5": (),
}
CORE = {"cCore": (140000.0, 3500000.0, "J/(m2.K)"), "rCore": (0.0122, 0.305, "m2.K/W")}


def source_of(name: str) -> str:
    """Return the Modelica source of a structure."""
    text = (ROOT / "fmus" / "office" / "Office.mo").read_text(encoding="utf-8")
    head, model = text.split("  model R7C4Office", 1)
    for part in WITHOUT[name]:
        model = re.sub(rf"\n    \w+ {part}\([^;]*;", "", model)
        model = re.sub(rf"\n    connect\([^;]*\b{part}\.[^;]*;", "", model)
    for gone in GONE[name]:
        model = re.sub(rf"\n    (parameter|input) Real {gone}\([^;]*;", "", model)
    if GONE[name]:
        model = re.sub(r"\n    parameter Real TWallInit\([^;]*;", "", model)
    if name == "r4c2":
        model = model.replace(
            "solarToAir*fSol*HGlo + occupantsToAir*qIntOcc*areaFloor*occ", "fSol*HGlo + qIntOcc*areaFloor*occ"
        )
        model = model.replace(
            "    connect(ceiling.port, ceilingToZone.a);",
            "    connect(ceiling.port, ceilingToZone.a);\n    connect(ceilingToZone.b, air.port);",
        )
    if name == "r8c5":
        declared = "".join(
            f'    parameter Real {one}(unit="{unit}", min={low}) = {np.sqrt(low * high):.6g} "core";\n'
            for one, (low, high, unit) in CORE.items()
        )
        model = model.replace("    parameter Real b(", f"{declared}    parameter Real b(", 1)
        model = model.replace(
            "    Conductor window(",
            "    HeatCapacitor core(C=cCore*areaCeiling, TStart=TTABSInit);\n"
            "    Conductor coreToCeiling(G=areaCeiling/rCore);\n    Conductor window(",
            1,
        )
        model = model.replace(
            "connect(pipe.b, ceiling.port);",
            "connect(pipe.b, core.port);\n    connect(core.port, coreToCeiling.a);\n"
            "    connect(coreToCeiling.b, ceiling.port);",
        )
    return f"{head}  model R7C4Office{model}"


def case_of(name: str, noise: float) -> str:
    """Return the case file of a structure."""
    text = (ROOT / "fmus" / "office" / "case.toml").read_text(encoding="utf-8")
    text = text[: text.index("# Best errors known")]
    for gone in GONE[name]:
        text = re.sub(rf'\n\[\[(parameters|inputs)\]\]\nname = "{gone}"\n.*?(?=\n\[)', "", text, flags=re.S)
    if GONE[name]:
        text = re.sub(r"\nTWallInit = [^\n]*", "", text)
    text = text.replace('name = "office"', f'name = "{name}"', 1)
    text = text.replace('fmu = "Office.fmu"', 'fmu = "Model.fmu"')
    text = text.replace('data = "../../data/office"', 'data = "../../data"')
    text = text.replace('TAirInit = { first_measured = "TAir" }', "TAirInit = 296.15")
    text = text.replace("uncertainty = 0.5", f"uncertainty = {noise}")
    if name == "r8c5":
        core = "".join(
            f'[[parameters]]\nname = "{one}"\nlower = {low}\nupper = {high}\n'
            f'unit = "{unit}"\nscale = "log"\n\n'
            for one, (low, high, unit) in CORE.items()
        )
        text = text.replace("[fixed]", f"{core}[fixed]")
    return text


def make_project(folder: Path, noise: float) -> None:
    """Write the four cases and their FMUs to a project, unless they are there."""
    (folder / "data").mkdir(parents=True, exist_ok=True)
    (folder / "studies.toml").write_text("schema = 1\n", encoding="utf-8")
    for name in STRUCTURES:
        place = folder / "fmus" / name
        place.mkdir(parents=True, exist_ok=True)
        (place / "case.toml").write_text(case_of(name, noise), encoding="utf-8")
        if not (place / "Model.fmu").is_file():
            (place / "Office.mo").write_text(source_of(name), encoding="utf-8")
            settings = 'model = "Office.R7C4Office"\nname = "Model"\nsolver = "exact"\nstop_time_s = 864000\n'
            (place / "build.toml").write_text(settings + "step_size_s = 600\n", encoding="utf-8")
            command = [sys.executable, "-m", "fmus.compiler", str(place)]
            subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)


def write_recording(folder: Path, y: np.ndarray) -> None:
    """Write the office's recording with another measured temperature."""
    source = ROOT / "data" / "office"
    (folder / "data" / "occupancy_600s.csv").write_text((source / "occupancy_600s.csv").read_text("utf-8"))
    head, *rows = (source / "recording_1800s.csv").read_text("utf-8").splitlines()
    place = head.split(",").index("TRoom_degC")
    lines = [head]
    for k, row in enumerate(rows):
        cells = row.split(",")
        cells[place] = f"{y[k]:.9g}" if k < len(y) else ""
        lines.append(",".join(cells))
    (folder / "data" / "recording_1800s.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def squares_left(case: Case, y: np.ndarray, noise: float) -> float:
    """Return the least sum of squares, in noise, that a structure leaves of outputs without noise."""
    with watching_states(case).open_model() as opened:
        model = watched_model(case, opened)
        measurement = Measurement.on_grid(
            case.measurement.time, y[:, None], case.measurement.output_names, np.array([noise])
        )
        problem = CalibrationProblem(model, measurement)
        ode = learned_ode(case, model, problem)
        found = Adaptive.for_sensor(noise, max_calls=60).minimize(problem, seed=0, learned_ode=ode)
    return found.mse * len(y) / noise**2


def one(folder: Path, seed: int, noise: float) -> dict[str, Any]:
    """Draw a truth, say whether the noise separates the structures, and let them be compared."""
    rng = np.random.default_rng([62, seed])
    name = STRUCTURES[seed % len(STRUCTURES)]
    write_recording(folder, np.full(481, 20.0))
    case = load_case(folder / "fmus" / name)
    space = case.parameter_space
    theta = space.from_unit(0.15 + 0.7 * rng.random((1, space.n_parameters)))
    with case.open_model() as model:
        y = model.simulate(theta).y[0, :, 0]
    quiet, said = Console(quiet=True), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        write_recording(folder, y + noise * rng.standard_normal(y.shape))
        found = choose([str(folder / "fmus" / j) for j in STRUCTURES], console=quiet)
    m, k, expected = len(y), space.n_parameters, {}
    for j in (j for j in STRUCTURES if j != name):
        other = load_case(folder / "fmus" / j)
        more = other.parameter_space.n_parameters - k
        expected[j] = squares_left(other, y, noise) + more * (np.log(m) - 1.0)
    table = found.table
    columns = ["log_evidence", "log_evidence_error", "probability", "bic", "aic", "left_out_mse", "white"]
    return {
        "truth": name,
        "expected": expected,
        "chosen": found.chosen,
        "reason": found.reason,
        "calls": int(table["n_calls"].sum() + table["n_judged"].sum()),
        **{column: table[column].to_dict() for column in columns},
    }


def main() -> None:
    """Judge all truths and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--truths", type=int, default=16)
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--noise", type=float, default=0.1, help="standard deviation [K]")
    parser.add_argument("--folder", type=Path, default=ROOT / "mlruns" / "benchmarks" / "structure_choice")
    options = parser.parse_args()
    folder = options.folder.resolve() / f"{options.noise:g}"
    make_project(folder, options.noise)
    os.chdir(folder)
    file = folder / "found.json"
    kept: dict[str, Any] = json.loads(file.read_text()) if file.is_file() else {}
    print("| truth | expected difference of BIC | separated | chosen | probabilities | BIC | calls |")
    print("|---|---|---|---|---|---|---:|")
    verdicts = []
    for seed in range(options.first_seed, options.first_seed + options.truths):
        if str(seed) not in kept:
            kept[str(seed)] = one(folder, seed, options.noise)
            part = file.with_suffix(".part")
            part.write_text(json.dumps(kept, indent=1) + "\n")
            part.replace(file)
        found = kept[str(seed)]
        least = min(found["expected"].values())
        verdicts.append((least >= SEPARATED, found["chosen"] == found["truth"], not found["chosen"]))
        nearest = min(found["expected"], key=found["expected"].get)
        bics = np.array(list(found["bic"].values()))
        cells = [
            f"{seed}: {found['truth']}",
            f"{least:.1f} ({nearest})",
            "yes" if least >= SEPARATED else "no",
            found["chosen"] or "the data do not decide",
            " ".join(f"{p:.2f}" for p in found["probability"].values()),
            " ".join(f"+{value:.1f}" for value in bics - bics.min()),
            str(found["calls"]),
        ]
        print(f"| {' | '.join(cells)} |", flush=True)
    for is_separated in (True, False):
        those = [(is_right, is_open) for one, is_right, is_open in verdicts if one == is_separated]
        right, left_open = (sum(one) for one in zip(*those, strict=True)) if those else (0, 0)
        said = "separated" if is_separated else "not separated"
        print(f"{said}: {right} of {len(those)} right, {left_open} left open")


if __name__ == "__main__":
    main()

"""Whether ends of profile likelihoods are where brute force on the FMU finds them, on two-parameter cases.

Run `python tests/benchmarks/profile_crossings.py`. Of embedded cases two parameters stay free, the others are
fixed near the truth. `studies uncertainty --profiles` gives the ends, with state equations and without. Brute
force asks the FMU alone: for each value of a parameter the other one's best by golden sections, for each end
a root. Prints both and their difference over half the interval; gates nothing.
"""

import argparse
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.optimize import brentq, minimize_scalar

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT)]

from simulation import load_case  # noqa: E402
from studies import calibrate  # noqa: E402
from studies.calibration.problem import CalibrationProblem  # noqa: E402
from studies.words.console import Console  # noqa: E402

CASES = {
    "wall": (("G12", "C1"), {"GIn": 63.8, "G23": 7.52, "C2": 2.54e6, "C3": 5.57e5, "T2Start": 285.645}),
    "vanderpol": (("mu", "period"), {"amplitude": 3.2, "xStart": -0.6}),
}


def two_parameters(name: str, folder: Path) -> Path:
    """Write a case with two free parameters; return its folder."""
    text = (ROOT / "fmus" / name / "case.toml").read_text("utf-8")
    text = re.sub(r"\n(# [^\n]*)?\n\[\[references\]\].*", "\n", text, flags=re.S)
    text = re.sub(r"\nvalidation_d[^\n]*", "", text)
    _, fixed = CASES[name]
    for parameter in fixed:
        text = re.sub(rf'\[\[parameters\]\]\nname = "{parameter}"\n.*?(?=\n\[|\Z)', "", text, flags=re.S)
    lines = "".join(f"{key} = {value}\n" for key, value in fixed.items())
    text = (
        text.replace("[fixed]\n", f"[fixed]\n{lines}") if "[fixed]\n" in text else f"{text}\n[fixed]\n{lines}"
    )
    text = re.sub(r'\n(fmu|data) = "(.*?)"', lambda m: f'\n{m[1]} = "{ROOT / "fmus" / name / m[2]}"', text)
    place = folder / "fmus" / name
    place.mkdir(parents=True, exist_ok=True)
    (place / "case.toml").write_text(text, "utf-8")
    return place


def brute_force(place: Path, unit: float, limit: float, best: np.ndarray) -> np.ndarray:
    """Return the ends of both profiles by the FMU. Shape (2, 2). [per parameter]."""
    case = load_case(place)
    with case.open_model() as model:
        problem = CalibrationProblem(model, case.measurement)

        def profile(j: int, value: float) -> float:
            def error(other: float) -> float:
                return float(problem.mse(np.array([[value, other] if j == 0 else [other, value]]))[0])

            near = float(best[1 - j])
            bounds = max(near - 0.1, 0.0), min(near + 0.1, 1.0)
            return float(minimize_scalar(error, bounds=bounds, method="bounded", options={"xatol": 1e-6}).fun)

        least = minimize_scalar(lambda value: profile(0, value), bounds=(best[0] - 0.05, best[0] + 0.05),
                                method="bounded", options={"xatol": 1e-6}).fun  # fmt: skip
        ends = np.empty((2, 2))
        for j in (0, 1):
            rise: Callable[[float], float] = lambda value, j=j: (profile(j, value) - least) / unit - limit  # noqa: E731
            for k, side in enumerate((-1.0, 1.0)):
                far = 1e-3
                while 0.0 < best[j] + side * far < 1.0 and rise(best[j] + side * far) < 0.0:
                    far *= 2.0
                point = best.copy()
                end = float(np.clip(best[j] + side * far, 0.0, 1.0))
                point[j] = end if rise(end) < 0.0 else brentq(rise, best[j], end, xtol=1e-7)
                ends[k, j] = case.parameter_space.from_unit(point)[j]
    return ends


def main() -> None:
    """Compare all and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--folder", type=Path, default=ROOT / "mlruns" / "benchmarks" / "profile_crossings")
    folder = parser.parse_args().folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    print("| case | by | parameter | profile | brute force | off, of half the interval | simulations |")
    print("|---|---|---|---|---|---:|---:|")
    for name in CASES:
        for has_equations in (True, False):
            project = folder / ("equations" if has_equations else "process")
            place = two_parameters(name, project)
            (project / "studies.toml").write_text("schema = 1\n", "utf-8")
            os.chdir(project)
            quiet = Console(as_json=True, quiet=True)
            found = calibrate(str(place), state_equations=None if has_equations else False, console=quiet)
            sure = found.uncertainty(profiles=True)
            assert sure.profiled is not None
            profiled, noise = sure.profiled.result, sure.outcome.result.noise
            space = found.task.case.parameter_space
            best = space.to_unit(found.outcome.result.point)
            ends = brute_force(place, noise.unit, profiled.limit, best)
            for j, parameter in enumerate(space.names):
                low, high = profiled.parameters[parameter].interval
                half = 0.5 * (ends[1, j] - ends[0, j])
                off = max(abs(low - ends[0, j]), abs(high - ends[1, j])) / half
                by = "equations" if profiled.by_equations else "process"
                cells = [
                    name,
                    by,
                    parameter,
                    f"{low:.6g} to {high:.6g}",
                    f"{ends[0, j]:.6g} to {ends[1, j]:.6g}",
                ]
                print(f"| {' | '.join(cells)} | {100 * off:.1f} % | {profiled.n_calls} |", flush=True)


if __name__ == "__main__":
    main()

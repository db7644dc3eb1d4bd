"""How often 90 % intervals hold the truth: calibrations of synthetic measurements whose truth is known.

Run `python tests/benchmarks/interval_coverage.py wall --truths 20 [--rho 0.9] [--noise correlated]`. Every
truth is drawn evenly from the box (in the case's own scales), simulated by the FMU, disturbed by noise of the
sensor's uncertainty that follows itself with correlation rho from sample to sample, calibrated without an
initial guess (adaptive, with state equations where they can be learnt), and judged by `assess`. With
`--experiments 4`, the recording is cut into four experiments that start one after the other (two-rooms has
its own); `--own T2Start` gives each a value of that parameter of its own. With `--declared`, the measurement
says how long its errors last, so that residuals are whitened. Every run is kept in the JSON file as soon as
it ends and not repeated. Prints a table and gates nothing.

The theory beside it is the Cramer-Rao bound: intervals of 2 * 1.645 * sqrt(diag(F^-1)) with the information F
of the samples at the truth, known noise and no box. Where runs with half as many experiments are kept, their
intervals' shrinkage is compared with the theory's.
"""

import argparse
import json
import re
import sys
import tempfile
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from two_rooms_for_tests import two_rooms_with  # noqa: E402

from simulation import Case, ForwardModel, Measurement, Trajectories, load_case  # noqa: E402
from simulation.arrays import FloatArray  # noqa: E402
from simulation.experiments import JoinedModel  # noqa: E402
from simulation.forward_model import WrappedModel  # noqa: E402
from studies.calibration.problem import CalibrationProblem  # noqa: E402
from studies.calibration.search.adaptive import Adaptive  # noqa: E402
from studies.calibration.state_equations.experiments_ode import learned_ode, watched_model  # noqa: E402
from studies.calibration.state_equations.states import WatchedModel, watching_states  # noqa: E402
from studies.calibration.uncertainty.assess import assess, sampling_within  # noqa: E402
from studies.calibration.uncertainty.noise import NoiseKind, noise_of  # noqa: E402
from studies.calibration.uncertainty.rows import joined  # noqa: E402

STEP = 1e-4
"""Step of the differences that information is made of. [1]"""
NORMAL_95 = 1.6449
"""95 % quantile of the normal distribution."""
WIDE = 0.3
"""Intervals that are wider by the theory end at the box, not at the data. [1]"""
ROOMS = ("random", "together", "door", "cooling", "heater-1", "heater-2", "in-turn")
"""Experiments of two-rooms; the first two move all inputs, any one alone does not show all parameters."""


class Diary(WrappedModel):
    """A model that remembers what it answered."""

    def __init__(self, model: ForwardModel) -> None:
        super().__init__(model)
        self.answers: list[Trajectories] = []

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Answer and take note."""
        self.answers.append(self._model.simulate(theta))
        return self.answers[-1]


def disturbed(
    case: Case, y: FloatArray, options: argparse.Namespace, rng: np.random.Generator
) -> Measurement:
    """Return a simulation as a sensor would have measured it."""
    rho, scale = options.rho, options.scale
    noise = rng.standard_normal(y.shape)
    for i in range(1, len(noise)):
        noise[i] = rho * noise[i - 1] + np.sqrt(1.0 - rho**2) * noise[i]
    uncertainty = scale * case.measurement.uncertainty
    measured = y + noise * uncertainty
    time, names = case.measurement.time, case.measurement.output_names
    made = Measurement.on_grid(time, measured, names, uncertainty)
    if not options.declared:
        return made
    lasts_s = float(-(time[1] - time[0]) / np.log(rho))
    return replace(made, outputs=tuple(replace(one, correlation_s=lasts_s) for one in made.outputs))


def in_experiments(case: str, n: int, length_d: float, own: list[str], folder: Path) -> Case:
    """Return a case whose recording is cut into experiments, with own values of some parameters."""
    if case == "two-rooms":
        return two_rooms_with(folder, *ROOMS[:n])
    file = ROOT / "fmus" / case / "case.toml"
    text = file.read_text(encoding="utf-8")
    text = re.sub(r"\n(# [^\n]*)?\n\[\[references\]\].*", "\n", text, flags=re.S)
    text = re.sub(r"\n(start|window|validation)_d = [^\n]*", "", text)
    text = re.sub(r'\n(fmu|data) = "(.*?)"', lambda m: f'\n{m[1]} = "{file.parent / m[2]}"', text)
    for parameter in own:
        declared = f'[[parameters]]\nname = "{parameter}"\n'
        text = text.replace(declared, f"{declared}per_experiment = true\n")
    for k in range(n):
        begin = k * length_d
        text += f'\n[[experiments]]\nname = "e{k}"\ntime = {{ window_d = [{begin}, {begin + length_d}] }}\n'
    (folder / "case.toml").write_text(text, encoding="utf-8")
    return load_case(folder)


def information_widths(
    problem: CalibrationProblem, truth: FloatArray, noise: tuple[float, float]
) -> FloatArray:
    """Return how wide 90 % intervals are by the information of the samples. Shape (p,). [1].

    Args:
        problem: Whose measurement has the same weight for every sample.
        truth: The true point. Shape (p,). [1]
        noise: Standard deviation of a residual [first output's unit], correlation of the noise [1].
    """
    (deviation, rho), step = noise, STEP * np.eye(len(truth))
    ends = np.concatenate([truth + step, truth - step])
    # A truth beside a bound is no reason not to look beyond it.
    answer = problem.judge(ends, problem.model.simulate(problem.space.from_unit(ends)))
    above, below = np.split(answer.residuals, 2)
    slopes = (above - below) / (2.0 * STEP * deviation)
    information = slopes @ slopes.T * (1.0 - rho) / (1.0 + rho)
    return np.asarray(2.0 * NORMAL_95 * np.sqrt(np.diag(np.linalg.inv(information))))


def one(case: Case, model: WatchedModel, seed: int, options: argparse.Namespace) -> dict[str, Any]:
    """Draw a truth, calibrate, and say which intervals hold it."""
    rng = np.random.default_rng(seed)
    space = case.parameter_space
    truth = rng.random(space.n_parameters)
    y = model.simulate(space.from_unit(truth[None])).y[0]
    measurement = disturbed(case, y, options, rng)
    diary = Diary(model)
    asked = CalibrationProblem(diary, measurement, layout=case.layout)
    ode = learned_ode(case, model, asked)
    found = Adaptive(max_calls=options.calibration_calls, ftol=1e-4).minimize(
        asked, seed=seed, learned_ode=ode
    )
    problem = CalibrationProblem(model, measurement)
    known = [problem.judge(space.to_unit(answer.theta), answer) for answer in diary.answers]
    noise = noise_of(options.noise, measurement, found.y, space.n_parameters)
    judged = assess(
        problem, found.theta, found.y, noise=noise, known=joined(known),
        sampling=sampling_within(options.max_calls, space.n_parameters), seed=seed,
        emulator=ode.model,
    )  # fmt: skip
    low, _, high = judged.interval
    linear_low, linear_high = judged.linear
    sample = judged.sample
    return {
        "mse_over_truth": found.mse / float(problem.mse(truth[None])[0]),
        "n_independent": noise.n_independent,
        "held": ((low <= truth) & (truth <= high)).tolist(),
        "held_linear": ((linear_low <= truth) & (truth <= linear_high)).tolist(),
        "rank": np.mean(sample.particles < truth, axis=0).tolist(),
        "width": (high - low).tolist(),
        "width_linear": (linear_high - linear_low).tolist(),
        "worth": sample.n_effective / len(sample.weights),
        "calls": [found.n_calls, judged.n_calls],
        "theory": information_widths(
            problem, truth, (float(measurement.uncertainty[0]), 0.0 if options.declared else options.rho)
        ).tolist(),
        "off": (space.to_unit(found.theta) - truth).tolist(),
    }


def median(values: FloatArray, *, mean: bool = False) -> float:
    """Return the median or mean of values, NaN of none."""
    return float(np.mean(values) if mean else np.median(values)) if values.size else float("nan")


def print_shrinkage(
    before: list[dict[str, Any]], after: list[dict[str, Any]], names: tuple[str, ...]
) -> None:
    """Print how intervals shrink with twice the experiments, beside the theory.

    Args:
        before: Runs with half the experiments, of the same truths.
        after: Runs with all.
        names: Names of the parameters; those that come first are the same in both.
    """
    n = min(len(before[0]["theory"]), len(names))
    widths = {
        key: [np.array([run[key][:n] for run in runs]) for runs in (before, after)]
        for key in ("width", "theory")
    }
    is_narrow = widths["theory"][0] < WIDE
    found, theory = (np.where(is_narrow, b / a, np.nan) for a, b in widths.values())
    print("\n| parameter | truths | intervals shrink to | theory | one by the other |\n|---|---|---|---|---|")
    for j in range(n):
        if is_narrow[:, j].any():
            medians = [float(np.nanmedian(one[:, j])) for one in (found, theory, found / theory)]
            cells = " | ".join(f"{one:.2f}" for one in medians)
            print(f"| {names[j]} | {is_narrow[:, j].sum()} | {cells} |")


def main() -> None:
    """Read the options, run what is missing, print all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("case", help="name of a case in fmus/")
    parser.add_argument("--truths", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument(
        "--rho", type=float, default=0.0, help="correlation of the noise from sample to sample"
    )
    parser.add_argument(
        "--declared", action="store_true", help="the measurement says how long its errors last"
    )
    parser.add_argument("--scale", type=float, default=1.0, help="noise over the sensor's uncertainty")
    parser.add_argument(
        "--noise", choices=get_args(NoiseKind), default="correlated", help="what it is taken for"
    )
    parser.add_argument("--experiments", type=int, help="how many of --days; default: the case's window")
    parser.add_argument("--own", nargs="*", default=[], help="parameters with a value per experiment")
    parser.add_argument("--days", type=float, default=0.75, help="length of an experiment")
    parser.add_argument("--max-calls", type=int, default=100, help="of each assessment")
    parser.add_argument("--calibration-calls", type=int, default=100)
    parser.add_argument(
        "--json", type=Path, default=ROOT / "mlruns" / "benchmarks" / "interval_coverage.json"
    )
    options = parser.parse_args()
    if options.declared and not 0.0 < options.rho < 1.0:
        parser.error("--declared needs --rho between 0 and 1")
    kept: dict[str, Any] = json.loads(options.json.read_text()) if options.json.is_file() else {}
    case = load_case(ROOT / "fmus" / options.case)
    if options.experiments is not None:
        with tempfile.TemporaryDirectory() as folder:
            case = in_experiments(options.case, options.experiments, options.days, options.own, Path(folder))
    declared = " declared" if options.declared else ""
    said = f"rho {options.rho:g}{declared} | scale {options.scale:g} | {options.noise} | {options.max_calls}"
    own = "".join(f", own {one}" for one in options.own)

    def name_of(n: int | None) -> str:
        length = "its own" if options.case == "two-rooms" else f"{options.days:g} d{own}"
        cut = "" if n is None else f" in {n} of {length}"
        return f"{options.case}{cut} | {said}"

    name = name_of(options.experiments)
    seeds = range(options.first_seed, options.first_seed + options.truths)
    with_states = watching_states(case)
    with ExitStack() as stack:
        if case.layout is None:
            opened: ForwardModel = stack.enter_context(with_states.open_model())
        else:
            rows = with_states.experiment_rows
            parts = stack.enter_context(closing(rows.open()))
            opened = JoinedModel(parts, rows, case.parameter_space)
        model = watched_model(case, opened)
        for seed in seeds:
            key = f"{name} | {seed}"
            if key not in kept:
                kept[key] = one(case, model, seed, options)
                options.json.parent.mkdir(parents=True, exist_ok=True)
                part = options.json.with_suffix(".part")
                part.write_text(json.dumps(kept) + "\n")
                part.replace(options.json)
    runs = [kept[f"{name} | {seed}"] for seed in seeds]
    error, worth = (float(np.median([run[key] for run in runs])) for key in ("mse_over_truth", "worth"))
    calls = np.median([run["calls"] for run in runs], axis=0)
    print(
        f"{name}: {len(runs)} truths, median MSE / the truth's {error:.3f}, calls {calls}, worth {worth:.2f}"
    )
    held, width, held_linear, width_linear, theory, off = (
        np.array([run[key] for run in runs], dtype=float)
        for key in ("held", "width", "held_linear", "width_linear", "theory", "off")
    )
    # Of the determined ones, how wide intervals are by the theory, and how far off in its deviations.
    is_narrow = theory < WIDE
    ratio = np.where(is_narrow, width / theory, np.nan)
    score = np.where(is_narrow, off * 2.0 * NORMAL_95 / theory, np.nan)
    names = case.parameter_space.names
    print(
        "| parameter | posterior holds | width | linearised holds | width | truths with a theory | "
        "width / theory, median | off, RMS deviations |\n|" + "---|" * 8
    )
    for j in [*range(len(names)), slice(None)]:
        shares = (float(one[:, j].mean()) for one in (held, width, held_linear, width_linear))
        there = is_narrow[:, j]
        by_theory = [median(ratio[:, j][there]), float(np.sqrt(median(score[:, j][there] ** 2, mean=True)))]
        label = "all" if isinstance(j, slice) else names[j]
        cells = [*(f"{one:.2f}" for one in shares), f"{is_narrow[:, j].sum()}"]
        print(f"| {label} | " + " | ".join([*cells, *(f"{one:.2f}" for one in by_theory)]) + " |")
    half = (
        [] if not options.experiments else [f"{name_of(options.experiments // 2)} | {one}" for one in seeds]
    )
    if half and all(key in kept for key in half):
        print_shrinkage([kept[key] for key in half], runs, names)


if __name__ == "__main__":
    main()

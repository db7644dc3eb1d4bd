"""How often 90 % intervals hold the truth: calibrations of synthetic measurements whose truth is known.

Run `python tests/benchmarks/interval_coverage.py wall --truths 20 [--rho 0.9] [--noise correlated]`. Every
truth is drawn evenly from the box (in the case's own scales), simulated by the FMU, disturbed by noise of the
sensor's uncertainty that follows itself with correlation rho from sample to sample, calibrated without an
initial guess (adaptive, with state equations where they can be learnt), and judged by `assess`. With
`--experiments 4`, the recording is cut into four experiments, each with a start of its own. Every run is
kept in the JSON file as soon as it ends and not repeated. Prints a table and gates nothing.
"""

import argparse
import json
import re
import sys
import tempfile
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, get_args

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from simulation import Case, ForwardModel, Measurement, Trajectories, load_case  # noqa: E402
from simulation.arrays import FloatArray  # noqa: E402
from simulation.experiments import JoinedModel  # noqa: E402
from simulation.forward_model import WrappedModel  # noqa: E402
from studies.calibration.adaptive import Adaptive  # noqa: E402
from studies.calibration.experiments_ode import learned_ode, watched_model  # noqa: E402
from studies.calibration.problem import CalibrationProblem  # noqa: E402
from studies.calibration.states import WatchedModel, watching_states  # noqa: E402
from studies.uncertainty.assess import assess, sampling_within  # noqa: E402
from studies.uncertainty.noise import NoiseKind, noise_of  # noqa: E402
from studies.uncertainty.rows import joined  # noqa: E402


class Diary(WrappedModel):
    """A model that remembers what it answered."""

    def __init__(self, model: ForwardModel) -> None:
        super().__init__(model)
        self.answers: list[Trajectories] = []

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Answer and take note."""
        self.answers.append(self._model.simulate(theta))
        return self.answers[-1]


def disturbed(case: Case, y: FloatArray, rho: float, scale: float, rng: np.random.Generator) -> Measurement:
    """Return a simulation as a sensor would have measured it."""
    noise = rng.standard_normal(y.shape)
    for i in range(1, len(noise)):
        noise[i] = rho * noise[i - 1] + np.sqrt(1.0 - rho**2) * noise[i]
    uncertainty = scale * case.measurement.uncertainty
    measured = y + noise * uncertainty
    return Measurement.on_grid(case.measurement.time, measured, case.measurement.output_names, uncertainty)


def in_experiments(case: str, n: int, length_d: float, folder: Path) -> Case:
    """Return a case whose recording is cut into experiments, each with a start of its own."""
    file = ROOT / "fmus" / case / "case.toml"
    text = file.read_text(encoding="utf-8")
    text = re.sub(r"\n(# [^\n]*)?\n\[\[references\]\].*", "\n", text, flags=re.S)
    text = re.sub(r"\n(start|window|validation)_d = [^\n]*", "", text)
    text = re.sub(r'\n(fmu|data) = "(.*?)"', lambda m: f'\n{m[1]} = "{file.parent / m[2]}"', text)
    for k in range(n):
        begin = k * length_d
        text += f'\n[[experiments]]\nname = "e{k}"\ntime = {{ window_d = [{begin}, {begin + length_d}] }}\n'
    (folder / "case.toml").write_text(text, encoding="utf-8")
    return load_case(folder)


def one(case: Case, model: WatchedModel, seed: int, options: argparse.Namespace) -> dict[str, Any]:
    """Draw a truth, calibrate, and say which intervals hold it."""
    rng = np.random.default_rng(seed)
    space = case.parameter_space
    truth = rng.random(space.n_parameters)
    y = model.simulate(space.from_unit(truth[None])).y[0]
    measurement = disturbed(case, y, options.rho, options.scale, rng)
    diary = Diary(model)
    asked = CalibrationProblem(diary, measurement)
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
    }


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
    parser.add_argument("--scale", type=float, default=1.0, help="noise over the sensor's uncertainty")
    parser.add_argument(
        "--noise", choices=get_args(NoiseKind), default="correlated", help="what it is taken for"
    )
    parser.add_argument("--experiments", type=int, help="how many of --days; default: the case's window")
    parser.add_argument("--days", type=float, default=0.75, help="length of an experiment")
    parser.add_argument("--max-calls", type=int, default=100, help="of each assessment")
    parser.add_argument("--calibration-calls", type=int, default=100)
    parser.add_argument(
        "--json", type=Path, default=ROOT / "mlruns" / "benchmarks" / "interval_coverage.json"
    )
    options = parser.parse_args()
    kept: dict[str, Any] = json.loads(options.json.read_text()) if options.json.is_file() else {}
    case = load_case(ROOT / "fmus" / options.case)
    if options.experiments is not None:
        with tempfile.TemporaryDirectory() as folder:
            case = in_experiments(options.case, options.experiments, options.days, Path(folder))
    said = f"rho {options.rho:g} | scale {options.scale:g} | {options.noise} | {options.max_calls}"
    cut = "" if options.experiments is None else f" in {options.experiments} of {options.days:g} d"
    name = f"{options.case}{cut} | {said}"
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
    print("| parameter | posterior holds | width | linearised holds | width |\n|---|---|---|---|---|")
    columns = [
        np.array([run[key] for run in runs], dtype=float)
        for key in ("held", "width", "held_linear", "width_linear")
    ]
    for j, parameter in enumerate(case.parameter_space.names):
        print(f"| {parameter} | " + " | ".join(f"{column[:, j].mean():.2f}" for column in columns) + " |")
    print("| all | " + " | ".join(f"{column.mean():.2f}" for column in columns) + " |")


if __name__ == "__main__":
    main()

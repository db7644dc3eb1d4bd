"""The search's own processor time beside the simulations: `python tests/benchmarks/thinking_time.py`.

    python tests/benchmarks/thinking_time.py [--cases TEXT ...] [--calls 300] [--seeds 0] [--json FILE]

Every case is calibrated to the end of its calls, whatever is expected. The clock stops while a model answers.
Prints seconds per call by ranges of calls, the longest pause between two calls, and whether all of a run is
within 0.2 s per call plus 2 s. Models are closed forms but for the office, an FMU whose states are not read:
its rows are those of `studies calibrate office --no-state-equations`. Gates nothing.
"""

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from scipy.signal import lfilter

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "calibration")]

from moving_for_tests import Moving  # noqa: E402

from simulation import load_case  # noqa: E402
from simulation.arrays import FloatArray  # noqa: E402
from simulation.forward_model import ForwardModel, WrappedModel  # noqa: E402
from simulation.measurement import Measurement  # noqa: E402
from simulation.parameters import Parameter, ParameterSpace  # noqa: E402
from simulation.trajectories import Trajectories  # noqa: E402
from studies.calibration.hidden_network.inputs import network_of_stores  # noqa: E402
from studies.calibration.problem import CalibrationProblem  # noqa: E402
from studies.calibration.search.adaptive import Adaptive  # noqa: E402
from studies.calibration.state_equations.learned_ode import LearnedODE  # noqa: E402
from studies.calibration.state_equations.states import StateSignals, WatchedModel  # noqa: E402

PER_CALL_S, IN_ALL_S = 0.2, 2.0
RANGE = 50
N_SIGNALS, N_ROOMS = 60, 10


class Clock(WrappedModel):
    """A model that notes how long it was not asked."""

    def __init__(self, model: ForwardModel) -> None:
        """Wrap the model; the time begins to count."""
        super().__init__(model)
        self.pauses: list[float] = []
        self._since = process_time()

    def note(self) -> None:
        """End a pause. [s]."""
        self.pauses.append(process_time() - self._since)

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Simulate every row, with the time stopped."""
        self.note()
        # What of a batch follows the first row took no pause.
        self.pauses += [0.0] * (len(theta) - 1)
        answer = self._model.simulate(theta)
        self._since = process_time()
        return answer


@dataclass(frozen=True, eq=False)
class Delays:
    """First-order lags of signals, added up: an answer of any length with any number of parameters.

    Attributes:
        n_parameters: Every lag has a gain and a time constant; an odd last one adds a constant.
        n_times: Samples.
    """

    n_parameters: int
    n_times: int
    output_names: tuple[str, ...] = ("y",)

    @property
    def time(self) -> FloatArray:
        """Times of the samples. Shape (t,). [s]."""
        return 600.0 * np.arange(self.n_times)

    @property
    def parameter_space(self) -> ParameterSpace:
        """Gains, time constants, and perhaps a constant."""
        kinds = ((0.1, 10.0), (3.0, 300.0))
        bounds = [kinds[place % 2] for place in range(self.n_parameters)]
        return ParameterSpace(
            tuple(Parameter(f"p{place}", *ends, scale="log") for place, ends in enumerate(bounds))
        )

    @property
    def driven(self) -> FloatArray:
        """The signals. Shape (lags, t)."""
        rng = np.random.default_rng(0)
        periods = 1.0 / rng.uniform(0.1, 4.0, (self.n_parameters // 2 + 1, 1))
        waves = np.sin(2.0 * np.pi * (self.time / 86400.0 / periods + rng.random(periods.shape)))
        return waves + 0.3 * rng.standard_normal(waves.shape)

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Filter."""
        y, driven = np.zeros((len(theta), self.n_times)), self.driven
        for row, parameters in enumerate(theta):
            for place in range(self.n_parameters // 2):
                gain, lag = parameters[2 * place : 2 * place + 2]
                keeps = np.exp(-1.0 / lag)
                y[row] += gain * lfilter([1.0 - keeps], [1.0, -keeps], driven[place])
            if self.n_parameters % 2:
                y[row] += parameters[-1]
        names = self.parameter_space.names
        return Trajectories.checked(
            theta, y[..., None], time=self.time, parameter_names=names, output_names=self.output_names
        )


class WeatherInside(WrappedModel):
    """Rooms in a row whose weather no input shows, but variables among many that follow time.

    A room exchanges heat with the next ones and with outside and has gains of its own.
    """

    def __init__(self, rooms: Moving, signals: FloatArray) -> None:
        """Show signals (t, l) beside the states."""
        super().__init__(rooms)
        self._shown = signals
        names = tuple(f"signal{place}" for place in range(signals.shape[1]))
        units = rooms.units[N_ROOMS:]
        self.signals: StateSignals = replace(
            rooms.signals,
            inputs=(),
            units=rooms.units[:N_ROOMS],
            driven=rooms.inputs[:, :0],
            locals=names,
            local_units=tuple(units[place % len(units)] for place in range(len(names))),
        )

    @property
    def output_names(self) -> tuple[str, ...]:
        """Those of the rooms, then the signals."""
        return (*self._model.output_names, *self.signals.locals)

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Simulate; the signals are the same in every row."""
        answer = self._model.simulate(theta)
        shown = np.broadcast_to(self._shown, (len(theta), *self._shown.shape))
        return Trajectories.checked(
            theta,
            np.concatenate([answer.y, shown], axis=2),
            time=self.time,
            parameter_names=answer.parameter_names,
            output_names=self.output_names,
        )


def rooms(kind: str) -> WeatherInside:
    """Return ten rooms, "learnt", or with "terms" or "formulas" in the last one that are not known."""
    rng, n_outputs, every = np.random.default_rng(1), 289, 3
    days = np.arange(n_outputs) / 48.0
    # Outdoor temperature, sun, and gains by schedules; more of all kinds that drive nothing.
    n_kinds = 3
    signals = np.empty((n_outputs, N_SIGNALS))
    for place in range(N_SIGNALS):
        swing = sum(
            np.sin(2.0 * np.pi * (rng.uniform(0.3, 3.0) * days + rng.random())) / rank for rank in (1, 2, 3)
        )
        kinds = (278.0 + 5.0 * swing, np.maximum(300.0 * swing, 0.0), (swing > 0.3).astype(float))
        signals[:, place] = kinds[place % n_kinds]
    names = [f"{kind}{room}" for kind in ("R", "C") for room in range(N_ROOMS)]

    beside = np.eye(N_ROOMS, k=1) + np.eye(N_ROOMS, k=-1)
    between = (beside - np.diag(beside.sum(axis=1))) / 0.02

    def slope(*values: FloatArray) -> list[FloatArray]:
        # Inputs are numbers, all else has a value per row.
        table, (outside, sun, gain) = np.array(values[: 3 * N_ROOMS]), values[3 * N_ROOMS :]
        resistance, capacity, x = np.split(table, 3)
        flow = (outside - x) / resistance + 0.1 * sun + 200.0 * gain + between @ x
        if kind == "formulas":
            capacity[-1] = np.hypot(capacity[-1], 1e8 * resistance[0])
        if kind == "terms":
            flow[-1] += 300.0 * np.tanh(0.3 * (x[-1] - 283.0))
        return list(flow / capacity)

    moving = Moving(
        parameter_space=ParameterSpace(
            tuple(
                Parameter(name, *((0.005, 0.05) if name[0] == "R" else (1e6, 1e7)), scale="log")
                for name in names
            )
        ),
        units=("K",) * N_ROOMS + ("K", "W/m2", ""),
        step_s=600.0,
        inputs=np.repeat(signals[1:, :n_kinds], every, axis=0),
        slope=slope,
        start=lambda *theta: [np.full(len(theta[0]), 285.0 + room) for room in range(N_ROOMS)],
        every=every,
    )
    return WeatherInside(moving, signals)


def measured(model: ForwardModel, y: FloatArray) -> Measurement:
    """Return a measurement of the first output with noise."""
    noise = 0.02 * y.std()
    y = y + noise * np.random.default_rng(0).standard_normal(y.shape)
    return Measurement.on_grid(np.asarray(model.time), y, model.output_names[:1], np.array([noise]))


def by_processes(model: ForwardModel, seed: int, n_calls: int) -> list[float]:
    """Calibrate without state equations; return the pauses. [s]."""
    space = model.parameter_space
    truth = space.from_unit(np.random.default_rng(3).uniform(0.3, 0.7, (1, space.n_parameters)))
    measurement = measured(model, model.simulate(truth).y[0])
    clock = Clock(model)
    # A target that no simulation reaches: the search goes on to the end of the calls.
    Adaptive(max_calls=n_calls, target_mse=0.0).minimize(CalibrationProblem(clock, measurement), seed=seed)
    clock.note()
    return clock.pauses


def by_equations(model: WeatherInside, seed: int, n_calls: int) -> list[float]:
    """Calibrate with state equations; return the pauses. [s]."""
    space = model.parameter_space
    truth = space.from_unit(np.random.default_rng(3).uniform(0.3, 0.7, (1, space.n_parameters)))
    measurement = measured(model, model.simulate(truth).y[0][:, :1])
    clock = Clock(model)
    problem = CalibrationProblem(WatchedModel(clock, model.signals), measurement)
    ode = LearnedODE.of(problem)
    Adaptive(max_calls=n_calls, target_mse=0.0).minimize(problem, seed=seed, learned_ode=ode)
    clock.note()
    return clock.pauses


def office_hidden(seed: int, n_calls: int) -> list[float]:
    """Calibrate the office as the command does where states are not read; return the pauses. [s]."""
    case = load_case(ROOT / "fmus" / "office")
    with case.open_model() as model:
        clock = Clock(model)
        problem = CalibrationProblem(clock, case.measurement)
        settings = Adaptive(max_calls=n_calls, target_mse=0.0)
        settings.minimize(problem, seed=seed, network_inputs=network_of_stores(case))
        clock.note()
    return clock.pauses


CASES: dict[str, Callable[[int, int], list[float]]] = {
    "office without equations": office_hidden,
    "8 parameters, 500 samples": lambda seed, n: by_processes(Delays(8, 500), seed, n),
    "35 parameters, 500 samples": lambda seed, n: by_processes(Delays(35, 500), seed, n),
    "8 parameters, 50,000 samples": lambda seed, n: by_processes(Delays(8, 50_000), seed, n),
    "35 parameters, 50,000 samples": lambda seed, n: by_processes(Delays(35, 50_000), seed, n),
    "60 signals, learnt": lambda seed, n: by_equations(rooms("learnt"), seed, n),
    "60 signals, no terms": lambda seed, n: by_equations(rooms("terms"), seed, n),
    "60 signals, no formulas": lambda seed, n: by_equations(rooms("formulas"), seed, n),
}


def main() -> None:
    """Measure, print, keep."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", nargs="+", metavar="TEXT", help="those whose name begins so; default: all")
    parser.add_argument("--calls", type=int, default=300)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--json", type=Path, help="keep the pauses before every call in this file")
    chosen = parser.parse_args()
    kept: dict[str, Any] = {}
    ends = list(range(RANGE, chosen.calls + 1, RANGE))
    print("| case | seed | calls |" + "".join(f" to {end} |" for end in ends) + " mean | longest | within |")
    print("|---" * 3 + "|---:" * (len(ends) + 3) + "|")
    for name, calibrated in CASES.items():
        if chosen.cases and not any(name.startswith(text) for text in chosen.cases):
            continue
        for seed in chosen.seeds:
            pauses = calibrated(seed, chosen.calls)
            kept[f"{name}, seed {seed}"] = [round(pause, 4) for pause in pauses]
            parts = [pauses[end - RANGE : end] for end in ends]
            means = "".join(f" {sum(part) / len(part):.3f} |" if part else " |" for part in parts)
            n_calls, total = len(pauses) - 1, sum(pauses)
            is_within = total <= PER_CALL_S * n_calls + IN_ALL_S
            print(
                f"| {name} | {seed} | {n_calls} |{means} {total / n_calls:.3f} | {max(pauses):.2f} "
                f"| {'yes' if is_within else 'NO'} |",
                flush=True,
            )
    if chosen.json:
        chosen.json.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

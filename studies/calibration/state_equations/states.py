"""The continuous states of an FMU's model: which there are, and what they did in every simulation.

An FMU declares its states, their derivatives and what these depend on. They are read beside the outputs, so a
simulation shows how the model moves, and not only what its sensors would show.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.case import Case
from simulation.errors import InputError
from simulation.forward_model import ForwardModel, WrappedModel
from simulation.layout import MARK, Experiment, Layout, Names
from simulation.trajectories import Trajectories, wrong_output

# A hundred points of a thousand steps take 0.03 s with 8 states, 0.9 s with 64; a
# round some hundred times that (docs/notes/state-equations.md, Stores and states).
MOST_STATES = 64
"""States above which none is watched: rows grow with their number, equations' costs with its third power."""

MOST_LOCALS = 256
"""Variables beside states that are watched, the first ones of the FMU: a row keeps each at every output."""


@dataclass(frozen=True, eq=False)
class StateSignals:
    """What is known of a model's states before it is simulated.

    Attributes:
        states: Names of the s states.
        derivatives: Names of their derivatives by time, in the same order.
        inputs: Names of the q inputs.
        units: Units of the states, then of the inputs, "" for none. Length s + q.
        depends_on: What each state's derivative may depend on, None where the FMU does not say. Length s.
        driven: Inputs over the communication steps between the first and the last output that is watched.
            Shape (m, q). [FMU's units]
        step_s: Communication step. [s]
        every: Communication steps from one output to the next.
        n_before: First outputs that are watched and not reported.
        outputs: Names of the k outputs, a state or a derivative may be among them.
        conversions: From the FMU's units to theirs: factors and what is added after that. Shape (k, 2).
        accepted: Bands outside of which an output makes its row a failed one, None for none. Shape (k, 2).
        seen: Inputs that the watched outputs see, None where these see their step's. Shape (t, q). [FMU's
            units]
        locals: Names of l other variables that are watched: weather, schedules and gains may be among them.
        local_units: Their units, "" for none. Length l.
        n_hidden: How many of the inputs, the last ones, are variables that follow time (hidden_inputs.py).
        n_switches: How many of the states, the last ones, are positions of switches (switch_positions.py).
        tolerance: Relative tolerance of the FMU's solver. [1]
        time_unit_s: How long the unit of time is that the FMU's derivatives are by. [s]
    """

    states: tuple[str, ...]
    derivatives: tuple[str, ...]
    inputs: tuple[str, ...]
    units: tuple[str, ...]
    depends_on: tuple[frozenset[str] | None, ...]
    driven: FloatArray
    step_s: float
    every: int
    n_before: int
    outputs: tuple[str, ...]
    conversions: FloatArray
    accepted: FloatArray | None = None
    seen: FloatArray | None = None
    locals: tuple[str, ...] = ()
    local_units: tuple[str, ...] = ()
    n_hidden: int = 0
    n_switches: int = 0
    tolerance: float = 0.0
    time_unit_s: float = 1.0

    @classmethod
    def of(cls, case: Case) -> Self:
        """Return what a case's FMU declares.

        Raises:
            InputError: If states cannot be watched, see `why_unwatched`.
        """
        if reason := why_unwatched(case):
            raise InputError(f"{reason}; leave --state-equations away")
        fmu, scenario = case.fmu, case.scenario
        named = (*fmu.states, *scenario.input_names)
        others = _locals(case)
        edges, every = scenario.time_communication, scenario.output_every
        # A row's own warm-up is watched from its start, where states are simple functions of the parameters.
        factors, n_outputs = case.settings.output_factors, len(case.settings.output_names)
        return cls(
            fmu.states,
            fmu.derivatives,
            scenario.input_names,
            tuple(fmu.variables[name].unit for name in named),
            tuple(fmu.depends_on.get(name) for name in fmu.derivatives),
            scenario.inputs,
            float(edges[1] - edges[0]),
            every,
            scenario.n_warmup,
            case.settings.output_names,
            np.column_stack(
                [np.ones(n_outputs) if factors is None else factors, case.settings.output_offsets]
            ),
            case.settings.accepted,
            None if scenario.inputs_at_edges is None else scenario.inputs_at_edges[::every],
            others,
            tuple(fmu.variables[name].unit for name in others),
            tolerance=case.settings.relative_tolerance or fmu.default_experiment.tolerance or 0.0,
            time_unit_s=case.settings.time_unit_s,
        )

    def with_hidden(self, columns: Sequence[int]) -> Self:
        """Return signals of which these alone, among the inputs, are hidden inputs."""
        kept, n_states = [*range(self.n_declared), *columns], len(self.states)
        return replace(
            self,
            inputs=tuple(self.inputs[one] for one in kept),
            units=(*self.units[:n_states], *(self.units[n_states + one] for one in kept)),
            driven=self.driven[:, kept],
            seen=None if self.seen is None else self.seen[:, kept],
            n_hidden=len(columns),
        )

    @property
    def n_declared(self) -> int:
        """Inputs that the FMU declares, the first ones."""
        return len(self.inputs) - self.n_hidden

    @property
    def n_continuous(self) -> int:
        """States that are no positions of switches, the first ones."""
        return len(self.states) - self.n_switches

    @property
    def at_outputs(self) -> FloatArray:
        """Inputs that the watched outputs see: given ones, or their steps'. Shape (t, q)."""
        if self.seen is not None:
            return self.seen
        # Inputs are constant over a step: an output sees the step
        # that ends there, the first one the step that begins.
        return np.concatenate([self.driven[:1], self.driven[self.every - 1 :: self.every]])


class StateRows(NamedTuple):
    """What states and outputs did in n rows, a warm-up of their own included.

    Attributes:
        x: States. Shape (n, t, s). [FMU's units]
        slope: Their derivatives by time. Shape (n, t, s). [FMU's units per second]
        y: Outputs. Shape (n, t, k). [per output]
        locals: Other variables, None where none is watched. Shape (n, t, l). [FMU's units]
    """

    x: FloatArray
    slope: FloatArray
    y: FloatArray
    locals: FloatArray | None = None

    @property
    def are_known(self) -> BoolArray:
        """In which rows states, derivatives and outputs are. Shape (n,)."""
        return np.asarray(np.all([np.isfinite(part).all(axis=(1, 2)) for part in self[:3]], axis=0))

    def take(self, rows: slice | BoolArray) -> Self:
        """Return some of the rows."""
        others = None if self.locals is None else self.locals[rows]
        return type(self)(self.x[rows], self.slope[rows], self.y[rows], others)


def why_unwatched(case: Case) -> str:
    """Say in a line why the states of a case's FMU cannot be watched, "" where they can."""
    fmu = case.fmu
    if case.experiments:
        return next(filter(None, map(why_unwatched, case.experiments)), "")
    if not fmu.states:
        return f"{fmu.path}: declares no states, so nothing can be learnt from them"
    if len(fmu.states) > MOST_STATES:
        return f"{fmu.path}: has {len(fmu.states)} states, and at most {MOST_STATES} are watched"
    for name in (*fmu.states, *fmu.derivatives):
        if fmu.variables[name].kind not in ("Real", "Float64") or fmu.variables[name].shape:
            return f"{fmu.path}: {name} is no scalar of 64 bits, which states have to be"
        if fmu.variables[name].namesakes:
            return f"{fmu.path}: {fmu.variables[name].twice}"
    return ""


def _locals(case: Case) -> tuple[str, ...]:
    """Return variables that may follow time alone: numbers that change, each once, and no states."""
    fmu, scenario = case.fmu, case.scenario
    taken = (*fmu.states, *fmu.derivatives, *scenario.input_names, *case.settings.output_names)
    # Aliases share a kind and a value reference (FMI standard); one of them is enough.
    known = {(fmu.variables[name].kind, fmu.variables[name].reference) for name in taken}
    found = list[str]()
    for name, one in fmu.variables.items():
        is_signal = one.causality in ("local", "output") and one.variability in ("continuous", "discrete")
        is_number = one.kind in ("Real", "Float64") and not one.shape
        if is_signal and is_number and not one.namesakes and (one.kind, one.reference) not in known:
            known.add((one.kind, one.reference))
            found.append(name)
    return tuple(found[:MOST_LOCALS])


def watching_states(case: Case) -> Case:
    """Return a case whose model answers its states and their derivatives, too.

    Raises:
        InputError: If states cannot be watched, see `why_unwatched`.
    """
    if case.layout is not None:
        members = tuple(watching_states(one) for one in case.experiments)
        return replace(case, experiments=members, layout=_watching(case.layout, members))
    signals, settings = StateSignals.of(case), case.settings
    named = (*signals.states, *signals.derivatives, *signals.locals)
    watched = tuple(name for name in named if name not in settings.output_names)
    n, factors = len(watched), settings.output_factors
    scenario = replace(case.scenario, n_warmup=case.scenario.n_warmup - signals.n_before)
    answering = replace(
        settings,
        scenario=scenario,
        output_names=(*settings.output_names, *watched),
        output_offsets=np.concatenate([settings.output_offsets, np.zeros(n)]),
        output_factors=None if factors is None else np.concatenate([factors, np.ones(n)]),
        # It holds for what is reported, not for states nor for a warm-up that is watched.
        accepted=None,
        is_watched=True,
    )
    return replace(case, settings=answering, scenario=scenario, watched=watched)


def _watching(layout: Layout, members: tuple[Case, ...]) -> Layout:
    """Return how rows of experiments become one with all that is watched."""
    experiments, names = list[Experiment](), list[str]()
    for one, case in zip(layout.experiments, members, strict=True):
        watched = case.settings.output_names
        places = np.arange(len(names), len(names) + len(watched))
        experiments.append(replace(one, outputs=places, n_times=len(case.scenario.time)))
        names += (f"{name}{MARK}{one.name}" for name in watched)
    longest = max((case.scenario.time for case in members), key=len)
    return replace(
        layout, output_names=tuple(names), time=longest - longest[0], experiments=tuple(experiments)
    )


class WatchedModel(WrappedModel):
    """A model that answers its outputs alone and remembers what the states did in its last rows."""

    def __init__(self, model: ForwardModel, signals: StateSignals) -> None:
        """Wrap a model.

        Args:
            model: The model to ask, of a case that watches its states.
            signals: What is known of these.
        """
        super().__init__(model)
        self.signals = signals
        self._n_outputs = len(signals.outputs)
        named = (*signals.states, *signals.derivatives, *signals.locals)
        self._columns = [model.output_names.index(name) for name in named]
        factors, offsets = np.ones(len(model.output_names)), np.zeros(len(model.output_names))
        factors[: self._n_outputs], offsets[: self._n_outputs] = signals.conversions.T
        self._factors, self._offsets = factors[self._columns], offsets[self._columns]
        self._last: dict[bytes, FloatArray] = {}

    @property
    def output_names(self) -> tuple[str, ...]:
        """The outputs, without what is watched."""
        return self.signals.outputs

    @property
    def time(self) -> FloatArray:
        """Times of the outputs that are reported. Shape (t,). [s]."""
        return self._model.time[self.signals.n_before :]

    @property
    def watched_names(self) -> Names:
        """Names of the parameters, and of the outputs and all that is watched."""
        return self._model.parameter_space.names, self._model.output_names

    @property
    def watched_time(self) -> FloatArray:
        """Times at which it is watched. Shape (t,). [s]."""
        return self._model.time

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Simulate every row.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            The outputs.
        """
        self.forget()
        return self.simulate_more(theta)

    def forget(self) -> None:
        """Forget what the states did."""
        self._last = {}

    def simulate_more(self, theta: FloatArray) -> Trajectories:
        """Simulate every row, and remember the rows before, too; see simulate."""
        return self.remember(self._model.simulate(theta))

    def remember(self, watched: Trajectories) -> Trajectories:
        """Keep what the states did in rows that were simulated with them; return the rows' outputs."""
        # Bytes are exact keys: `seen` is asked for the parameters as this simulation answered them.
        self._last |= {row.tobytes(): y for row, y in zip(watched.theta, watched.y, strict=True)}
        y, failures = watched.y[:, self.signals.n_before :, : self._n_outputs], list(watched.failures)
        for row in np.flatnonzero(~watched.failed):
            failures[row] = wrong_output(self.output_names, self.time, y[row], accepted=self.signals.accepted)
        return Trajectories.checked(
            watched.theta,
            y,
            time=self.time,
            parameter_names=watched.parameter_names,
            output_names=self.output_names,
            failures=failures,
        )

    def seen(self, theta: FloatArray) -> StateRows:
        """Return what states and outputs did in rows of the last simulation, NaN where that is not known.

        Args:
            theta: Their parameters, as the simulation answered them. Shape (n, p). [per parameter]
        """
        unknown = np.full((len(self._model.time), len(self._model.output_names)), np.nan)
        rows = np.array([self._last.get(row.tobytes(), unknown) for row in theta]).reshape(-1, *unknown.shape)
        # Equations are learnt in the FMU's units; a state that is an output, too, was converted.
        moved = (rows[..., self._columns] - self._offsets) / self._factors
        n = len(self.signals.states)
        slope = moved[..., n : 2 * n] / self.signals.time_unit_s
        return StateRows(moved[..., :n], slope, rows[..., : self._n_outputs], moved[..., 2 * n :])

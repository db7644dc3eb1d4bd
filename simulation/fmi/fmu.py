"""FmuModel: an FMU as a forward model, run in this process."""

import weakref
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from simulation.arrays import FloatArray
from simulation.fmi import cosimulation
from simulation.fmi.cosimulation import CoSimulation
from simulation.fmi.description import FmuDescription, known_description
from simulation.fmi.instance import FmuInstance
from simulation.fmi.reset_proof import RestartingRunner
from simulation.fmi.row_calls import RunPlan
from simulation.fmi.runner import Solver
from simulation.fmi.start import Start
from simulation.fmi.status import Instance
from simulation.fmi.ties import Tie
from simulation.fmi.unpack import keep, unpacked
from simulation.fmi.variable import FmuVariable, Interface, Value
from simulation.fmi.windows import WindowsFmu
from simulation.fmi.wine import make_wine_folder
from simulation.parameters import ParameterSpace
from simulation.scenario import Scenario
from simulation.trajectories import Trajectories, wrong_number, wrong_output


@dataclass(frozen=True, eq=False)
class FmuSettings:
    """Everything needed to open an FMU as a forward model; plain data that travels to worker processes.

    Attributes:
        path: The FMU.
        parameter_space: The parameters, by the FMU's names, in the declared units.
        scenario: Inputs and times.
        output_names: The FMU's output variables.
        output_offsets: Added to the FMU's outputs, for instance -273.15 from K to degC. Shape (k,).
        fixed: FMU parameters of any type held at a value, in the FMU's units.
        interface: How the FMU is driven.
        relative_tolerance: Of the solver; None for the FMU's own.
        accepted: Band outside of which an output makes its row a failed one, None for no band. Shape (k, 2).
            [declared output units]
        output_factors: The FMU's outputs are multiplied by it before the offset; None for 1. Shape (k,).
        parameter_factors: From the declared unit of a parameter to the FMU's; None for 1. Shape (p,).
        parameter_offsets: Added to a parameter after that; None for 0. Shape (p,). [FMU's units]
        is_watched: Whether outputs may be no numbers without failing their row; who watches checks them.
        ties: Parameters that follow from others.
        time_unit_s: How long one unit of the FMU's own time is. [s]
    """

    path: Path
    parameter_space: ParameterSpace
    scenario: Scenario
    output_names: tuple[str, ...]
    output_offsets: FloatArray
    fixed: Mapping[str, Value] = field(default_factory=dict)
    interface: Interface = "co-simulation"
    relative_tolerance: float | None = None
    accepted: FloatArray | None = None
    output_factors: FloatArray | None = None
    parameter_factors: FloatArray | None = None
    parameter_offsets: FloatArray | None = None
    is_watched: bool = False
    ties: tuple[Tie, ...] = ()
    time_unit_s: float = 1.0

    @property
    def set_names(self) -> tuple[str, ...]:
        """Parameters of a row and those that follow from them."""
        return (*self.parameter_space.names, *(one.name for one in self.ties))

    def parameters_for_fmu(self, row: FloatArray) -> FloatArray:
        """Convert a row from the declared units to the FMU's, and add what is tied. Shapes (p,), (p + r,)."""
        if self.parameter_factors is not None:
            row = row * self.parameter_factors
        if self.parameter_offsets is not None:
            row = row + self.parameter_offsets
        if not self.ties:
            return row
        values = self.parameter_space.named(row)
        numbers = {name: value for name, value in self.fixed.items() if not isinstance(value, str)}
        return np.array([*row, *(one.value(numbers | values) for one in self.ties)])

    def plan(self, description: FmuDescription) -> RunPlan:
        """Find every variable in the FMU.

        Args:
            description: What the FMU says of itself.

        Raises:
            InputError: If the FMU does not have a variable, or has it as something else.
        """
        where, scenario = str(description.path), self.scenario

        def found(names: Iterable[str], causality: str) -> tuple[FmuVariable, ...]:
            is_set_once = causality == "parameter"  # as an input may be
            return tuple(
                description.require(name, causality, where, may_be_input=is_set_once) for name in names
            )

        def held(name: str, value: Value) -> tuple[FmuVariable, Value]:
            variable = description.find(name, "parameter", where, may_be_input=True)
            return variable, variable.held_at(value, f"{where}: fixed.{name}")

        inputs = found(scenario.input_names, "input")
        for variable, values in zip(inputs, scenario.inputs.T, strict=True):
            variable.check_series(values, scenario.time_communication, f"{where}: input {variable.name}")
        suggested = description.default_experiment.tolerance
        return RunPlan(
            calibrated=found(self.set_names, "parameter"),
            fixed=tuple(held(name, value) for name, value in self.fixed.items()),
            input_variables=inputs,
            scenario=scenario,
            outputs=found(self.output_names, "output"),
            tolerance=suggested if self.relative_tolerance is None else self.relative_tolerance,
            time_unit_s=self.time_unit_s,
        )

    def prepare(self) -> None:
        """Read and compile what opening the model needs, for forks of this process; the FMU is not loaded."""
        driven = known_description(self.path).interface(self.interface, str(self.path))
        keep(self.path, driven.binary)
        if driven.is_for_windows:
            return
        if self.interface == "co-simulation":
            cosimulation.prepare()
        else:
            from simulation.fmi import exchange

            exchange.prepare()

    def make_ready(self, on_warning: Callable[[str], None]) -> None:
        """Make what opening the model needs once on a machine: for an FMU for Windows, Wine's folder.

        Args:
            on_warning: Called with one line before something is made.
        """
        if known_description(self.path).interface(self.interface, str(self.path)).is_for_windows:
            make_wine_folder(on_warning)

    def open(self) -> "FmuModel":
        """Open the model; the bound method is the factory that worker processes are given."""
        return FmuModel(self)


class FmuModel:
    """An FMU that answers parameter rows.

    One instance lives as long as the model and is started over between rows (a fresh one costs tens of times
    as much, and processes die after about a thousand). Not for use from several threads at once. The FMU's
    code runs in this process, and takes it along when it crashes: PoolModel keeps it in others.

    Attributes:
        parameter_space: The parameters to calibrate.
        output_names: The outputs.
        time: Output times. Shape (t,). [s]
    """

    def __init__(self, settings: FmuSettings) -> None:
        """Unpack, load and instantiate the FMU.

        Args:
            settings: What to open, and how to drive it.

        Raises:
            InputError: If the FMU cannot be opened or does not have the variables.
        """
        self._settings = settings
        self.parameter_space, self.output_names = settings.parameter_space, settings.output_names
        self.time = settings.scenario.time
        description = known_description(settings.path)
        description.interface(settings.interface, str(settings.path))
        plan = settings.plan(description)
        # The warm-up is simulated into rows that are not handed out.
        self._plan, self._y_simulated = plan, plan.empty_y()
        with ExitStack() as stack:
            driven = description.interface(settings.interface, str(settings.path))
            scratch = unpacked(settings.path, driven.binary)
            # First, so last undone: the library is unloaded before its folder is removed.
            stack.callback(scratch.remove)
            instance, solver = _opened(description, plan, settings.interface, scratch.folder, stack)
            once = driven.can_be_instantiated_only_once_per_process
            self._runner = RestartingRunner(instance, solver, trusting=once)
            # The finalizer runs at close(), when the model is forgotten, or when the interpreter ends.
            # With an error above, the stack undoes all at once instead.
            self._finalizer = weakref.finalize(self, stack.pop_all().close)

    @property
    def way(self) -> str:
        """How rows are started over: "undecided" (yet), "reset", "state", "new instance" or "new process"."""
        return self._runner.way

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Simulate every row; one that is NaN, is refused by the FMU or ends in NaN fails with the reason.

        Args:
            theta: Parameters. Shape (n, p). [model's units]

        Returns:
            The trajectories. y of shape (n, t, k). [declared output units]

        Raises:
            NeedsFreshProcess: If the FMU cannot go on in this process; the answers so far are lost.
        """
        if not self._finalizer.alive:
            raise ValueError("the model is closed; open it again")
        theta, names = self.parameter_space.rows(theta), self.parameter_space.names
        y = np.empty((len(theta), len(self.time), len(self.output_names)))
        failures = tuple(map(self._simulate_row, theta, y))
        return Trajectories(theta, y, self.time, names, self.output_names, failures)

    def _simulate_row(self, row: FloatArray, y: FloatArray) -> str:
        """Fill y with one row's outputs; return why it failed, "" when it did not."""
        settings = self._settings
        reason = wrong_number(self.parameter_space.names, row)
        if not reason:
            # A NaN parameter raises nothing in most FMUs, so such a row is never handed over.
            values = settings.parameters_for_fmu(row)
            reason = wrong_number(settings.set_names, values) or self._runner.run(values, self._y_simulated)
        if not reason:
            simulated = self._plan.outputs_of(self._y_simulated[settings.scenario.n_warmup :])
            if settings.output_factors is not None:
                simulated = np.multiply(simulated, settings.output_factors, out=y)
            np.add(simulated, settings.output_offsets, out=y)
            if not settings.is_watched:
                reason = wrong_output(self.output_names, self.time, y, accepted=settings.accepted)
        if reason:
            y[:] = np.nan
        return reason

    def close(self) -> None:
        """Free the instance and remove the unpacked folder; closing twice does no harm."""
        self._finalizer()

    def __enter__(self) -> "FmuModel":
        """Return the open model."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the model."""
        self.close()


def _opened(
    description: FmuDescription, plan: RunPlan, interface: Interface, folder: Path, stack: ExitStack
) -> tuple[Instance, Solver]:
    """Load the FMU and choose its solver.

    Args:
        description: What it says of itself.
        plan: What is set, stepped through and read.
        interface: How it is to be driven.
        folder: Where it is unpacked.
        stack: Closes it.
    """
    if description.interfaces[interface].is_for_windows:
        windows = WindowsFmu(description, interface, folder, plan)
        stack.callback(windows.close)
        return windows, windows
    instance = FmuInstance(description, interface, folder)
    stack.callback(instance.close)
    start = Start(instance, plan)
    if interface == "co-simulation":
        return instance, CoSimulation(instance, plan, start)
    # Here, because it loads CVODE and compiles its callbacks.
    from simulation.fmi.exchange import ModelExchange

    return instance, ModelExchange(instance, plan, start, description=description)

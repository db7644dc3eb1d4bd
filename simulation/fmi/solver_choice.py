"""Which solver an FMU gets, and how it may be started over."""

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.fmi.cosimulation import CoSimulation, SharedWarmup
from simulation.fmi.description import FmuDescription
from simulation.fmi.instance import FmuInstance
from simulation.fmi.reset_proof import RestartingRunner, Way
from simulation.fmi.runner import Solver
from simulation.fmi.start import RunPlan, Start
from simulation.fmi.variable import FmuInterface, Interface


def runner_for(
    instance: FmuInstance,
    description: FmuDescription,
    plan: RunPlan,
    *,
    interface: Interface,
    warmup: FloatArray | None,
) -> RestartingRunner:
    """Choose the solver of an FMU, and the ways to start it over.

    Args:
        instance: The FMU, just instantiated.
        description: What it says of itself.
        plan: What is set, stepped through and read.
        interface: How it is to be driven.
        warmup: Parameters of a warm-up that all rows share, None for a warm-up of each row's own. Shape (p,).
            [FMU's units]

    Returns:
        What answers rows.

    Raises:
        InputError: If the FMU cannot do what is asked for.
    """
    where = str(description.path)
    said = description.interface(interface, where)
    start = Start(instance, plan)
    if warmup is not None:
        _check_shared_warmup(where, interface, said, plan)
        shared = SharedWarmup(CoSimulation(instance, plan, start), plan, start, warmup)
        return RestartingRunner(
            instance, shared, ways=("state",), trusting=True, prepare=shared.prepare, n_ignored=plan.n_warmup
        )
    solver: Solver
    if interface == "co-simulation":
        solver = CoSimulation(instance, plan, start)
    else:
        # Here, because it loads CVODE and compiles its callbacks.
        from simulation.fmi.exchange import ModelExchange

        solver = ModelExchange(instance, plan, start, description=description)
    once = said.can_be_instantiated_only_once_per_process
    ways: tuple[Way, ...] = ("reset", "state") if said.can_get_and_set_state else ("reset",)
    # With one instance there is no second try: the surer way goes first.
    return RestartingRunner(instance, solver, ways=ways[::-1] if once else ways, trusting=once)


def _check_shared_warmup(where: str, interface: Interface, said: FmuInterface, plan: RunPlan) -> None:
    if interface != "co-simulation" or not said.can_get_and_set_state:
        raise InputError(
            f"{where}: shared_warmup = true needs a co-simulation FMU that can get and set its state; "
            "this one cannot, drop shared_warmup"
        )
    for variable in plan.calibrated:
        if variable.causality != "parameter" or variable.variability != "tunable":
            raise InputError(
                f"{where}: shared_warmup = true, but {variable.name} can only be set before the warm-up "
                f"(it is {variable.variability}, not tunable); drop shared_warmup"
            )

"""Model exchange: our loop around CVODE against FMPy's, in time and in accuracy.

Run `python tests/benchmarks/exchange_speed.py`; it prints one JSON document. Needs fmus/office/Office.fmu:
its exact co-simulation is what both are measured by.
"""

import dataclasses
import json
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import numpy as np

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from simulation import load_case  # noqa: E402
from simulation.fmi.fmu import FmuSettings  # noqa: E402


def cpu_ms(work: Callable[[], object], repeats: int) -> float:
    """Least CPU time of some repeats: the others were disturbed."""
    times = []
    for _ in range(repeats):
        before = time.process_time()
        work()
        times.append(time.process_time() - before)
    return min(times) * 1e3


def signals(settings: FmuSettings) -> Any:
    """Describe held inputs to FMPy: two rows at each edge, the value before it and the value after it."""
    edges, inputs = settings.scenario.time_communication, settings.scenario.inputs
    names = settings.scenario.input_names
    rows = np.zeros(2 * len(inputs), dtype=[("time", float), *((name, float) for name in names)])
    rows["time"][0::2], rows["time"][1::2] = edges[:-1], edges[1:]
    for column, name in enumerate(names):
        rows[name] = np.repeat(inputs[:, column], 2)
    return rows


def with_fmpy(
    settings: FmuSettings, theta: Any, tolerance: float
) -> tuple[Callable[[], Any], Callable[[], None]]:
    """Prepare what FMPy can be spared: unpacking, reading the description, instantiating."""
    description = fmpy.read_model_description(str(settings.path))
    folder = fmpy.extract(str(settings.path))
    instance = fmpy.instantiate_fmu(folder, description, fmi_type="ModelExchange")
    inputs, edges = signals(settings), settings.scenario.time_communication
    start_values = {**dict(settings.fixed), **dict(zip(settings.parameter_space.names, theta, strict=True))}

    def work() -> Any:
        instance.reset()
        return fmpy.simulate_fmu(
            folder,
            model_description=description,
            fmu_instance=instance,
            fmi_type="ModelExchange",
            solver="CVode",
            start_time=edges[0],
            stop_time=edges[-1],
            output_interval=(edges[1] - edges[0]) * settings.scenario.output_every,
            relative_tolerance=tolerance,
            start_values=start_values,
            input=inputs,
            output=list(settings.output_names),
            record_events=False,
        )

    def close() -> None:
        instance.freeInstance()
        shutil.rmtree(folder, ignore_errors=True)

    return work, close


def restarts(settings: FmuSettings, tolerance: float) -> dict[str, float]:
    """Compare restarting where an input changes (every third step) with restarting at every step."""
    scenario = settings.scenario
    held = scenario.inputs.copy()
    held[1::3], held[2::3] = held[0::3][: len(held[1::3])], held[0::3][: len(held[2::3])]
    # A change in the last digits is a change, and so a restart, but none of the physics.
    nudged = held * (1.0 + 1e-14 * (np.arange(len(held)) % 2)[:, None])
    theta = settings.parameter_space.from_unit(np.full((1, settings.parameter_space.n_parameters), 0.4))
    result: dict[str, float] = {}
    for label, inputs in (("where_inputs_change", held), ("at_every_step", nudged)):
        chosen = dataclasses.replace(settings, scenario=dataclasses.replace(scenario, inputs=inputs))
        with chosen.open() as exact:
            expected = exact.simulate(theta).y
        exchange = dataclasses.replace(chosen, interface="model-exchange", relative_tolerance=tolerance)
        with exchange.open() as model:
            result[f"{label}_error_K"] = float(np.abs(model.simulate(theta).y - expected).max())
            result[f"{label}_cpu_ms"] = cpu_ms(lambda model=model: model.simulate(theta), 10)
    return result


def main() -> None:
    """Measure and print."""
    settings = load_case(ROOT / "fmus" / "office").settings
    p = settings.parameter_space.n_parameters
    theta = settings.parameter_space.from_unit(np.full((1, p), 0.4))
    with settings.open() as exact:
        expected = exact.simulate(theta).y[0]
        result: dict[str, Any] = {
            "communication_steps": len(settings.scenario.inputs),
            "exact_co_simulation_cpu_ms": cpu_ms(lambda: exact.simulate(theta), 10),
        }
    for tolerance in (1e-4, 1e-6, 1e-8):
        ours = dataclasses.replace(settings, interface="model-exchange", relative_tolerance=tolerance)
        row: dict[str, Any] = {}
        work, close = with_fmpy(settings, theta[0], tolerance)
        with ours.open() as model:
            row["ours_error_K"] = float(np.abs(model.simulate(theta).y[0] - expected).max())
            theirs = work()[settings.output_names[0]] + settings.output_offsets[0]
            row["fmpy_error_K"] = float(np.abs(theirs[settings.scenario.n_warmup :] - expected[:, 0]).max())
            # Alternating, so that a busy machine disturbs both alike.
            times = [
                (cpu_ms(work, 1), cpu_ms(lambda model=model: model.simulate(theta), 5)) for _ in range(5)
            ]
            row["fmpy_cpu_ms"], row["ours_cpu_ms"] = (min(column) for column in zip(*times, strict=True))
            row["fmpy_over_ours"] = row["fmpy_cpu_ms"] / row["ours_cpu_ms"]
        close()
        result[f"rtol_{tolerance:g}"] = row
    result["restarts_rtol_1e-06"] = restarts(settings, 1e-6)
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()

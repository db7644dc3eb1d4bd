"""What our runner adds to the bare FMI calls, what it saves against FMPy, and what all cores add to one.

Run `python tests/benchmarks/runner_speed.py`; it prints one JSON document. Needs fmus/office/Office.fmu; for
the office as FMI 3.0 also gcc and the `modelica` extra. Everything is measured alternately and in CPU time,
so that a busy machine disturbs all alike; ratios are of the least times.
"""

import ctypes
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from simulation import FmuModel, Parameter, ParameterSpace, PoolModel, load_case  # noqa: E402
from simulation.case_reading import read_case_file  # noqa: E402
from simulation.fmi.fmu import FmuSettings  # noqa: E402
from simulation.scenario import Scenario  # noqa: E402

FUNCTIONS = ("Reset", "SetupExperiment", "EnterInitializationMode", "ExitInitializationMode", "DoStep")
N_FMPY = 4
BARE_LOOP = """
#include <stdbool.h>
#include <stddef.h>
typedef int (*one)(void *);
typedef int (*setup)(void *, int, double, double, int, double);
typedef int (*reals_2)(void *, const unsigned *, size_t, double *);
typedef int (*reals_3)(void *, const unsigned *, size_t, double *, size_t);
typedef int (*step_2)(void *, double, double, int);
typedef int (*enter_3)(void *, bool, double, double, bool, double);
typedef int (*step_3)(void *, double, double, bool, bool *, bool *, bool *, double *);
int bare(void **f, void *c, int fmi, int n, const unsigned *pr, size_t np, double *p, const unsigned *ur,
         size_t nu, double *u, const unsigned *yr, size_t ny, const double *t, int m, double *y) {
  int bad = 0;
  bool b[3];
  double last;
#define REALS(F, R, N, V) (fmi == 2 ? ((reals_2)F)(c, R, N, V) : ((reals_3)F)(c, R, N, V, N))
  for (int i = 0; i < n; i++) {
    double *out = y + (size_t)i * (m + 1) * ny;
    bad |= ((one)f[0])(c) > 1;
    if (fmi == 2) bad |= ((setup)f[1])(c, 0, 0.0, t[0], 1, t[m]) > 1;
    bad |= REALS(f[5], pr, np, p + i * np) > 1;
    bad |= (fmi == 2 ? ((one)f[2])(c) : ((enter_3)f[2])(c, false, 0.0, t[0], true, t[m])) > 1;
    bad |= REALS(f[5], ur, nu, u) > 1;
    bad |= ((one)f[3])(c) > 1;
    bad |= REALS(f[6], yr, ny, out) > 1;
    for (int k = 0; k < m; k++) {
      bad |= REALS(f[5], ur, nu, u + k * nu) > 1;
      bad |= (fmi == 2 ? ((step_2)f[4])(c, t[k], t[k + 1] - t[k], 1)
                       : ((step_3)f[4])(c, t[k], t[k + 1] - t[k], true, b, b + 1, b + 2, &last)) > 1;
      bad |= REALS(f[6], yr, ny, out + (k + 1) * ny) > 1;
    }
  }
  return bad;
}
"""


def office(fmu: Path) -> FmuSettings:
    """The office for 21 days at 1800 s with weather and schedules made up of sines and switches."""
    tables = read_case_file(ROOT / "fmus" / "office" / "case.toml").parameters
    space = ParameterSpace(
        tuple(
            Parameter(table.name, table.lower, table.upper, unit=table.unit, scale=table.scale)
            for table in tables
        )
    )
    edges = np.arange(21 * 48 + 1) * 1800.0
    day = np.sin(2 * np.pi * edges[:-1] / 86400.0)
    on = (day > 0).astype(float)
    signals = {
        "TAmb": 270 + 5 * day,
        "TAmbEq": 272 + 7 * day,
        "TSupTAC": 300 + day,
        "ySupTAC": on,
        "TSupMV": 293 + day,
        "ySupMV": 1 - on,
        "HGlo": 200 * np.maximum(day, 0),
        "occ": on,
    }
    scenario = Scenario(edges, np.column_stack(list(signals.values())), tuple(signals), 1)
    return FmuSettings(fmu, space, scenario, ("TAir",), np.array([-273.15]))


def office_3(folder: Path) -> Path:
    """Build the office as an FMU of FMI 3.0."""
    for name in ("Office.mo", "build.toml"):
        shutil.copy(ROOT / "fmus" / "office" / name, folder)
    build = folder / "build.toml"
    build.write_text('fmi_version = "3.0"\n' + build.read_text())
    subprocess.run([sys.executable, "-m", "fmus.compiler", folder], cwd=ROOT, check=True, capture_output=True)
    return folder / "Office.fmu"


def least_s(*works: Callable[[], object], repeats: int = 15) -> list[float]:
    """Least CPU time of each work, in turns: the others were disturbed. [s]"""
    times: list[list[float]] = [[] for _ in works]
    for _ in range(repeats):
        for work, mine in zip(works, times, strict=True):
            before = time.process_time()
            work()
            mine.append(time.process_time() - before)
    return [min(mine) for mine in times]


def simulated_by_fmpy(settings: FmuSettings, row: np.ndarray) -> Callable[[], object]:
    """The same simulation as everyone would write it: one call with the FMU's path."""
    scenario = settings.scenario
    edges = scenario.time_communication
    columns = [("time", np.float64), *((name, np.float64) for name in scenario.input_names)]
    signals = np.zeros(len(edges) - 1, dtype=columns)
    signals["time"] = edges[:-1]
    for index, name in enumerate(scenario.input_names):
        signals[name] = scenario.inputs[:, index]
    step = float(edges[1] - edges[0])
    start_values = dict(zip(settings.parameter_space.names, row.tolist(), strict=True)) | dict(settings.fixed)
    return lambda: fmpy.simulate_fmu(
        str(settings.path),
        start_time=float(edges[0]),
        stop_time=float(edges[-1]),
        step_size=step,
        output_interval=step * scenario.output_every,
        start_values=start_values,
        input=signals if scenario.input_names else None,
        output=list(settings.output_names),
        relative_tolerance=settings.relative_tolerance,
        fmi_type="CoSimulation" if settings.interface == "co-simulation" else "ModelExchange",
    )


def simulated_by_c(model: FmuModel, rows: np.ndarray, folder: Path) -> tuple[Callable[[], None], np.ndarray]:
    """The same simulations by a C loop around the same functions of the same instance, and where they go."""
    (folder / "bare.c").write_text(BARE_LOOP)
    subprocess.run(
        ["gcc", "-O2", "-shared", "-fPIC", "-o", folder / "bare.so", folder / "bare.c"], check=True
    )
    bare = ctypes.CDLL(str(folder / "bare.so")).bare
    runner = model._runner
    instance, plan = runner._instance, runner._solver._plan
    two = instance.prefix == "fmi2"
    kind = "Real" if two else "Float64"
    addresses = np.zeros(7, dtype=np.intp)
    for index, name in enumerate((*FUNCTIONS, f"Set{kind}", f"Get{kind}")):
        if two or name != "SetupExperiment":
            addresses[index] = instance.addresses(name)[0]
    references, input_references = (
        np.array([one.reference for one in variables], dtype=np.uint32)
        for variables in (plan.calibrated, plan.input_variables)
    )
    y = np.empty((len(rows), plan.n_steps + 1, len(plan.output_references)))

    def address(array: np.ndarray) -> ctypes.c_void_p:
        return ctypes.c_void_p(array.ctypes.data)

    def run() -> None:
        bad = bare(
            address(addresses),
            ctypes.c_void_p(instance.component),
            2 if two else 3,
            len(rows),
            address(references),
            ctypes.c_size_t(rows.shape[1]),
            address(rows),
            address(input_references),
            ctypes.c_size_t(plan.inputs.shape[1]),
            address(plan.inputs),
            address(plan.output_references),
            ctypes.c_size_t(len(plan.output_references)),
            address(plan.edges),
            plan.n_steps,
            address(y),
        )
        assert not bad

    return run, y


def measured(settings: FmuSettings, folder: Path, n_rows: int, *, c_loop: bool = False) -> dict[str, object]:
    """Our runner beside FMPy and, if asked for, a C loop."""
    rows = settings.parameter_space.from_unit(
        np.random.default_rng(0).random((n_rows, settings.parameter_space.n_parameters))
    )
    began = time.perf_counter()
    with FmuModel(settings) as model:
        result: dict[str, object] = {"steps": len(settings.scenario.inputs)}
        result["open_s"] = round(time.perf_counter() - began, 4)
        began = time.perf_counter()
        model.simulate(rows[:1])
        result["first_row_s"] = round(time.perf_counter() - began, 4)
        model.simulate(rows[:2])
        result["started_over_by"] = model.way
        # FMPy takes a few of the rows only, and ours the same few beside it: rows differ in what they cost.
        few = rows[:N_FMPY]
        works = [
            lambda: model.simulate(rows),
            lambda: [model.simulate(few) for _ in range(n_rows // N_FMPY)],
            lambda: [simulated_by_fmpy(settings, row)() for row in few],
        ]
        if c_loop:
            by_c, y = simulated_by_c(model, rows, folder)
            works.append(by_c)
        ours_s, few_s, fmpy_s, *c_s = least_s(*works)
        result["ours_us"] = round(ours_s / n_rows * 1e6, 1)
        result["fmpy_us"] = round(fmpy_s / N_FMPY * 1e6, 1)
        result["times_fmpy"] = round(fmpy_s / N_FMPY / (few_s / n_rows), 1)
        if c_s:
            assert np.abs(model.simulate(rows).y - settings.output_offsets - y).max() < 1e-9
            result["c_us"] = round(c_s[0] / n_rows * 1e6, 1)
            result["share_of_c_speed"] = round(c_s[0] / ours_s, 3)
    return result


def on_all_cores(settings: FmuSettings) -> dict[str, object]:
    """Many rows in one process and in all of them, by the clock."""
    rng = np.random.default_rng(0)
    large = settings.parameter_space.from_unit(rng.random((20_000, settings.parameter_space.n_parameters)))
    with FmuModel(settings) as model, PoolModel(settings.open) as parallel:
        parallel.simulate(large[: 100 * parallel.n_workers])
        model.simulate(large[:100])
        alone_s, together_s = [], []
        for _ in range(3):
            for work, times in ((model.simulate, alone_s), (parallel.simulate, together_s)):
                before = time.perf_counter()
                work(large)
                times.append(time.perf_counter() - before)
        return {
            "rows": len(large),
            "workers": parallel.n_workers,
            "alone_s": round(min(alone_s), 3),
            "together_s": round(min(together_s), 3),
            "speedup": round(min(alone_s) / min(together_s), 2),
        }


def main() -> None:
    """Measure and print."""
    result: dict[str, object] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        chosen = office(ROOT / "fmus" / "office" / "Office.fmu")
        can_compile = shutil.which("gcc") is not None
        result["office, FMI 2.0"] = measured(chosen, folder, 200, c_loop=can_compile)
        if can_compile:
            result["office, FMI 3.0"] = measured(office(office_3(folder)), folder, 200, c_loop=True)
        for name in ("thermostat", "vanderpol"):
            case = load_case(ROOT / "fmus" / name)
            result[f"{name}, {case.settings.interface}, integrating"] = measured(case.settings, folder, 20)
        result["office, all cores"] = on_all_cores(chosen)
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()

"""What our runner adds to the bare FMI calls, and what all cores add to one.

Run `python tests/benchmarks/runner_speed.py`; it prints one JSON document. Needs fmus/office/Office.fmu.
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

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from simulation.case_file import read_case_file  # noqa: E402
from simulation.fmu import FmuModel, FmuSettings  # noqa: E402
from simulation.fmu_loop import FUNCTIONS  # noqa: E402
from simulation.parallel import ParallelModel  # noqa: E402
from simulation.parameters import Parameter, ParameterSpace  # noqa: E402
from simulation.scenario import Scenario  # noqa: E402

BARE_LOOP = """
#include <stddef.h>
typedef int (*one)(void *);
typedef int (*setup)(void *, int, double, double, int, double);
typedef int (*reals)(void *, const unsigned *, size_t, double *);
typedef int (*step)(void *, double, double, int);
int bare(void **f, void *c, int n, const unsigned *pr, size_t np, double *p, const unsigned *ur, size_t nu,
         double *u, const unsigned *yr, size_t ny, const double *t, int m, double *y) {
  int bad = 0;
  for (int i = 0; i < n; i++) {
    bad |= ((one)f[0])(c) > 1;
    bad |= ((setup)f[1])(c, 0, 0.0, t[0], 1, t[m]) > 1;
    bad |= ((reals)f[2])(c, pr, np, p + i * np) > 1;
    bad |= ((one)f[3])(c) > 1;
    bad |= ((reals)f[2])(c, ur, nu, u) > 1;
    bad |= ((one)f[4])(c) > 1;
    bad |= ((reals)f[6])(c, yr, ny, y) > 1;
    for (int k = 0; k < m; k++) {
      bad |= ((reals)f[2])(c, ur, nu, u + k * nu) > 1;
      bad |= ((step)f[5])(c, t[k], t[k + 1] - t[k], 1) > 1;
      bad |= ((reals)f[6])(c, yr, ny, y + ((size_t)i * (m + 1) + k + 1) * ny) > 1;
    }
  }
  return bad;
}
"""


def settings() -> FmuSettings:
    """The office for 21 days at 1800 s with weather and schedules made up of sines and switches."""
    folder = ROOT / "fmus" / "office"
    space = ParameterSpace(
        tuple(Parameter(**table.model_dump()) for table in read_case_file(folder / "case.toml").parameters)
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
    return FmuSettings(folder / "Office.fmu", space, scenario, ("TAir",), np.array([-273.15]))


def best_s(work: Callable[[], object], repeats: int, clock: Callable[[], float] = time.perf_counter) -> float:
    """Least time of some repeats: the others were disturbed."""
    times = []
    for _ in range(repeats):
        before = clock()
        work()
        times.append(clock() - before)
    return min(times)


def bare_loop(folder: Path) -> "ctypes._NamedFuncPointer":
    """Compile the C loop."""
    (folder / "bare.c").write_text(BARE_LOOP)
    subprocess.run(
        ["gcc", "-O2", "-shared", "-fPIC", "-o", folder / "bare.so", folder / "bare.c"], check=True
    )
    return ctypes.CDLL(str(folder / "bare.so")).bare


def main() -> None:
    """Measure and print."""
    chosen = settings()
    rows = chosen.parameter_space.from_unit(
        np.random.default_rng(0).random((200, chosen.parameter_space.n_parameters))
    )
    result: dict[str, object] = {"steps": len(chosen.scenario.inputs), "rows": len(rows)}
    before = time.perf_counter()
    model = FmuModel(chosen)
    result["open_s"] = time.perf_counter() - before
    before = time.perf_counter()
    model.simulate(rows[:1])
    result["first_row_s"] = time.perf_counter() - before
    if shutil.which("gcc"):
        instance = model._instance
        y = np.empty((len(rows), len(chosen.scenario.time), 1))
        arrays = {
            "p": rows,
            "u": np.ascontiguousarray(chosen.scenario.inputs),
            "t": chosen.scenario.time_communication,
        }

        def pointer(array: np.ndarray) -> ctypes.c_void_p:
            return ctypes.c_void_p(array.ctypes.data)

        with tempfile.TemporaryDirectory() as folder:
            bare = bare_loop(Path(folder))

            def run_bare() -> None:
                bad = bare(
                    pointer(instance.functions),
                    ctypes.c_void_p(instance.component),
                    len(rows),
                    pointer(model._parameter_references),
                    ctypes.c_size_t(rows.shape[1]),
                    pointer(arrays["p"]),
                    pointer(model._input_references),
                    ctypes.c_size_t(arrays["u"].shape[1]),
                    pointer(arrays["u"]),
                    pointer(model._output_references),
                    ctypes.c_size_t(1),
                    pointer(arrays["t"]),
                    len(arrays["u"]),
                    pointer(y),
                )
                assert not bad

            # Alternating and in CPU time, so that a busy machine disturbs both alike.
            bare_times, ours_times = [], []
            for _ in range(25):
                bare_times.append(best_s(run_bare, 1, time.process_time))
                ours_times.append(best_s(lambda: model.simulate(rows), 1, time.process_time))
            assert FUNCTIONS[5] == "fmi2DoStep"
            answer = model.simulate(rows).y[:, 1:] + 273.15
            assert np.abs(answer - y[:, 1:]).max() < 1e-9
        result["bare_cpu_us_per_row"] = min(bare_times) / len(rows) * 1e6
        result["ours_cpu_us_per_row"] = min(ours_times) / len(rows) * 1e6
        result["ratio"] = min(ours_times) / min(bare_times)
    large = np.tile(rows, (100, 1))
    result["batch_rows"] = len(large)
    result["batch_serial_s"] = best_s(lambda: model.simulate(large), 3)
    with ParallelModel(chosen.open) as parallel:
        parallel.simulate(large[: 20 * parallel.n_workers])
        result["n_workers"] = parallel.n_workers
        result["batch_parallel_s"] = best_s(lambda: parallel.simulate(large), 3)
    result["parallel_speedup"] = float(str(result["batch_serial_s"])) / float(str(result["batch_parallel_s"]))
    model.close()
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()

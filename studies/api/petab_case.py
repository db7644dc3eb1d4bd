"""`studies new problem.yaml --fmu Model.fmu`: a PEtab problem with an FMU as its model becomes a case."""

import math
import re
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.fmi.description import FmuDescription
from simulation.fmi.own_time import own_unit_s
from simulation.foreign_text import shortened
from simulation.whole_file import whole_file
from simulation.write_gate import check_written
from studies.api.problem import Problem
from studies.new.case_folder import case_name, describe, write_case
from studies.new.petab_tables import Condition, Petab, read_petab
from studies.paths import ProjectPaths
from studies.words.wording import count

# Times are whole multiples of a step that is no finer than this. [model's unit]
FINEST = 1e-6
# Steps of a simulation: at least so many, however few samples there are, and at most so many.
LEAST_STEPS, MOST_STEPS = 200, 20_000


def petab_case(problem_file: Path, fmu_file: Path, paths: ProjectPaths, to: Path | None) -> tuple[Path, str]:
    """Write a PEtab problem as a case.

    Args:
        problem_file: The problem's YAML file.
        fmu_file: The model, with the problem's names.
        paths: The project.
        to: The case's folder; None for `fmus/<name of the problem>`.

    Returns:
        The case file, and what a calibration's error means in PEtab's terms.

    Raises:
        InputError: The problem says what a case cannot say, the FMU lacks a name, or a file would be
            overwritten.
    """
    fmu, petab = describe(fmu_file), read_petab(problem_file)
    folder = (to.expanduser() if to else paths.fmus / case_name(problem_file.stem)).resolve()
    check_written(folder)
    unit_s = own_unit_s(fmu.variables, fmu.units, None, fmu.path.name)
    names = _outputs(petab, fmu, problem_file)
    # The variable that an estimated parameter is given to, where conditions do that.
    shared = {
        name: to for held in petab.conditions.values() for to, name in _held(held).get("shared", {}).items()
    }
    for name in petab.noise:
        if name in fmu.variables or name in shared:
            raise InputError(
                f"{problem_file}: {name} is estimated as a parameter of the model and of the noise, which a "
                "case cannot say; give the noise one of its own"
            )
    parameters = {
        name: _table(petab, name, fmu, problem_file, shared.get(name, name))
        for name in petab.estimated
        if name not in petab.noise
    }
    samples = petab.samples.assign(time=petab.samples["time"] * unit_s)
    step_s = _step(samples["time"].to_numpy(), unit_s)
    known = {name: value for name, value in petab.known.items() if name in fmu.variables}
    groups = {str(name): part for name, part in samples.groupby("condition")}
    first = next(iter(groups))
    note, end_s = _note(petab, problem_file.stem), _end(groups[first], step_s)
    keys: dict[str, Any] = {"note": note, "interface": fmu.usual_interface, "time": _steps(step_s, end_s)}
    outputs = {
        names[str(name)]: {
            "values": pd.Series(part["value"].to_numpy(), part["time"].to_numpy()),
            "uncertainty": pd.Series(part["deviation"].to_numpy(), part["time"].to_numpy()),
            "weight": float(len(part)),
        }
        for name, part in groups[first].groupby("observable")
    }
    # Made in a temporary folder first: no file of the user's is overwritten.
    with tempfile.TemporaryDirectory(prefix="studies-petab-") as made_in:
        made = Path(made_in)
        if len(groups) > 1 or shared:
            keys["experiments"] = [
                {
                    "name": _experiment(name),
                    "time": {"window_s": [0.0, _end(part, step_s)]},
                    "outputs": _write(made, name, part, names, fmu),
                    **_held(petab.conditions[name]),
                }
                for name, part in groups.items()
            ]
        else:
            known |= _held(petab.conditions[first]).get("fixed", {})
        (linked := made / fmu_file.name).symlink_to(fmu_file.resolve())
        problem = Problem(
            linked,
            outputs,
            parameters,
            fixed=known,
            step_s=step_s,
            window_s=(0.0, end_s),
            name=case_name(folder.name),
            keys=keys,
        )
        case_file = problem.save(made)
        files = {folder / one.name: one.read_bytes() for one in made.glob("*.csv")}
        files[folder / case_file.name] = case_file.read_bytes()
    write_case(files, fmu_file, folder / fmu_file.name, paths)
    return folder / case_file.name, note


def _held(condition: Condition) -> dict[str, dict[str, Any]]:
    """Return what holds in a condition as the keys `fixed` and `shared` of an experiment."""
    parts = {
        "fixed": {name: value for name, value in condition.items() if not isinstance(value, str)},
        "shared": {name: value for name, value in condition.items() if isinstance(value, str)},
    }
    return {key: values for key, values in parts.items() if values}


def _outputs(petab: Petab, fmu: FmuDescription, file: Path) -> dict[str, str]:
    """Return the FMU's variable of each observable: that of its name, else that of its formula."""
    found = {}
    for name in dict.fromkeys(petab.samples["observable"]):
        formula = petab.formulas[name].strip()
        known = [one for one in (name, formula) if one in fmu.variables]
        if not known:
            raise InputError(
                f"{file}: {name} is {shortened(formula)}, which is no variable of {fmu.path.name}; give the "
                f"FMU an output {name} of that formula"
            )
        found[name] = known[0]
    return found


def _table(petab: Petab, name: str, fmu: FmuDescription, file: Path, variable: str) -> dict[str, Any]:
    """Return the keys of [[parameters]] of an estimated parameter, given to a variable of the FMU."""
    one = petab.estimated[name]
    if variable not in fmu.variables:
        raise InputError(
            f"{file}: {name} is estimated, and {fmu.path.name} has no variable {variable}; noise, scales "
            "and offsets of observables cannot be estimated: set estimate to 0, or make it one of the FMU's"
        )
    unit = fmu.variables[variable].unit or "1"
    keys: dict[str, Any] = {"unit": unit, "lower": one.lower, "upper": one.upper, "scale": one.scale}
    keys |= {} if one.nominal is None else {"estimate": one.nominal}
    return keys | ({} if one.prior is None else {"prior": dict(one.prior)})


def _step(time_s: FloatArray, unit_s: float) -> float:
    """Return the largest step [s] of which all times are multiples; none may be too fine."""
    whole = np.rint(time_s / (FINEST * unit_s)).astype(np.int64)
    step_s = float(np.gcd.reduce(whole)) * FINEST * unit_s
    end_s = float(time_s.max())
    return step_s if end_s <= MOST_STEPS * step_s else end_s / (MOST_STEPS // 10)


def _steps(step_s: float, end_s: float) -> dict[str, float]:
    """Return the communication step, a part of the output step where that is coarse. [s]."""
    parts = max(1, math.ceil(LEAST_STEPS * step_s / end_s))
    return {"communication_step_s": step_s / parts, "output_step_s": step_s}


def _end(samples: pd.DataFrame, step_s: float) -> float:
    return step_s * math.ceil(float(samples["time"].max()) / step_s * (1.0 - 1e-12))


def _experiment(condition: str) -> str:
    return re.sub(r"[^A-Za-z0-9_-]+", "-", condition).strip("-_") or "condition"


def _write(
    folder: Path, condition: str, samples: pd.DataFrame, names: Mapping[str, str], fmu: FmuDescription
) -> list[dict[str, Any]]:
    """Write the measurements of a condition, a file per observable, and return its [[outputs]]."""
    tables = []
    for name, part in samples.groupby("observable"):
        file = f"{_experiment(condition)}-{_experiment(str(name))}.csv"
        frame = part[["time", "value", "deviation"]].rename(columns={"time": "time_s"})
        with whole_file(folder / file) as stream:
            stream.write(frame.to_csv(index=False).encode())
        variable = fmu.variables[names[str(name)]]
        keys = {"name": variable.name, "unit": variable.unit or "1", "file": file, "column": "value"}
        tables.append(keys | {"uncertainty_column": "deviation", "weight": float(len(part))})
    return tables


def _note(petab: Petab, name: str) -> str:
    """Say what the error is in PEtab's terms.

    The MSE is the first output's usual variance times chi² over the number of samples.
    """
    samples = petab.samples
    is_first = samples["condition"] == samples["condition"].iloc[0]
    of_first = samples[is_first & (samples["observable"] == samples.loc[is_first, "observable"].iloc[0])]
    variance = 1.0 / float(np.mean(of_first["deviation"].to_numpy() ** -2.0))
    beside = petab.chi2_of_replicates
    more = f" + {beside:.10g}, of replicates" if beside else ""
    factor = len(samples) / variance
    said = f"PEtab problem {name}, {count(len(samples), 'sample')}: chi2 = {factor:.10g} MSE{more}."
    if petab.noise:
        held = "is held at its nominal value: estimate it"
        if len(petab.noise) > 1:
            held = "are held at their nominal values: estimate each"
        said += (
            f" Of the noise, {', '.join(petab.noise)} {held} afterwards, as the root mean square error of "
            "what it is the noise of; where that differs much, write it as nominal value and calibrate again."
        )
    return said

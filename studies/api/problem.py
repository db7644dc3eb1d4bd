"""A case made of objects: an FMU, recorded series and bounds, in place of a case file and CSV files."""

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from simulation.arrays import FloatArray
from simulation.case import Case, load_case
from simulation.errors import InputError
from simulation.fmi.description import read_description
from simulation.foreign_text import not_a_formula, toml_text
from simulation.whole_file import whole_file
from studies.paths import find_project, folder_name, mark_project
from studies.server import LOCAL
from studies.words.console import Console

if TYPE_CHECKING:
    from studies.api.judgements import CheckResult

Keys = Mapping[str, Any]
LINEAR = {"interpolation": "linear"}


@dataclass(frozen=True, eq=False)
class Problem:
    """What is calibrated, driven by what, compared with what. All functions take it where they take a case.

    A series has seconds of the model's time as its index, or timestamps, whose first one is the model's 0.
    Where a series or bounds stand, a mapping may stand that has more keys of the case file: those of
    [[inputs]] and [[outputs]] with the series under `values`, those of [[parameters]]. A unit that is not
    given is the FMU's.

    Attributes:
        fmu: The FMU's file.
        outputs: Measured series by output, as {"values": series, "uncertainty": 0.5}; the uncertainty may be
            a series, too. [per output]
        parameters: Lower and upper bound by parameter, as (0.5, 10.0). [per parameter]
        inputs: Recorded series by input, linear between samples unless `interpolation` says how. [per input]
        fixed: Values of other parameters, inputs and initial states. [FMU's units]
        step_s: Communication step; None for the spacing of the first output. [s]
        window_s: What is compared; None for all samples of the first output. [s]
        start_s: Start of the simulation. [s]
        name: Part of every label; None for the FMU's file name.
        keys: Further keys of the case file, as {"tied": {"R2": "3 * R1"}}.
    """

    fmu: str | Path
    outputs: Mapping[str, Keys]
    parameters: Mapping[str, tuple[float, float] | Keys]
    inputs: "Mapping[str, pd.Series[float] | Keys]" = field(default_factory=dict)
    fixed: Mapping[str, Any] = field(default_factory=dict)
    step_s: float | None = None
    window_s: tuple[float, float] | None = None
    start_s: float = 0.0
    name: str | None = None
    keys: Keys = field(default_factory=dict)

    @cached_property
    def path(self) -> Path:
        """The case file, written into the project of the working folder."""
        paths = find_project(None, LOCAL)
        mark_project(paths, Console(quiet=True))
        return self.save(paths.mlruns / "problems" / folder_name(self._name))

    @cached_property
    def case(self) -> Case:
        """The case that it is.

        Raises:
            InputError: Something of it is wrong; the message names the key of the case file.
        """
        return load_case(self.path)

    def save(self, folder: str | Path) -> Path:
        """Write `case.toml` and the series as CSV files into a folder, for the command line and for others.

        Args:
            folder: Where to; what lies there under these names is replaced.

        Returns:
            The case file.

        Raises:
            InputError: A series has no times, or the FMU cannot be read.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        units = {name: one.unit for name, one in read_description(Path(self.fmu)).variables.items()}
        tables: list[tuple[str, str, dict[str, Any]]] = [
            *(("inputs", name, {**LINEAR, **_keys(name, one)}) for name, one in self.inputs.items()),
            *(("outputs", name, dict(_keys(name, one))) for name, one in self.outputs.items()),
        ]
        entries: dict[str, list[Keys]] = {"inputs": [], "outputs": []}
        for room, name, keys in tables:
            values, file = keys.pop("values", None), f"{folder_name(name)}.csv"
            if values is not None:
                frame = values.rename(name).rename_axis(_time_name(name, values)).to_frame()
                keys |= {"file": file, "column": not_a_formula(name)}
                if isinstance(each := keys.get("uncertainty"), pd.Series):
                    frame[own := f"uncertainty of {name}"] = each
                    del keys["uncertainty"]
                    keys["uncertainty_column"] = own
                _write(folder / file, frame)
            entries[room].append({"name": name, "unit": units.get(name) or "1", **keys})
        first = next((one["values"] for one in self.outputs.values() if "values" in one), None)
        if first is None:
            raise InputError("outputs: none has `values`; give the measured series of one at least")
        at = _seconds(first)
        step_s = self.step_s or float(np.median(np.diff(at)))
        window_s = self.window_s or (max(float(at[0]), self.start_s), float(at[-1]))
        time = {"window_s": [*window_s], "start_s": self.start_s, "communication_step_s": step_s}
        parameters = [
            {"name": name, "unit": units.get(name) or "1", **_bounds(one)}
            for name, one in self.parameters.items()
        ]
        tables_of_keys = {key: value for key, value in self.keys.items() if isinstance(value, Mapping)}
        document = {
            "schema": 1,
            "name": self._name,
            "fmu": Path(os.path.relpath(self.fmu, folder)).as_posix(),
            "data": ".",
            **{key: value for key, value in self.keys.items() if key not in tables_of_keys},
            "time": {**time, "output_step_s": step_s, **tables_of_keys.pop("time", {})},
            **entries,
            "parameters": parameters,
            "fixed": dict(self.fixed),
            **tables_of_keys,
        }
        with whole_file(folder / "case.toml") as stream:
            stream.write(_toml(document).encode())
        return folder / "case.toml"

    def check(self, **words: Any) -> "CheckResult":
        """Examine it before its simulations are paid for, as `studies.check`.

        Args:
            words: Keywords of `studies.check`.
        """
        from studies.api.judgements import check

        return check(self.path, **words)

    def cost(self, theta: "Mapping[str, float] | pd.DataFrame") -> "float | FloatArray":
        """Return the error of parameters: the mean squared difference, infinite where the simulation fails.

        Args:
            theta: Parameters by name, or a frame of n rows. [per parameter]

        Returns:
            The error; of a frame shape (n,). [first output's unit squared]
        """
        from simulation.pool.pool_model import PoolModel
        from studies.calibration.prior import Prior
        from studies.calibration.problem import CalibrationProblem

        case = self.case
        space, rows = case.parameter_space, pd.DataFrame([theta]) if isinstance(theta, Mapping) else theta
        with PoolModel(case.make_model) as model:
            posed = CalibrationProblem(
                model, case.measurement, Prior.of(space, case.measurement), case.layout
            )
            errors = posed.mse(space.to_unit(rows[[*space.names]].to_numpy(dtype=np.float64)))
        return float(errors[0]) if isinstance(theta, Mapping) else errors

    @property
    def _name(self) -> str:
        return self.name or Path(self.fmu).stem.lower()


def _keys(name: str, one: Any) -> Keys:
    """Return what stands for a series, as a mapping with the series under `values`."""
    keys = one if isinstance(one, Mapping) else {"values": one}
    values = keys.get("values")
    if values is not None and not isinstance(values, pd.Series):
        raise InputError(f"{name}: its values are a {type(values).__name__}; give a pandas series over time")
    return keys


def _bounds(one: tuple[float, float] | Keys) -> Keys:
    return one if isinstance(one, Mapping) else {"lower": float(one[0]), "upper": float(one[1])}


def _time_name(name: str, values: "pd.Series[float]") -> str:
    if isinstance(values.index, pd.DatetimeIndex):
        return "time"
    if not pd.api.types.is_numeric_dtype(values.index):
        raise InputError(f"{name}: its index is no time; give seconds or timestamps")
    return "time_s"


def _seconds(values: "pd.Series[float]") -> FloatArray:
    """Return the times of a series in seconds; of timestamps since the first one. Shape (t,)."""
    if isinstance(values.index, pd.DatetimeIndex):
        return np.asarray((values.index - values.index[0]).total_seconds(), dtype=np.float64)
    return np.asarray(values.index, dtype=np.float64)


def _write(file: Path, frame: pd.DataFrame) -> None:
    frame = frame.rename(columns=not_a_formula)
    with whole_file(file) as stream:
        stream.write(frame.to_csv(date_format="%Y-%m-%dT%H:%M:%S%z").encode())


def _toml(document: Keys) -> str:
    """Write a document of texts, numbers, lists and tables in TOML."""
    lines, tables = list[str](), list[str]()
    for key, value in document.items():
        if isinstance(value, Mapping):
            tables += [
                f"[{_key(key)}]",
                *(f"{_key(k)} = {_value(v)}" for k, v in value.items()),
                "",
            ]
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            for entry in value:
                tables += [
                    f"[[{_key(key)}]]",
                    *(f"{_key(k)} = {_value(v)}" for k, v in entry.items()),
                    "",
                ]
        elif not (isinstance(value, list) and not value):
            lines.append(f"{_key(key)} = {_value(value)}")
    return "\n".join([*lines, "", *tables])


def _key(text: str) -> str:
    return text if re.fullmatch(r"[A-Za-z0-9_-]+", text) else toml_text(text)


def _value(value: Any) -> str:
    if isinstance(value, str):
        return toml_text(value)
    if isinstance(value, bool | np.bool_):
        return str(bool(value)).lower()
    if isinstance(value, int | np.integer):
        return str(int(value))
    if isinstance(value, float | np.floating):
        return repr(float(value)) if math.isfinite(value) else f"{float(value)}"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(key)} = {_value(one)}" for key, one in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_value, value)) + "]"
    raise InputError(f"a case file cannot hold {value!r}; give a text, a number, a list or a table")

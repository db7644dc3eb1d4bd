"""A parameter estimation problem in PEtab's tables, version 1 or 2, as numbers.

The form is https://petab.readthedocs.io (Schmiester et al. 2021, doi 10.1371/journal.pcbi.1008646). What a
case cannot say is refused in one line.
"""

import math
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from simulation.errors import InputError
from simulation.foreign_text import shortened

MISSING = "PEtab is read by the package petab; install it: pip install 'pelsvae-studies[petab]'"
_COLUMNS = {
    "measurement": ("observableId", "measurement", "time"),
    "observable": ("observableFormula", "noiseFormula"),
    "parameter": ("lowerBound", "upperBound", "nominalValue", "estimate"),
}
Condition = dict[str, float | str]
"""What holds in a condition, by what is set: a number, or the name of an estimated parameter."""
_SCALES = {"log10": 10.0, "log": math.e}


@dataclass(frozen=True)
class Estimated:
    """A parameter that is estimated.

    Attributes:
        lower: Lower bound.
        upper: Upper bound.
        scale: "log" or "linear".
        nominal: Published value; None for none.
        prior: Key `prior` of a case; None for none.
    """

    lower: float
    upper: float
    scale: str
    nominal: float | None = None
    prior: Mapping[str, float] | None = None


@dataclass(frozen=True)
class Petab:
    """A problem.

    Attributes:
        samples: Columns condition, observable, time [model's unit], value and deviation; no two rows with the
            same first three. Replicates are joined to their weighed mean.
        formulas: What is observed, by observable.
        estimated: The estimated parameters by name.
        known: Values of the others.
        conditions: What holds in each condition, by name: a number, or the name of an estimated parameter.
        chi2_of_replicates: What joining replicates took from the sum of squares.
        noise: Estimated parameters that are the noise's; they have their nominal values in the deviations.
    """

    samples: pd.DataFrame
    formulas: Mapping[str, str]
    estimated: Mapping[str, Estimated]
    known: Mapping[str, float]
    conditions: Mapping[str, Condition]
    chi2_of_replicates: float
    noise: tuple[str, ...] = ()


def read_petab(file: Path) -> Petab:
    """Read a problem.

    Args:
        file: Its YAML file.

    Raises:
        InputError: A table cannot be read, or says what a case cannot say.
    """
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
        version = int(str(content["format_version"]).split(".")[0])
        if version not in (1, 2):
            raise InputError(f"{file}: format_version {version}; versions 1 and 2 can be read")
        return (_FirstVersion if version == 1 else _SecondVersion)(file, content).read()
    except (OSError, yaml.YAMLError, LookupError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{file}: no PEtab problem ({_line(error)})") from error


class _Tables:
    """Tables that one of the versions has; the others are theirs alone."""

    parameters: pd.DataFrame
    observables: pd.DataFrame
    measurements: pd.DataFrame
    version: Any

    def __init__(self, file: Path, tables: Mapping[str, list[str]], version: Any) -> None:
        self.file, self.version = file, version
        self._tables = {kind: [self._place(one) for one in names] for kind, names in tables.items()}
        self.parameters = self.table("parameter")
        self.observables = self.table("observable")
        self.measurements = self.table("measurement")

    def _place(self, name: str) -> Path:
        place = (self.file.parent / name).resolve()
        if not place.is_relative_to(self.file.parent.resolve()):
            raise InputError(f"{self.file}: {shortened(name)} lies outside its folder")
        return place

    def table(self, kind: str) -> pd.DataFrame:
        """Return a table, of several files joined; empty where there is none."""
        parts = []
        for place in self._tables.get(kind, []):
            try:
                frame = pd.read_csv(place, sep="\t")
                # petab uses what pandas will drop.
                with warnings.catch_warnings(action="ignore", category=DeprecationWarning):
                    parts.append(getattr(self.version, f"get_{kind}_df")(frame))
                for column in _COLUMNS.get(kind, ()):
                    if column not in parts[-1]:
                        raise ValueError(f"no column {column}")
            except Exception as error:  # whatever its reader makes of a stranger's table
                raise InputError(f"{place}: no {kind} table of PEtab ({_line(error)})") from error
        return pd.concat(parts) if parts else pd.DataFrame()

    def refuse(self, what: str) -> InputError:
        """Return the error for what a case cannot say."""
        return InputError(f"{self.file}: {what}")

    def numbers(self, cell: Any, known: Mapping[str, float]) -> tuple[float | None, ...]:
        """Return the numbers of a cell such as "0.1;sd"; None for each parameter that is estimated."""
        if cell is None or (isinstance(cell, float) and math.isnan(cell)):
            return ()
        found: list[float | None] = []
        for one in str(cell).split(";"):
            try:
                found.append(float(one))
            except ValueError:
                found.append(known.get(one.strip()))
        return tuple(found)

    def deviations(self, known: Mapping[str, float]) -> tuple[list[float], tuple[str, ...]]:
        """Return the standard deviation of each measurement, and the estimated parameters in them.

        These have their nominal values.
        """
        from petab.v1.math import sympify_petab

        said = self.parameters.loc[self.is_estimated].get("nominalValue", pd.Series(dtype=float)).dropna()
        nominal, noise = {str(name): float(value) for name, value in said.items()}, dict[str, None]()
        seen: dict[tuple[str, str], float] = {}
        found = []
        cells = self.measurements.get("noiseParameters", pd.Series(index=self.measurements.index))
        for observable, cell in zip(self.measurements["observableId"], cells, strict=True):
            key = (str(observable), str(cell))
            if key not in seen:
                formula = self.observables.loc[observable, "noiseFormula"]
                numbers = self.numbers(cell, {**nominal, **known})
                values = dict(zip(self.placeholders(observable), numbers, strict=False))
                noise |= dict.fromkeys(one.strip() for one in str(cell).split(";") if one.strip() in nominal)
                expression = sympify_petab(formula)
                for symbol in expression.free_symbols:
                    value = values.get(str(symbol), known.get(str(symbol), nominal.get(str(symbol))))
                    noise |= dict.fromkeys({str(symbol)} & nominal.keys() - values.keys())
                    if value is None:
                        raise self.refuse(
                            f"the noise of {observable}, {shortened(str(formula))}, depends on what is "
                            f"estimated or simulated ({symbol}); give numbers in its place"
                        )
                    expression = expression.subs(symbol, value)
                seen[key] = float(str(expression))
                if not seen[key] > 0.0:
                    raise self.refuse(f"the noise of {observable} is {seen[key]:g}; give one above 0")
            found.append(seen[key])
        return found, tuple(noise)

    def placeholders(self, observable: str) -> list[str]:
        """Return the names in a noise formula that numbers of measurements stand for."""
        raise NotImplementedError

    def conditions(self, known: Mapping[str, float]) -> tuple[dict[str, Condition], list[str]]:
        """Return what holds in each condition, and the condition of each measurement."""
        raise NotImplementedError

    def held(self, condition: str, target: str, cell: Any, known: Mapping[str, float]) -> float | str:
        """Return what a condition sets a variable to: a number, or the name of an estimated parameter."""
        (value,) = self.numbers(cell, known)
        if value is not None:
            return value
        if str(cell).strip() not in self.parameters.index:
            raise self.refuse(f"condition {condition} sets {target} to {shortened(str(cell))}; give a number")
        return str(cell).strip()

    def estimated(self) -> Iterator[tuple[str, Estimated]]:
        """Yield the estimated parameters."""
        raise NotImplementedError

    def check_observable(self, name: str, row: Mapping[Any, Any]) -> None:
        """Refuse a distribution of the noise that is not normal."""
        raise NotImplementedError

    @property
    def is_estimated(self) -> pd.Series:
        """Which parameters are estimated."""
        said = self.parameters["estimate"].astype(str).str.strip().str.lower()
        return said.isin(["1", "1.0", "true"])

    def read(self) -> Petab:
        """Return the problem."""
        if self.measurements.empty or self.observables.empty or self.parameters.empty:
            raise self.refuse("tables of measurements, observables and parameters are needed")
        fixed = self.parameters.loc[~self.is_estimated, "nominalValue"]
        known = {str(name): float(value) for name, value in fixed.items()}
        for name, row in self.observables.iterrows():
            self.check_observable(str(name), row.to_dict())
        unknown = set(self.measurements["observableId"]) - set(self.observables.index)
        if unknown:
            raise self.refuse(f"measurements of {min(unknown)}, which is no observable")
        conditions, of_each = self.conditions(known)
        if undeclared := {*of_each} - {*conditions}:
            raise self.refuse(f"measurements of the condition {min(undeclared)}, which is declared nowhere")
        deviations, noise = self.deviations(known)
        samples = pd.DataFrame(
            {
                "condition": of_each,
                "observable": self.measurements["observableId"].to_list(),
                "time": self.measurements["time"].astype(float).to_list(),
                "value": self.measurements["measurement"].astype(float).to_list(),
                "deviation": deviations,
            }
        )
        if not samples[["time", "value"]].map(math.isfinite).all(axis=None):
            raise self.refuse("a time or a measurement is not finite; a steady state has no moment in a case")
        if (samples["time"] < 0.0).any():
            raise self.refuse("a time lies before 0, the begin of the simulation")
        joined, lost = _without_replicates(samples)
        return Petab(
            samples=joined,
            formulas={str(name): str(one) for name, one in self.observables["observableFormula"].items()},
            estimated=dict(self.estimated()),
            known=known,
            conditions=conditions,
            chi2_of_replicates=lost,
            noise=noise,
        )


class _FirstVersion(_Tables):
    def __init__(self, file: Path, content: Mapping[str, Any]) -> None:
        try:
            import petab.v1 as version
        except ImportError as error:
            raise InputError(MISSING) from error
        (problem,) = content["problems"]
        of_parameters = content["parameter_file"]
        tables = {kind: problem[f"{kind}_files"] for kind in ("condition", "measurement", "observable")}
        tables["parameter"] = of_parameters if isinstance(of_parameters, list) else [of_parameters]
        super().__init__(file, tables, version)

    def placeholders(self, observable: str) -> list[str]:
        return [f"noiseParameter{n}_{observable}" for n in range(1, 10)]

    def check_observable(self, name: str, row: Mapping[Any, Any]) -> None:
        if row.get("observableTransformation", "lin") not in ("lin", "", None):
            raise self.refuse(
                f"{name} is compared as {row['observableTransformation']}; a case compares values"
            )
        if row.get("noiseDistribution", "normal") not in ("normal", "", None):
            raise self.refuse(f"the noise of {name} is {row['noiseDistribution']}; a case has normal noise")

    def conditions(self, known: Mapping[str, float]) -> tuple[dict[str, Condition], list[str]]:
        if self.measurements.get("preequilibrationConditionId", pd.Series(dtype=object)).notna().any():
            raise self.refuse(
                "preequilibration: a case begins at its start values; give these in a condition"
            )
        table, found = self.table("condition"), dict[str, Condition]()
        for name, row in table.drop(columns="conditionName", errors="ignore").iterrows():
            cells = row.dropna().items()
            found[str(name)] = {
                str(target): self.held(str(name), str(target), cell, known) for target, cell in cells
            }
        return found, [str(one) for one in self.measurements["simulationConditionId"]]

    def estimated(self) -> Iterator[tuple[str, Estimated]]:
        for name, row in self.parameters[self.is_estimated].iterrows():
            scale = str(row.get("parameterScale", "lin"))
            kind, numbers = row.get("objectivePriorType"), row.get("objectivePriorParameters")
            prior = self._prior(str(name), scale, kind, self.numbers(numbers, {}))
            yield str(name), _estimated(row, "log" if scale in _SCALES else "linear", prior)

    def _prior(
        self, name: str, scale: str, kind: Any, numbers: tuple[float | None, ...]
    ) -> dict[str, float] | None:
        if not isinstance(kind, str) or kind in ("", "uniform", "parameterScaleUniform"):
            return None  # the bounds say it
        mean, deviation = (one or 0.0 for one in numbers)
        if scale in _SCALES and kind == "parameterScaleNormal":
            return {"about": _SCALES[scale] ** mean, "within_factor": _SCALES[scale] ** deviation}
        if scale in _SCALES and kind == "logNormal":
            return {"about": math.exp(mean), "within_factor": math.exp(deviation)}
        if scale == "lin" and kind in ("normal", "parameterScaleNormal"):
            return {"about": mean, "within": deviation}
        raise self.refuse(f"the prior of {name} is {kind} on the scale {scale}; a case has normal ones on it")


class _SecondVersion(_Tables):
    def __init__(self, file: Path, content: Mapping[str, Any]) -> None:
        try:
            import petab.v2 as version
        except ImportError as error:
            raise InputError(MISSING) from error
        kinds = ("parameter", "condition", "experiment", "measurement", "observable")
        super().__init__(file, {kind: content.get(f"{kind}_files", []) for kind in kinds}, version)

    def placeholders(self, observable: str) -> list[str]:
        said = self.observables.loc[observable].get("noisePlaceholders")
        return said.split(";") if isinstance(said, str) else []

    def check_observable(self, name: str, row: Mapping[Any, Any]) -> None:
        said = row.get("noiseDistribution")
        if isinstance(said, str) and said not in ("normal", ""):
            raise self.refuse(f"the noise of {name} is {said}; a case has normal noise")

    def conditions(self, known: Mapping[str, float]) -> tuple[dict[str, Condition], list[str]]:
        table, periods, found = self.table("condition"), self.table("experiment"), dict[str, Condition]()
        rows = periods.to_dict("records")
        for name, n in pd.Series([one["experimentId"] for one in rows], dtype=object).value_counts().items():
            if n > 1:
                raise self.refuse(f"experiment {name} has several periods; a case has one")
        for one in rows:
            if float(one["time"]) != 0.0:
                raise self.refuse(
                    f"experiment {one['experimentId']} begins at {one['time']}; a case begins at 0"
                )
            values = found.setdefault(str(one["experimentId"]), {})
            if isinstance(one.get("conditionId"), str):
                for change in table[table["conditionId"] == one["conditionId"]].to_dict("records"):
                    target = str(change["targetId"])
                    values[target] = self.held(one["conditionId"], target, change["targetValue"], known)
        named = self.measurements.get("experimentId", pd.Series("", self.measurements.index))
        of_each = [str(one) if isinstance(one, str) else "" for one in named]
        for name in of_each:
            found.setdefault(name, {})
        return found, of_each

    def estimated(self) -> Iterator[tuple[str, Estimated]]:
        for name, row in self.parameters[self.is_estimated].iterrows():
            kind = row.get("priorDistribution")
            numbers = self.numbers(row.get("priorParameters"), {})
            is_wide = (
                float(row["lowerBound"]) > 0.0 and float(row["upperBound"]) / float(row["lowerBound"]) >= 100
            )
            scale, prior = "log" if is_wide else "linear", None
            if isinstance(kind, str) and kind not in ("", "uniform", "log-uniform"):
                mean, deviation = (one or 0.0 for one in numbers)
                if kind == "normal":
                    scale, prior = "linear", {"about": mean, "within": deviation}
                elif kind == "log-normal":
                    scale, prior = "log", {"about": math.exp(mean), "within_factor": math.exp(deviation)}
                else:
                    raise self.refuse(f"the prior of {name} is {kind}; a case has normal and log-normal ones")
            yield str(name), _estimated(row, scale, prior)


def _estimated(row: "pd.Series[Any]", scale: str, prior: Mapping[str, float] | None) -> Estimated:
    nominal = float(row.get("nominalValue", math.nan))
    lower, upper = float(row["lowerBound"]), float(row["upperBound"])
    return Estimated(lower, upper, scale, nominal if lower <= nominal <= upper else None, prior)


def _without_replicates(samples: pd.DataFrame) -> tuple[pd.DataFrame, float]:
    """Join samples of one moment to their weighed mean; return what that takes from the sum of squares."""
    weight = samples["deviation"] ** -2.0
    keys = [samples[name] for name in ("condition", "observable", "time")]
    whole = weight.groupby(keys).transform("sum")
    mean = (weight * samples["value"]).groupby(keys).transform("sum") / whole
    is_alone = weight.groupby(keys).transform("size") == 1
    lost = float((weight * (samples["value"] - mean) ** 2)[~is_alone].sum())
    # What stands alone keeps its digits.
    joined = samples.assign(
        value=mean.where(~is_alone, samples["value"]),
        deviation=(whole**-0.5).where(~is_alone, samples["deviation"]),
    )
    joined = joined.drop_duplicates(["condition", "observable", "time"])
    return joined.sort_values(["condition", "observable", "time"], ignore_index=True), lost


def _line(error: Exception) -> str:
    return shortened(next(iter(str(error).splitlines()), "") or type(error).__name__, 200)

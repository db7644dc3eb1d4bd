"""The finished calibrations of a project, as `status` and `best` show them, and what changed since."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Any

from simulation.errors import InputError
from simulation.foreign_file import parse_toml
from studies.paths import ProjectPaths
from studies.recipe import file_digest, text_digest
from studies.report.wording import difference_unit, squared
from studies.stages.pipeline import read_json
from studies.tuning.results import TunedStudy, read_studies

FIRST_WORDS = "type: studies run (the office, some minutes), or studies new for a case of your own"


@dataclass(frozen=True)
class Calibration:
    """A finished calibration.

    Args:
        label: label of the study.
        stage: its name, such as `calibrate-n0064`.
        manifest: what the stage left: inputs, summary, files, versions, wall time.
        numbers: all its numbers.
        paths: the project.
    """

    label: str
    stage: str
    manifest: Mapping[str, Any]
    numbers: Mapping[str, Any]
    paths: ProjectPaths

    @property
    def name(self) -> str:
        """What it is called on a command line."""
        return f"{self.label}/{self.stage.removeprefix('calibrate-')}"

    @cached_property
    def declared(self) -> Mapping[str, Any]:
        """What its case file declared."""
        try:
            return parse_toml(self.numbers["recipe"]["case"]["text"], self.name)
        except (KeyError, TypeError, InputError):
            return {}

    @property
    def case(self) -> str:
        """Name of its case."""
        return str(self.declared.get("name", self.label))

    @property
    def units(self) -> dict[str, str]:
        """Units of its parameters."""
        return {one["name"]: one.get("unit", "1") for one in self.declared.get("parameters", ())}

    @property
    def unit(self) -> str:
        """Unit of its error."""
        outputs = self.declared.get("outputs", ())
        return squared(difference_unit(outputs[0]["unit"])) if outputs else ""

    @property
    def mse(self) -> float:
        """Its final error, infinite where it failed. [first output's unit squared]."""
        value = self.numbers.get("mse_polished", self.numbers.get("mse"))
        return math.inf if value is None else float(value)

    @property
    def ledger(self) -> Mapping[str, Any]:
        """Its model calls by purpose."""
        found: Mapping[str, Any] = self.numbers["ledger"]
        return found

    @property
    def n_known(self) -> int:
        """Stored simulations that it began with, which are none of its calls."""
        return int(self.numbers.get("n_known", 0))

    @property
    def reason(self) -> str:
        """Why it ended."""
        return str(self.numbers.get("polish_stop_reason", self.numbers.get("stop_reason", "")))

    @property
    def finished(self) -> str:
        """When it was finished, UTC."""
        return str(self.manifest.get("finished", ""))

    @cached_property
    def changed(self) -> tuple[str, ...]:
        """Names of the files that it was made from and that hold something else now."""
        recipe = self.numbers.get("recipe", {})
        made_from = [(recipe["case"]["place"], recipe["case"]["text_sha256"], True)] if recipe else []
        made_from += [(one["place"], one["sha256"], False) for one in recipe.get("files", ())]
        found = []
        for place, digest, is_text in made_from:
            file = self.paths.located(place)
            if file is None:
                continue
            with suppress(OSError):
                text = file.read_text(encoding="utf-8-sig", errors="replace") if is_text else ""
                now = text_digest(text) if is_text else file_digest(file)
                found += [] if now == digest else [file.name]
        return tuple(dict.fromkeys(found))


@dataclass(frozen=True)
class Project:
    """The studies and calibrations of a project.

    Args:
        paths: where everything lies.
        studies: its Optuna studies.
        calibrations: its finished calibrations.
    """

    paths: ProjectPaths
    studies: Sequence[TunedStudy]
    calibrations: Sequence[Calibration]

    def chosen(self, which: str | None) -> "Project":
        """Return what a case, a label or a pattern of labels means; all where nothing is named.

        Raises:
            InputError: nothing is called so.
        """
        if which is None:
            return self
        cases = {one.spec.label: one.spec.case_name for one in self.studies}
        cases |= {one.label: one.case for one in self.calibrations}
        labels = {label for label, case in cases.items() if fnmatchcase(label, which) or case == which}
        if not labels:
            known = sorted({*cases, *cases.values()})
            close = get_close_matches(which, known, n=1, cutoff=0.5)
            hint = f"did you mean {close[0]}? " if close else ""
            raise InputError(
                f"nothing is called {which!r}; {hint}labels: {', '.join(sorted(cases)) or 'none'}"
            )
        return Project(
            self.paths,
            [one for one in self.studies if one.spec.label in labels],
            [one for one in self.calibrations if one.label in labels],
        )


def _check(one: Calibration, where: str) -> None:
    """Refuse a calibration whose values are not what their names promise; a record may be a stranger's.

    Raises:
        InputError: one is not.
    """
    try:
        numbers = [one.mse, one.n_known, *map(float, one.numbers["theta"].values())]
        calls = [one.ledger[name] for name in ("total_paper", "total_honest")]
        texts = [one.unit, *one.units, *one.units.values(), *one.changed]
        fixed = one.numbers.get("restriction", {}).get("fixed", {})
        is_good = all(isinstance(text, str) for text in texts) and all(type(n) is int for n in calls)
        is_good &= isinstance(fixed, dict) and len(numbers) > 2
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
        is_good = False
    if not is_good:
        raise InputError(f"{where}: holds no calibration that this version can read; move it away")


def read_project(paths: ProjectPaths) -> Project:
    """Read what a project holds."""
    found = []
    for file in sorted((paths.mlruns / "results").glob("*/calibrate-*.json")):
        manifest = read_json(file)
        numbers = read_json(file.with_name(f"calibration-{file.stem.removeprefix('calibrate-')}.json"))
        if manifest is not None and numbers is not None:
            one = Calibration(file.parent.name, file.stem, manifest, numbers, paths)
            _check(one, paths.show(file))
            found.append(one)
    return Project(paths, read_studies(paths), found)

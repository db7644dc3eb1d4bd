"""Every result of a project with what it was made from, read from recipes and records."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from simulation.errors import InputError
from simulation.time_unit import told_period
from studies.paths import ProjectPaths
from studies.recipe import file_digest, text_digest
from studies.tuning.trial_record import trial_name
from studies.tuning.trial_store import list_studies, open_trials

State = Literal["unchanged", "changed", "missing"]
WEIGHTS = "weights.npz"
LEAST_DIGITS = 6
SETS = ("train", "validation", "test")


@dataclass(frozen=True)
class Node:
    """One thing that was made, or that others were made from.

    Args:
        kind: what it is.
        name: what it is called.
        digest: sha256 of its content, as it was recorded.
        place: where it lies.
        parents: keys of what it was made from.
        look: says what became of it.
    """

    kind: str
    name: str
    digest: str
    place: str
    parents: tuple[str, ...]
    look: Callable[[], State]


class Ancestry:
    """All results of a project with what each was made from.

    Args:
        paths: the project.

    Attributes:
        nodes: Everything, by keys of its own.
        children: Keys of what was made of each.
    """

    def __init__(self, paths: ProjectPaths) -> None:
        self._paths = paths
        self.nodes: dict[str, Node] = {}
        self._states: dict[str, State] = {}
        self.children: dict[str, list[str]] = {}
        for entry in list_studies(paths):
            if entry.recipe:
                self._study(entry.name, entry.n_train, entry.recipe)
        for file in sorted((paths.mlruns / "champions").glob("*/n[0-9]*/champion.json")):
            self._champion(file)
        for file in sorted((paths.mlruns / "results").glob("*/*.json")):
            if file.stem.startswith("calibration-") or file.stem == "sensitivity":
                self._stage(file)

    def find(self, name: str) -> str:
        """Return the key of a thing by its name, its place or the first digits of its digest.

        Raises:
            InputError: nothing is known of it.
        """
        study, _, last = name.rpartition("/")
        if last[:1] == "t" and last[1:].isdigit() and f"study {study}" in self.nodes:
            self._trial(study, int(last[1:]))
        for key, node in self.nodes.items():
            if name in (node.name, node.place) or (
                len(name) >= LEAST_DIGITS and node.digest.startswith(name)
            ):
                return key
        raise InputError(f"nothing is known of what {name} was made from; studies status shows all names")

    def state(self, key: str) -> State:
        """Look at a thing, once."""
        if key not in self._states:
            self._states[key] = self.nodes[key].look()
        return self._states[key]

    def _add(
        self,
        kind: str,
        name: str,
        *,
        digest: str,
        place: str,
        look: Callable[[], State],
        parents: tuple[str, ...] = (),
        identity: str = "",
    ) -> str:
        key = f"{kind} {identity or name}"
        if key not in self.nodes:
            self.nodes[key] = Node(kind, name, digest, place, parents, look)
            for parent in parents:
                self.children.setdefault(parent, []).append(key)
        return key

    def _case(self, recipe: Mapping[str, Any]) -> str:
        told = recipe["case"]
        files = [
            self._add(
                "FMU" if one["role"] == "fmu" else "recording",
                Path(one["place"]).name + ("" if one["role"] == "fmu" else f" ({one['role']})"),
                digest=one["sha256"],
                place=one["place"],
                look=partial(self._file_state, one["place"], one["sha256"]),
                identity=f"{one['sha256']} {one['place']}",
            )
            for one in recipe["files"]
        ]
        return self._add(
            "case",
            f"{told['name']}, {told_period(recipe['window_d'])}",
            digest=told["digest"],
            place=told["place"],
            look=lambda: self._text_state(told["place"], told["text_sha256"]),
            parents=tuple(files),
            identity=f"{told['digest']} {told['measurement_digest']} {told['text_sha256']}",
        )

    def _study(self, name: str, n_train: int, recipe: Mapping[str, Any]) -> None:
        case = self._case(recipe)
        sets = [self._rows(role, recipe["datasets"][role], case) for role in SETS]
        place = open_trials(self._paths, name).place
        folder = Path(place)
        shown = self._paths.show(folder) if folder.is_absolute() else place
        self._add(
            "study",
            name,
            digest=name.rpartition("/")[2],
            place=shown,
            look=lambda: "unchanged" if open_trials(self._paths, name).finished() else "missing",
            parents=tuple(sets),
        )

    def _rows(self, role: str, how: Mapping[str, Any], case: str) -> str:
        return self._add(
            "rows",
            f"{how['n']} {role} rows, seed {how['seed']}",
            digest=how["digest"],
            place=how["file"],
            look=lambda: self._rows_state(how),
            parents=(case,),
            identity=how["digest"],
        )

    def _trial(self, study: str, index: int) -> str:
        name = f"{study}/{trial_name(index)}"
        store = open_trials(self._paths, study)
        record = store.record(index)
        folder = Path(store.place) / trial_name(index)
        return self._add(
            "trial",
            name,
            digest=record.weights_sha256 if record else "",
            place=self._paths.show(folder) if folder.is_dir() else store.place,
            look=lambda: "unchanged" if record else "missing",
            parents=(f"study {study}",) if f"study {study}" in self.nodes else (),
        )

    def _champion(self, file: Path) -> None:
        content = _read(file)
        digest = content.get("files_sha256", {}).get(WEIGHTS)
        if digest:
            place = self._paths.show(file.parent)
            name = f"{content['label']}/{file.parent.name} champion"
            self._model(name, digest, place, str(content["study"]), int(content["index"]))

    def _model(self, name: str, digest: str, place: str, study: str, index: int) -> str:
        return self._add(
            "model",
            name,
            digest=digest,
            place=place,
            look=lambda: self._file_state(f"{place}/{WEIGHTS}", digest) if place else "missing",
            parents=(self._trial(study, index),),
            identity=digest,
        )

    def _stage(self, file: Path) -> None:
        content = _read(file)
        recipe = content.get("recipe")
        if not recipe:
            return
        case = self._case(recipe)
        parents: tuple[str, ...] = (case,)
        if used := recipe.get("surrogate"):
            digest = used["files_sha256"][WEIGHTS]
            name = f"{used['study'].rpartition('/')[0]} former champion"
            parents = (self._model(name, digest, "", used["study"], int(used["trial"])), case)
        kind = "sensitivity" if file.stem == "sensitivity" else "calibration"
        place = self._paths.show(file)
        stage = file.stem.replace("calibration-", "calibrate-")
        self._add(
            kind,
            f"{file.parent.name}/{stage}",
            digest=file_digest(file),
            place=place,
            look=lambda: self._stage_state(file),
            parents=parents,
        )

    def _stage_state(self, file: Path) -> State:
        """Compare a stage's files with the sizes in its manifest."""
        manifest = _read(file.with_name(file.name.replace("calibration-", "calibrate-")))
        for place, size in manifest.get("files", {}).items():
            made = self._paths.root / place
            if not made.is_file():
                return "missing"
            if made.stat().st_size != size:
                return "changed"
        return "unchanged" if manifest else "missing"

    def _file_state(self, place: str, digest: str) -> State:
        file = self._paths.root / place
        if not file.is_file():
            return "missing"
        return "unchanged" if file_digest(file) == digest else "changed"

    def _text_state(self, place: str, digest: str) -> State:
        try:
            text = (self._paths.root / place).read_text(encoding="utf-8-sig")
        except (OSError, UnicodeDecodeError):
            return "missing"
        return "unchanged" if text_digest(text) == digest else "changed"

    def _rows_state(self, how: Mapping[str, Any]) -> State:
        from simulation.store.row_set import RowSet

        try:
            rows = RowSet.load(self._paths.root / how["file"]).read(how["n"])
        except InputError:
            return "missing"
        return "unchanged" if rows.digest == how["digest"] else "changed"


def _read(file: Path) -> dict[str, Any]:
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}

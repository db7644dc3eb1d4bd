"""A recorded result's study, put together again in a scratch folder: case, profile, data sets, surrogate."""

import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simulation.arrays import FloatArray
from simulation.case import load_case
from simulation.design import uniform_design
from simulation.errors import InputError
from simulation.store.row_set import RowSet
from simulation.store.store import SimulationStore
from studies.console import Console
from studies.paths import ProjectPaths
from studies.physical_model import open_physical_model, store_folder
from studies.profile import profile_from
from studies.recipe import file_digest
from studies.reproduction.recorded import Recorded
from studies.reproduction.sources import lay_out
from studies.stages.learn import study_specs
from studies.stages.pipeline import Study
from studies.tuning.champion import WEIGHTS_FILE
from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_store import open_trials

if TYPE_CHECKING:
    from pelsvae.surrogate import Surrogate


@dataclass
class Rebuilt:
    """A study that follows a recipe; everything it makes lies in its scratch folder.

    Args:
        study: case, profile and folders.
        paths: the project, which is only read.
        recorded: what is made again.
        notes: what a user should know of how it was rebuilt.
    """

    study: Study
    paths: ProjectPaths
    recorded: Recorded
    notes: list[str] = field(default_factory=list)

    def spec(self) -> StudySpec:
        """Return the study of the recipe's training-set size, its data sets read or simulated again."""
        recipe = self.recorded.recipe
        sets = recipe["datasets"]
        places = {name: self.study.paths.root / "sets" / f"{name}.npz" for name in sets}
        lost = {name: how for name, how in sets.items() if not self._is_stored(how, places[name])}
        if lost:
            self._simulate(lost, places)
        files = {name: self.study.paths.relative(file) for name, file in places.items()}
        data = replace(self.study.profile.data, n_train=(recipe["n_train"],))
        study = replace(self.study, profile=replace(self.study.profile, data=data))
        (spec,) = study_specs(study, {"files": files})
        return spec

    def surrogate(self, retrain: Callable[[Path], None]) -> "Surrogate":
        """Return the surrogate a calibration used: its own weights wherever they lie, else trained again.

        Args:
            retrain: trains it into a folder.
        """
        from pelsvae.surrogate import Surrogate

        recipe = self.recorded.recipe
        wanted, folder = recipe["surrogate"], self.study.paths.root / "surrogate"
        folder.mkdir()
        if not self._fetch(wanted, folder):
            self.notes.append(
                f"the weights of {wanted['study']} trial {wanted['trial']} are not here; it is trained again"
            )
            retrain(folder)
            if file_digest(folder / WEIGHTS_FILE) != wanted["files_sha256"][WEIGHTS_FILE]:
                self.notes.append("the weights that were trained again are not those that were recorded")
        return Surrogate.load(folder, device="cpu")

    def _fetch(self, wanted: Mapping[str, Any], folder: Path) -> bool:
        digest = wanted["files_sha256"][WEIGHTS_FILE]
        champion = self.paths.champion(self.study.label, self.recorded.recipe["n_train"])
        if (champion / WEIGHTS_FILE).is_file() and file_digest(champion / WEIGHTS_FILE) == digest:
            shutil.copytree(champion, folder, dirs_exist_ok=True)
            return True
        store = open_trials(self.paths, wanted["study"])
        if store.fetch_surrogate(wanted["trial"], folder):
            return bool(file_digest(folder / WEIGHTS_FILE) == digest)
        return False

    def _is_stored(self, how: Mapping[str, Any], file: Path) -> bool:
        """Point to the project's stored rows of a data set where they are what was recorded."""
        stored = RowSet(self._design(how), store_folder(self.paths, self.study.case), file)
        if _digest_of(stored) != how["digest"]:
            return False
        stored.save()
        return True

    def _simulate(self, lost: Mapping[str, Mapping[str, Any]], places: Mapping[str, Path]) -> None:
        """Simulate data sets again and say whether they are what was recorded."""
        total = sum(how["n"] for how in lost.values())
        with (
            open_physical_model(self.study) as model,
            self.study.console.progress("simulations again", total) as advance,
        ):
            for name, how in lost.items():
                rows = RowSet(self._design(how), model.store.folder, places[name])
                model.complete(rows.theta, on_progress=lambda n_done: advance(n_done, total))
                rows.save()
        for name, how in lost.items():
            is_same = _digest_of(RowSet.load(places[name])) == how["digest"]
            came = "the recorded ones" if is_same else f"NOT the recorded ones ({how['digest'][:12]})"
            self.notes.append(
                f"{how['n']} {name} simulations are not stored here as they were recorded; "
                f"simulated again they are {came}"
            )

    def _design(self, how: Mapping[str, Any]) -> FloatArray:
        return uniform_design(self.study.case.parameter_space, how["n"], how["seed"])


@contextmanager
def rebuilt(
    recorded: Recorded, paths: ProjectPaths, console: Console, *, n_jobs: int, keep: Path | None
) -> Iterator[Rebuilt]:
    """Lay out a result's case in a scratch folder, which is removed at the end.

    Args:
        recorded: the result.
        paths: the project, which is only read.
        console: tells the user.
        n_jobs: processes for simulations.
        keep: scratch folder that stays; None for one that is removed.

    Raises:
        InputError: a file the recipe names is nowhere, or the case cannot be read any more.
    """
    recipe = recorded.recipe
    if keep is not None:
        shutil.rmtree(keep, ignore_errors=True)
        keep.mkdir(parents=True)
    scratch = keep or Path(tempfile.mkdtemp(prefix="studies-reproduce-"))
    try:
        file, notes = lay_out(recipe, paths, scratch, commit=recorded.environment.get("git_commit", ""))
        begin, end = recipe["window_d"]
        study = Study(
            case=load_case(file, window_d=(begin, end)),
            profile=profile_from(recipe["profile"], f"the recipe of {recorded.name}"),
            paths=ProjectPaths(scratch),
            console=console,
            n_jobs=n_jobs,
            label=recipe["label"],
            command=recipe["command"],
        )
        yield Rebuilt(study, paths, recorded, notes)
    finally:
        if keep is None:
            shutil.rmtree(scratch, ignore_errors=True)


def _digest_of(rows: RowSet) -> str | None:
    """Return the digest of stored rows, None where they are not all stored."""
    if not rows.store.is_dir():
        return None
    try:
        with SimulationStore.at(rows.store) as store:
            return store.read(rows.theta).digest
    except (InputError, LookupError):
        return None

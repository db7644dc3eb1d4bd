"""Where everything lies: the project's root, its cases, and what a run leaves behind."""

import os
from contextlib import suppress
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path

from simulation.errors import InputError
from simulation.foreign_text import has_control, quoted, shortened
from studies.storage_url import STORAGE_VARIABLE, in_schema, read_storage

ROOT_VARIABLE = "STUDIES_ROOT"


@dataclass(frozen=True)
class ProjectPaths:
    """The folders of one project, and its database server where it has one.

    Args:
        root: folder that holds `fmus/`, `data/` and `mlruns/`.
        storage: PostgreSQL URL of trials, Optuna's and MLflow's stores; None for files below the root.
    """

    root: Path
    storage: str | None = field(default=None, repr=False)

    @property
    def fmus(self) -> Path:
        """Folder of the cases and their FMUs."""
        return self.root / "fmus"

    @property
    def data(self) -> Path:
        """Folder of the recordings."""
        return self.root / "data"

    @property
    def mlruns(self) -> Path:
        """Folder of everything a run leaves behind."""
        return self.root / "mlruns"

    @property
    def tracking_database(self) -> Path:
        """MLflow's SQLite file."""
        return self.mlruns / "mlflow.db"

    @property
    def tracking_uri(self) -> str:
        """MLflow's URI; on a server it holds the user's password and is not for showing."""
        if self.storage is not None:
            return in_schema(self.storage, "mlflow")
        return f"sqlite:///{self.tracking_database.resolve().as_posix()}"

    @property
    def artifacts(self) -> Path:
        """Root of MLflow's artifacts."""
        return self.mlruns / "artifacts"

    def generated(self, case_name: str) -> Path:
        """Folder of the simulated trajectories of a case."""
        return self.data / folder_name(case_name) / "generated"

    def champions(self, label: str) -> Path:
        """Folder of the best surrogate per training-set size."""
        return self.mlruns / "champions" / folder_name(label)

    def champion(self, label: str, n_train: int) -> Path:
        """Folder of the best surrogate for one training-set size."""
        return self.champions(label) / size_name(n_train)

    def results(self, label: str) -> Path:
        """Folder of stage manifests and calibration results."""
        return self.mlruns / "results" / folder_name(label)

    def report(self, label: str) -> Path:
        """Folder of tables and figures."""
        return self.mlruns / "reports" / folder_name(label)

    def relative(self, file: Path) -> str:
        """Return the place of a file below the root, which holds wherever the project is moved.

        Links are not followed: a folder of the project may lie on another disk.

        Raises:
            ValueError: the file is not below the root.
        """
        return file.relative_to(self.root).as_posix()

    def show(self, path: Path) -> str:
        """Return a path as a reader in the project's root would type it."""
        for place in (path, path.resolve()):
            if place.is_relative_to(self.root):
                return str(place.relative_to(self.root))
        return str(path.resolve())


def folder_name(name: str) -> str:
    """Return the name of a case or a label as that of a folder.

    Raises:
        InputError: it would lead to another place, or holds what no name may hold.
    """
    if (
        name in ("", ".", "..")
        or "/" in name
        or has_control(name)
        or len(name.encode(errors="replace")) > 200
    ):
        raise InputError(f"{quoted(name)} is no name of a case or a label; `studies status` lists the labels")
    return name


def size_name(n_train: int) -> str:
    """Return the zero-padded name of a training-set size, so that names sort as numbers."""
    return f"n{n_train:04d}"


def find_project(storage: str | None) -> ProjectPaths:
    """Find the project: `$STUDIES_ROOT`, else a folder above the working one, else above this package.

    Args:
        storage: PostgreSQL URL; None takes `$STUDIES_STORAGE`, and files where that is not set either.

    Raises:
        InputError: `$STUDIES_ROOT` is set and is no folder, or the storage is no URL of a database.
    """
    url = storage or os.environ.get(STORAGE_VARIABLE)
    return ProjectPaths(_find_root(), read_storage(url) if url else None)


def _find_root() -> Path:
    declared = os.environ.get(ROOT_VARIABLE)
    if declared:
        root = Path(declared).expanduser()
        if not root.is_dir():
            raise InputError(f"${ROOT_VARIABLE} is {declared!r}, which is not a folder; correct or unset it")
        return root.resolve()
    working = Path.cwd().resolve()
    for folder in (working, *working.parents):
        if (folder / "fmus").is_dir() and (folder / "pyproject.toml").is_file():
            return folder
    return Path(__file__).resolve().parent.parent


def find_case(paths: ProjectPaths, case: str) -> Path:
    """Return the case file that a name, a file or a folder means.

    A name is looked for as `fmus/<name>/case.toml`, then as `fmus/*/<name>.toml`.

    Raises:
        InputError: nothing of that name exists; the line lists the cases there are.
    """
    named = _named_cases(paths)
    if case in named:
        return named[case]
    given = Path(case).expanduser()
    with suppress(OSError):  # a name that is too long
        if (given / "case.toml").is_file():
            return given / "case.toml"
        if given.is_dir():
            raise InputError(
                f"the folder {case!r} has no case.toml; give a case's name, its file or its folder"
            )
        if given.is_file():
            return given
    if given.suffix or len(given.parts) > 1:
        raise InputError(
            f"there is no case file {shortened(case)}; cases by name: {', '.join(named) or 'none'}"
        )
    close = get_close_matches(case, named, n=1)
    hint = f"did you mean {close[0]!r}? " if close else ""
    raise InputError(
        f"there is no case {quoted(case)}; {hint}cases in {paths.fmus}: {', '.join(named) or 'none'}"
    )


def _named_cases(paths: ProjectPaths) -> dict[str, Path]:
    # build.toml says how an FMU is compiled.
    others = {"case.toml", "build.toml"}
    named = {file.stem: file for file in sorted(paths.fmus.glob("*/*.toml")) if file.name not in others}
    named |= {file.parent.name: file for file in sorted(paths.fmus.glob("*/case.toml"))}
    return dict(sorted(named.items()))

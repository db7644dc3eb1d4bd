"""Where everything lies: the project's root and its marker, its cases, and what a run leaves behind."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path

from simulation.errors import InputError, MachineError
from simulation.file_lock import FileLock
from simulation.foreign_text import has_control, quoted, shortened
from simulation.whole_file import whole_file
from simulation.write_gate import check_database, guard_project
from studies.embedded import EMBEDDED, case_files, embedded_file, embedded_place
from studies.server import Server, choose_server, give_identity, settings
from studies.shared_database import alone_on
from studies.storage_url import STORAGE_VARIABLE, in_schema, read_storage
from studies.words.console import Console

MARKER = "studies.toml"
ROOT_VARIABLE = "STUDIES_ROOT"
TEXT = "# This folder is a project of `studies`: results go to mlruns/ and data/, own cases to fmus/.\n"


@dataclass(frozen=True)
class ProjectPaths:
    """The folders of one project, and its database server where it has one.

    Args:
        root: folder that holds `fmus/`, `data/` and `mlruns/`.
        storage: PostgreSQL URL of Optuna's and MLflow's stores; None for files below the root.
        server: the MLflow server that runs are sent to; None for the project's own store alone.
    """

    root: Path
    storage: str | None = None
    server: Server | None = None

    def __post_init__(self) -> None:
        # Whoever names a project writes in it: no link leads out of it from now on.
        guard_project(self.root)

    @property
    def identity(self) -> str:
        """What distinguishes the project from others of its name in a shared database or server.

        A copy or a clone keeps it. It is empty where nothing is shared, and before the first command.
        """
        is_shared = self.storage is not None or self.server is not None
        return str(settings(self.root / MARKER).get("project", "")) if is_shared else ""

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
        """MLflow's URI."""
        return self._uri("mlflow", self.tracking_database)

    @property
    def optuna_database(self) -> Path:
        """Optuna's SQLite file."""
        return self.mlruns / "optuna.db"

    @property
    def optuna_url(self) -> str:
        """URL by which `optuna.load_study` finds the studies."""
        return self._uri("optuna", self.optuna_database)

    def _uri(self, schema: str, file: Path) -> str:
        if self.storage is not None:
            return in_schema(self.storage, schema)
        return f"sqlite:///{file.resolve().as_posix()}"

    @property
    def artifacts(self) -> Path:
        """Root of MLflow's artifacts."""
        return self.mlruns / "artifacts"

    def generated(self, case_name: str) -> Path:
        """Folder of the simulated trajectories of a case."""
        return self.data / folder_name(case_name) / "generated"

    def results(self, label: str) -> Path:
        """Folder of stage manifests and calibration results."""
        return self.mlruns / "results" / folder_name(label)

    def report(self, label: str) -> Path:
        """Folder of tables and figures."""
        return self.mlruns / "reports" / folder_name(label)

    def recorded(self, path: Path) -> str:
        """Return the name by which results remember a file, which holds wherever the project is moved.

        It is the place below the root. A file of an embedded case gets the place that it would have in the
        project. Any other file is named absolutely.
        """
        for place in (path, path.resolve()):
            if place.is_relative_to(self.root) and ".." not in place.parts:
                return place.relative_to(self.root).as_posix()
        return embedded_place(path.resolve()) or str(path.resolve())

    def located(self, recorded: object) -> Path | None:
        """Return the file or folder that a recorded name means: the project's own, else an embedded case's.

        A file that was deleted from a case of the project is not looked for among the embedded cases. A
        record may be a stranger's. None is what is not there, is a pipe or a device, or lies outside of both.
        """
        if not isinstance(recorded, str) or has_control(recorded) or ".." in Path(recorded).parts:
            return None
        file = self.root / recorded
        with suppress(OSError):  # a name that is too long
            if file.is_relative_to(self.root) and (file.is_file() or file.is_dir()):
                return file
            return None if self.has_case_folder(recorded) else embedded_file(recorded)
        return None

    def has_case_folder(self, recorded: str) -> bool:
        """Say whether a recorded name lies in the folder of a case, and the project has that folder.

        An embedded case of this name is another one then, whatever is left in the folder.
        """
        parts = Path(recorded).parts
        return len(parts) > 2 and parts[0] == self.fmus.name and self.fmus.joinpath(parts[1]).is_dir()

    def show(self, path: Path) -> str:
        """Return a path that holds in the working folder, for people; results remember `recorded` names.

        It is relative where the working folder and the path are inside the project, else absolute.
        """
        here = Path.cwd()
        for place in (path, path.resolve()):
            if place.is_relative_to(self.root) and here.is_relative_to(self.root):
                return os.path.relpath(place, here)
        return str(path.resolve())


def folder_name(name: str) -> str:
    """Return the name of a case or a label as that of a folder.

    Raises:
        InputError: it would lead to another place, or holds what no name may hold.
    """
    leads_away = name in ("", ".", "..") or "/" in name
    if leads_away or has_control(name) or len(name.encode(errors="replace")) > 200:
        raise InputError(f"{quoted(name)} is no name of a case or a label; `studies status` lists the labels")
    return name


def size_name(n_train: int) -> str:
    """Return the zero-padded name of a training-set size, so that names sort as numbers."""
    return f"n{n_train:04d}"


def find_project(storage: str | None, tracking: str | None = None) -> ProjectPaths:
    """Find the project: the nearest folder with a marker, from the working folder upwards.

    Where there is none, it is the working folder. `$STUDIES_ROOT` names another folder to begin at.

    Args:
        storage: PostgreSQL URL; None takes `$STUDIES_STORAGE`, and files where that is not set either.
        tracking: URL of an MLflow server, or "local"; None takes `$MLFLOW_TRACKING_URI`, then the project's.

    Raises:
        InputError: `$STUDIES_ROOT` is set and is no folder, or an address is none or not allowed.
    """
    declared = os.environ.get(ROOT_VARIABLE)
    begin = Path(declared).expanduser() if declared else Path.cwd()
    if not begin.is_dir():
        raise InputError(f"${ROOT_VARIABLE} is {declared!r}, which is not a folder; correct or unset it")
    begin = begin.resolve()
    root = next((folder for folder in (begin, *begin.parents) if (folder / MARKER).is_file()), begin)
    url = storage or os.environ.get(STORAGE_VARIABLE)
    alone = ProjectPaths(root, read_storage(url) if url else None)
    return replace(alone, server=choose_server(tracking, root / MARKER, alone.tracking_uri))


def find_case(paths: ProjectPaths, case: str) -> Path:
    """Return the case file that a name, a file or a folder means.

    A name is looked for as `fmus/<name>/case.toml`, then as `fmus/*/<name>.toml`: in the project first, then
    among the embedded cases. A folder of the project whose case file was deleted stands for no embedded case.

    Raises:
        InputError: nothing of that name exists; the line lists the cases there are.
    """
    own, embedded = case_files(paths.fmus), case_files(EMBEDDED / "fmus")
    deleted = {
        name: file for name, file in embedded.items() if name not in own and _place_is_own(paths, file)
    }
    embedded = {name: file for name, file in embedded.items() if name not in deleted}
    named = embedded | own
    if case in named:
        return named[case]
    given = Path(case).expanduser()
    with suppress(OSError):  # a name that is too long
        if (given / "case.toml").exists():
            return given / "case.toml"
        if given.is_dir():
            raise InputError(
                f"the folder {case!r} has no case.toml; give a case's name, its file or its folder"
            )
        if given.exists():
            return given
    if case in deleted:
        file = paths.fmus / deleted[case].relative_to(EMBEDDED / "fmus")
        raise InputError(
            f"{paths.show(file)} is missing from the folder of this case; restore it, or remove the whole "
            f"folder to use the embedded case {case}"
        )
    known = f"cases in {paths.fmus}: {', '.join(own) or 'none'}"
    if paths.root != EMBEDDED:
        known += f"; embedded cases: {', '.join(embedded) or 'none'}"
    if given.suffix or len(given.parts) > 1:
        raise InputError(f"there is no case file {shortened(case)}; {known}")
    close = get_close_matches(case, named, n=1)
    hint = f"did you mean {close[0]!r}? " if close else ""
    raise InputError(f"there is no case {quoted(case)}; {hint}{known}")


def _place_is_own(paths: ProjectPaths, embedded: Path) -> bool:
    place = embedded_place(embedded)
    return place is not None and paths.has_case_folder(place)


@contextmanager
def opening(paths: ProjectPaths, program: str, file: Path) -> Iterator[None]:
    """Let one process at a time open the database of a program, and say in a line why it cannot.

    Args:
        paths: the project.
        program: Optuna or MLflow.
        file: its database where no server holds it.

    Raises:
        InputError: the program refuses, or a link leads the database out of the project.
        MachineError: the database cannot be reached or written.
    """
    if paths.storage is None:
        check_database(file)
    try:
        # Processes that make the tables at the same moment would get in each other's way.
        shared = nullcontext() if paths.storage is None else alone_on(paths.storage)
        with FileLock(paths.mlruns / f".{program.lower()}.lock"), shared:
            yield
    except (InputError, MachineError, OSError):
        raise
    except Exception as error:
        cause = error.__cause__ or error
        said = next(iter(str(cause).splitlines()), type(cause).__name__)
        where = paths.show(file) if paths.storage is None else paths.storage
        kind = MachineError if "Operational" in f"{type(cause).__name__} {said}" else InputError
        raise kind(
            f"{program} cannot open {where} ({said}); check that it can be reached and written"
        ) from None


def mark_project(paths: ProjectPaths, console: Console) -> None:
    """Make a folder a project and name it; one that shares a database or a server gets an identity.

    Raises:
        MachineError: the folder cannot be written.
    """
    root, is_shared = paths.root, paths.storage is not None or paths.server is not None
    file = root / MARKER
    if file.is_file() and (paths.identity or not is_shared):
        return
    is_new = not file.is_file()
    try:
        if is_new:
            with whole_file(file) as stream:
                stream.write(TEXT.encode())
        if is_shared:
            with FileLock(paths.mlruns / ".identity.lock"):
                give_identity(file)
    except OSError as error:
        raise MachineError(
            f"{root}: the project's folder cannot be written ({error.strerror}); go to another folder"
        ) from None
    if is_new:
        console.say(f"project: {root} ({MARKER} made)")

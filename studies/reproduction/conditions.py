"""What differs between the circumstances of a recorded result and those of now, key by key."""

import difflib
import re
import shlex
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.profile import load_profile
from studies.reproduction.comparison import flat
from studies.reproduction.recorded import Recorded
from studies.reproduction.sources import state_of
from studies.tracking.origin import CODE

# What a digit may depend on; the others are told and no more.
DECISIVE = frozenset(
    (
        "python",
        "numpy",
        "scipy",
        "torch",
        "numba",
        "fmpy",
        "SALib",
        "machine",
        "cpu",
        "blas",
        "device",
        "libc",
    )
)
_CODE = "code "
_CODE_ROOT = Path(__file__).resolve().parents[2]
_N_LINES = 6


@dataclass(frozen=True)
class Difference:
    """One thing that is not as it was.

    Args:
        key: what it is.
        recorded: as it was.
        now: as it is.
        is_decisive: whether numbers made now may come out differently because of it; what is rebuilt from the
            record, such as a case file that was changed since, is not.
        detail: lines of a short diff.
    """

    key: str
    recorded: str
    now: str
    is_decisive: bool
    detail: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


def differences(recorded: Recorded, paths: ProjectPaths, now: Mapping[str, str]) -> list[Difference]:
    """Return what differs: environment, case file, recordings, FMU, profile.

    Args:
        recorded: the result.
        paths: the project.
        now: the present environment.
    """
    found = list(_environment(recorded.environment, now))
    found += _case_file(recorded, paths)
    found += _files(recorded, paths)
    found += _profile(recorded)
    return found


def expectation(found: list[Difference], *, is_known: bool) -> str:
    """Say whether equal numbers can be expected.

    Args:
        found: what differs.
        is_known: whether the environment was recorded.
    """
    if not is_known:
        return "the environment was not recorded: whether the numbers will be equal cannot be told"
    decisive = [one.key for one in found if one.is_decisive]
    if decisive:
        return f"the numbers may differ, because of: {', '.join(decisive)}"
    return "nothing that decides a number differs: equal numbers are expected"


def _environment(was: Mapping[str, str], now: Mapping[str, str]) -> Iterator[Difference]:
    if not was:
        return
    was, now = _with_libc(was), _with_libc(now)
    for key in dict.fromkeys([*was, *now]):
        if was.get(key) == now.get(key) or key in ("n_threads",):
            continue
        is_code = key.startswith(_CODE)
        yield Difference(
            key,
            _short(was.get(key, "–")),
            _short(now.get(key, "–")),
            is_decisive=is_code or key in DECISIVE,
            detail=_changed_code(was.get("git_commit", ""), key.removeprefix(_CODE)) if is_code else (),
        )


def _with_libc(environment: Mapping[str, str]) -> dict[str, str]:
    """Name the C library by itself: its mathematics decide digits, the kernel does not."""
    found = re.search(r"glibc[\d.]+|musl[\d.]+", environment.get("platform", ""))
    return {**environment, **({"libc": found[0]} if found else {})}


def _changed_code(commit: str, room: str) -> tuple[str, ...]:
    """Return which files of a room changed since a commit, as far as git knows."""
    if not commit:
        return ()
    command = ["git", "diff", "--stat=90", "--no-ext-diff", commit, "--", *CODE[room]]
    try:
        answer = subprocess.run(
            command, cwd=_CODE_ROOT, capture_output=True, text=True, timeout=20, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return (f"commit {commit[:12]} is not known here, so what changed cannot be told; try git fetch",)
    lines = [line.strip() for line in answer.stdout.splitlines()]
    if not lines:
        return (f"as committed in {commit[:12]}; the result was made from changes that were never committed",)
    shown = lines[:-1][:_N_LINES]
    return (*shown, lines[-1])


def _case_file(recorded: Recorded, paths: ProjectPaths) -> Iterator[Difference]:
    told = recorded.recipe["case"]
    file = paths.root / told["place"]
    try:
        text = file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError):
        yield Difference(f"case file {told['place']}", told["text_sha256"][:12], "missing", is_decisive=False)
        return
    if text == told["text"]:
        return
    lines = difflib.unified_diff(told["text"].splitlines(), text.splitlines(), lineterm="", n=0)
    changed = [line for line in lines if line[:1] in "+-" and line[:3] not in ("+++", "---")]
    more = [f"... {len(changed) - _N_LINES} more lines"] if len(changed) > _N_LINES else []
    yield Difference(
        f"case file {told['place']}",
        told["text_sha256"][:12],
        f"{len(changed)} changed lines",
        is_decisive=False,
        detail=(*changed[:_N_LINES], *more),
    )


def _files(recorded: Recorded, paths: ProjectPaths) -> Iterator[Difference]:
    for one in recorded.recipe["files"]:
        if state := state_of(one, paths):
            yield Difference(f"{one['role']} {one['place']}", one["sha256"][:12], state, is_decisive=False)


def _profile(recorded: Recorded) -> Iterator[Difference]:
    was = recorded.recipe["profile"]
    words = shlex.split(recorded.recipe["command"])
    name = words[words.index("--profile") + 1] if "--profile" in words else "quick"
    try:
        now = load_profile(name).to_dict()
    except InputError:
        yield Difference(f"profile {name}", was["name"], "missing or unreadable", is_decisive=False)
        return
    before, after = flat(was), flat(now)
    overridden = ("seed",)
    for key in dict.fromkeys([*before, *after]):
        old, new = _plain(before.get(key)), _plain(after.get(key))
        if old != new and key not in overridden:
            yield Difference(f"profile {name}: {key}", _text(old), _text(new), is_decisive=False)


def _plain(value: Any) -> Any:
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value


def _text(value: Any) -> str:
    return "–" if value is None else str(value)


def _short(value: str) -> str:
    return value[:12] if re.fullmatch(r"[0-9a-f]{40,64}", value) else value

"""Inputs of strangers, mostly wrong, a fifth of them right; and what must hold for every one.

The oracle: exit code 0, 1 or 2; what is refused is one line without a traceback or a sign that a terminal
obeys; no file outside the project; less than a time and an amount of memory. What is right must succeed.
"""

import contextlib
import functools
import io
import json
import math
import os
import re
import resource
import shutil
import signal
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from simulation.errors import InputError
from simulation.foreign_text import has_control
from studies.cli import main
from studies.storage_url import read_storage

ROOT = Path(__file__).resolve().parents[2]
LIMIT_S, LIMIT_MB, LONGEST_LINE = 20.0, 1500.0, 2500
KINDS = ("case", "profile", "recording", "FMU", "record", "URL")
COMMAND = ("run", "wall", "--profile", "own.toml", "--dry-run", "--json", "-q")
SECRET = "hunter2hunter2"

STRANGE: dict[str, list[Any]] = json.loads(Path(__file__).with_name("strange.json").read_bytes())
DIGITS, LONG = "9" * 5000, "x" * 5000
NESTED = ["[" * n + "]" * n for n in (500, 3000)]
texts = st.sampled_from([*STRANGE["texts"], LONG, "((((" * 50, DIGITS[:50]])
values = st.sampled_from([*STRANGE["values"], DIGITS[:400], DIGITS, *NESTED, "[" + "1, " * 3000 + "]"])
cells, numbers = (st.sampled_from([*STRANGE[name], DIGITS]) for name in ("cells", "numbers"))
jsons = st.sampled_from([*STRANGE["json"], LONG, 10**400, float("nan"), float("-inf")])


@dataclass(frozen=True)
class Input:
    """A file or a text, of which kind, and whether it is right."""

    kind: str
    content: bytes
    is_valid: bool


@dataclass
class Outcomes:
    """What became of the inputs: how many ended how, and what must not have happened."""

    counts: Counter[tuple[str, str]] = field(default_factory=Counter)
    violations: list[str] = field(default_factory=list)
    slowest_s: float = 0.0


@functools.cache
def original(kind: str) -> bytes:
    """Return the right input that others are made from."""
    places = {
        "case": ROOT / "fmus" / "wall" / "case.toml",
        "profile": ROOT / "studies" / "profiles" / "smoke.toml",
        "recording": ROOT / "data" / "wall" / "measured.csv",
        "FMU": ROOT / "fmus" / "wall" / "Wall.fmu",
        "record": Path(__file__).with_name("record.json"),
    }
    return places[kind].read_bytes()


@functools.cache
def members() -> dict[str, bytes]:
    """Return what the right FMU holds, without its sources and documentation."""
    with zipfile.ZipFile(io.BytesIO(original("FMU"))) as archive:
        kept = ("modelDescription.xml", "binaries/")
        return {name: archive.read(name) for name in archive.namelist() if name.startswith(kept)}


def packed(description: bytes) -> bytes:
    """Return an FMU with another description."""
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w") as archive:
        for name, content in (members() | {"modelDescription.xml": description}).items():
            archive.writestr(name, content)
    return whole.getvalue()


@st.composite
def mangled(draw: st.DrawFn, content: bytes) -> bytes:
    """Damage bytes: cut, flip, double, or put others in their place."""
    at = draw(st.integers(0, max(len(content) - 1, 0)))
    match draw(st.integers(0, 4)):
        case 0:
            return content[:at]
        case 1:
            return content[:at] + bytes([draw(st.integers(0, 255))]) + content[at + 1 :]
        case 2:
            return content[:at] + content[max(at - draw(st.integers(1, 2000)), 0) :]
        case 3:
            return content[:at] + draw(st.binary(max_size=40)) + content[at:]
        case _:
            return draw(st.binary(max_size=300))


LINES = ["", "[", "[[x]]", "a." * 70 + "a = 1", "sep=;", ",,,", "&x;"]
BOMB = '<!DOCTYPE a [<!ENTITY x "' + "y" * 1000 + '">' + "".join(
    f'<!ENTITY x{i} "{f"&x{i - 1 if i else str()};" * 10}">' for i in range(9)
) + ']>'  # fmt: skip
# Where the values of a file stand, and what takes their place.
TOML = (r"(?<= = ).*", texts.map(json.dumps) | values)
PLACES = {
    "case": TOML,
    "profile": TOML,
    "recording": (r"[^,\n]+", cells),
    "FMU": (
        r'(?<==")[^"]*',
        numbers | texts.map(escape) | st.sampled_from(["input", "output", "local", "&x;"]),
    ),
}


@st.composite
def changed(draw: st.DrawFn, kind: str) -> bytes:
    """Change some values or lines of a file, or its encoding."""
    text = (members()["modelDescription.xml"] if kind == "FMU" else original(kind)).decode()
    pattern, strange = PLACES[kind]
    for _ in range(draw(st.integers(1, 3))):
        lines, places, at = text.split("\n"), [*re.finditer(pattern, text)], draw(st.integers(0, 10**6))
        match draw(st.integers(0, 6)):
            case 0:
                del lines[at % len(lines)]
            case 1:
                lines.insert(at % len(lines), draw(st.sampled_from([*LINES, lines[at % len(lines)]])))
            case _ if places:
                place = places[at % len(places)]
                lines = [text[: place.start()] + draw(strange) + text[place.end() :]]
        text = "\n".join(lines)
    if kind == "FMU":
        return packed(
            text.replace("?>", "?>" + draw(st.sampled_from(["", "", BOMB]))).encode("utf-8", "replace")
        )
    return text.encode(draw(st.sampled_from(["utf-8", "utf-8", "utf-8", "utf-16", "utf-32"])), "replace")


def places(content: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every place in nested dictionaries and lists: what holds it, and its key."""
    for key in content if isinstance(content, dict) else range(len(content)):
        yield content, key
        if isinstance(content[key], dict | list):
            yield from places(content[key])


@st.composite
def record(draw: st.DrawFn) -> bytes:
    """Change some values of a calibration's record."""
    text = original("record").decode()
    for _ in range(draw(st.integers(1, 3))):
        content = json.loads(text)
        holder, key = draw(st.sampled_from([*places(content)] or [([None], 0)]))
        holder[key] = draw(jsons)
        text = json.dumps(content)
    return text.encode()


@st.composite
def url(draw: st.DrawFn) -> bytes:
    """Write a URL or a DSN whose password is SECRET, with signs where none should be."""
    noise = st.text(st.sampled_from("abc:@/?#% &=%zz[]\\'\"\n"), max_size=4)
    form = draw(
        st.sampled_from(
            [
                "{0}postgresql://{user}:{s}{2}@h{3}/d{4}",
                "postgres://u:{s}@h/d?{0}sslmode=x{1}",
                "postgresql://h/d?user=u&password={s}{0}",
                "{0}host=h user=u password={s}{1} dbname=d",
                "host=h password = '{s}{0}'{1}",
                "postgresql://h/d?{0}sslpassword={s}",
                "mysql://u:{s}@h{0}/d{1}",
            ]
        )
    )
    user = "".join(draw(noise).split()) + "u"  # no database has a user with a blank
    return form.format(*(draw(noise) for _ in range(5)), s=SECRET, user=user).encode()


@st.composite
def right(draw: st.DrawFn, kind: str) -> Input:
    """Return an input that must succeed."""
    number = draw(st.integers(100, 10**9))
    if kind == "URL":
        return Input(kind, f"postgresql://user{number}@host:5432/data".encode(), True)
    content = original(kind)
    match kind:
        case "case":
            content = content.replace(b"estimate = 75", b"estimate = 75.%d" % number) + b"\n# caf\xc3\xa9\n"
        case "profile":
            content = content.replace(b"seed = 0", b"seed = %d" % number)
        case "recording":
            content = content.replace(b"0,12.55,", b"0,12.%d," % number, 1)
        case "FMU":
            content = packed(members()["modelDescription.xml"] + b"<!-- %d -->" % number)
        case "record":
            content = json.dumps({**json.loads(content), "more": number}).encode()
    return Input(kind, content, True)


@st.composite
def inputs(draw: st.DrawFn) -> Input:
    """Draw an input; at least a fifth is right."""
    kind = draw(st.sampled_from(KINDS))
    if draw(st.sampled_from(("right", "right", "wrong"))) == "right":
        return draw(right(kind))
    if kind == "URL":
        return Input(kind, draw(url()), False)
    if draw(st.integers(0, 4)) == 0:
        return Input(kind, draw(mangled(original(kind))), False)
    return Input(kind, draw(record() if kind == "record" else changed(kind)), False)


class TooSlowError(BaseException):
    """An input took longer than it may."""


@contextlib.contextmanager
def project() -> Iterator[Path]:
    """Make a project that is right, in a folder in which nothing else may appear, and stand in it."""
    with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
        root, before = Path(name) / "a" / "project", Path.cwd()
        for place in ("fmus/wall", "data/wall"):
            shutil.copytree(ROOT / place, root / place, ignore=shutil.ignore_patterns("generated", "*.md"))
        (root / "studies.toml").write_text("schema = 1\n")
        (root / "mlruns" / "results" / "wall-quick").mkdir(parents=True)
        # Where a record that leads outside would look.
        was = os.environ.get("STUDIES_ROOT")
        os.environ["STUDIES_ROOT"] = str(root)
        os.chdir(root)
        try:
            yield root
        finally:
            os.chdir(before)
            os.environ.pop("STUDIES_ROOT") if was is None else os.environ.__setitem__("STUDIES_ROOT", was)


def put(root: Path, given: Input | None) -> None:
    """Put an input where the project has its own of this kind; None puts the right ones back."""
    places = {
        "case": root / "fmus" / "wall" / "case.toml",
        "profile": root / "own.toml",
        "recording": root / "data" / "wall" / "measured.csv",
        "FMU": root / "fmus" / "wall" / "Wall.fmu",
    }
    results = root / "mlruns" / "results" / "wall-quick"
    for kind, place in places.items():
        place.write_bytes(given.content if given and given.kind == kind else original(kind))
    for file in results.iterdir():
        file.unlink()
    if given and given.kind == "record":
        (results / "calibrate-adaptive.json").write_bytes(given.content)
        arrays = dict.fromkeys(("time", "y", "history_calls", "history_mse"), np.zeros(1))
        np.savez(results / "calibrate-adaptive.npz", **arrays)


def tried(root: Path, given: Input, outcomes: Outcomes) -> None:
    """Give an input to the command that reads it, and note what became of it."""
    if given.kind == "URL":
        _tried_url(given, outcomes)
        return
    put(root, given)
    words = ("status", "--json") if given.kind == "record" else COMMAND
    before = listing(root)
    code, out, err, spent_s = answered(words)
    outcomes.slowest_s = max(outcomes.slowest_s, spent_s)
    lines = err.splitlines()
    wrong = [
        "" if code in (0, 1, 2) else f"exit code {code}",
        "a traceback" if "Traceback" in err else "",
        "not one line" if code and len(lines) != 1 else "",
        "no error line" if code and not err.startswith("studies: error: ") else "",
        "a long line" if any(len(line) > LONGEST_LINE for line in lines) else "",
        "a sign that a terminal obeys" if any(has_control(line) for line in lines) else "",
        "a file outside or beside" if listing(root) != before else "",
        f"{spent_s:.1f} s" if spent_s > LIMIT_S else "",
        "too much memory" if resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3 > LIMIT_MB else "",
        "refused, though it is right" if given.is_valid and code else "",
        "nothing on standard output" if not out.strip() else "",
    ]
    _note(given, f"exit {code}", [one for one in wrong if one], err or out, outcomes)


def _tried_url(given: Input, outcomes: Outcomes) -> None:
    text = given.content.decode()
    try:
        outcome, shown = "exit 0", read_storage(text)
    except InputError as error:
        outcome, shown = "exit 2", str(error)
    wrong = ["a password is shown"] if SECRET in shown else []
    wrong += ["refused, though it is right"] if given.is_valid and outcome != "exit 0" else []
    _note(given, outcome, wrong, shown, outcomes)


def _note(given: Input, outcome: str, wrong: list[str], said: str, outcomes: Outcomes) -> None:
    outcomes.counts[f"{given.kind}{', right' if given.is_valid else ''}", outcome] += 1
    if wrong:
        outcomes.violations.append(f"{given.kind}: {', '.join(wrong)}: {said[-1500:]}")
        if keep := os.environ.get("FUZZ_KEEP"):
            Path(keep).mkdir(exist_ok=True)
            (Path(keep) / f"{len(outcomes.violations):03d}-{given.kind}").write_bytes(given.content)


def answered(words: tuple[str, ...]) -> tuple[int, str, str, float]:
    """Run a command in this process; return exit code, output, errors and the time that it took."""

    def too_slow(*_: object) -> None:
        raise TooSlowError

    out, err = io.StringIO(), io.StringIO()
    handler = signal.signal(signal.SIGALRM, too_slow)
    signal.setitimer(signal.ITIMER_REAL, 2.0 * LIMIT_S)
    began = time.monotonic()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main(words)
    except TooSlowError:
        code = -1
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, handler)
    return code, out.getvalue(), err.getvalue(), time.monotonic() - began


def listing(root: Path) -> list[str]:
    """Return all that lies in and beside the project but what MLflow and Optuna make of nothing."""
    whole = root.parent.parent
    mlruns = root / "mlruns"
    return sorted(
        str(file.relative_to(whole))
        for file in whole.rglob("*")
        if not file.is_relative_to(mlruns) or file.is_relative_to(mlruns / "results")
    )


def fuzz(root: Path, outcomes: Outcomes, n_inputs: int, first_seed: int, until_s: float = math.inf) -> None:
    """Try inputs of a seed, and none after a moment on the monotonic clock [s]."""

    @seed(first_seed)
    @settings(
        max_examples=n_inputs,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(inputs())
    def one(given_: Input) -> None:
        if time.monotonic() < until_s:
            tried(root, given_, outcomes)

    one()

"""Files of strangers, mostly wrong, some right: whatever they hold, a command ends with one line at most.

`FUZZ_INPUTS=5000 FUZZ_SEED=7 pytest tests/fuzz` tries more, and others.
"""

import contextlib
import functools
import io
import json
import os
import re
import time
import zipfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from project_for_tests import REPOSITORY, add_case

from simulation.foreign_text import has_control
from studies.cli import main

N_INPUTS = int(os.environ.get("FUZZ_INPUTS", "80"))
SEED = int(os.environ.get("FUZZ_SEED", "0"))
LIMIT_S, LONGEST_LINE = 20.0, 2500
PLACES = {
    "case": "fmus/wall/case.toml",
    "recording": "data/wall/measured.csv",
    "FMU": "fmus/wall/Wall.fmu",
    "profile": "own.toml",
    "record": "mlruns/results/wall-quick/calibrate-adaptive.json",
}
"""Where a project has its file of a kind."""

STRANGE: dict[str, list[Any]] = json.loads(Path(__file__).with_name("strange.json").read_bytes())
LONG, DIGITS, NESTED = "x" * 5000, "9" * 5000, "[" * 3000 + "]" * 3000
texts = st.sampled_from([*STRANGE["texts"], LONG, "((((" * 50, DIGITS[:50]])
values = st.sampled_from([*STRANGE["values"], DIGITS[:400], DIGITS, NESTED, "[" + "1, " * 3000 + "]"])
cells, numbers = (st.sampled_from([*STRANGE[name], DIGITS]) for name in ("cells", "numbers"))
jsons = st.sampled_from([*STRANGE["json"], LONG, 10**400, float("nan"), float("-inf")])
LINES = ["", "[", "[[x]]", "a." * 70 + "a = 1", "sep=;", ",,,", "&x;"]
BOMB = '<!DOCTYPE a [<!ENTITY x "' + "y" * 1000 + '">' + "".join(
    f'<!ENTITY x{i} "{f"&x{i - 1 if i else str()};" * 10}">' for i in range(9)
) + ']>'  # fmt: skip
# Where the values of a file stand, and what takes their place.
TOML = (r"(?<= = ).*", texts.map(json.dumps) | values)
VALUES = {
    "case": TOML,
    "profile": TOML,
    "recording": (r"[^,\n]+", cells),
    "FMU": (r'(?<==")[^"]*', numbers | texts.map(escape) | st.sampled_from(["input", "output", "&x;"])),
}


@functools.cache
def original(kind: str) -> bytes:
    """Return the right file of a kind, from which others are made."""
    places = {"profile": "studies/profiles/smoke.toml", "record": "tests/fuzz/record.json"}
    return (REPOSITORY / places.get(kind, PLACES[kind])).read_bytes()


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
            # Else it would hold the time of day.
            archive.writestr(zipfile.ZipInfo(name), content)
    return whole.getvalue()


@st.composite
def mangled(draw: st.DrawFn, content: bytes) -> bytes:
    """Damage bytes: cut, flip, double, or put others in their place."""
    at = draw(st.integers(0, max(len(content) - 1, 0)))
    return draw(
        st.sampled_from(
            [
                content[:at],
                content[:at] + bytes([draw(st.integers(0, 255))]) + content[at + 1 :],
                content[:at] + content[max(at - draw(st.integers(1, 2000)), 0) :],
                draw(st.binary(max_size=300)),
            ]
        )
    )


@st.composite
def changed(draw: st.DrawFn, kind: str) -> bytes:
    """Change some values or lines of a file, or its encoding."""
    text = (members()["modelDescription.xml"] if kind == "FMU" else original(kind)).decode()
    pattern, strange = VALUES[kind]
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
        return packed(text.replace("?>", "?>" + draw(st.sampled_from(["", BOMB]))).encode("utf-8", "replace"))
    return text.encode(draw(st.sampled_from(["utf-8", "utf-8", "utf-16", "utf-32"])), "replace")


def places_in(content: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every place in nested dictionaries and lists: what holds it, and its key."""
    for key in content if isinstance(content, dict) else range(len(content)):
        yield content, key
        if isinstance(content[key], dict | list):
            yield from places_in(content[key])


@st.composite
def record(draw: st.DrawFn) -> bytes:
    """Change some values of a calibration's record."""
    content = json.loads(original("record"))
    for _ in range(draw(st.integers(1, 3))):
        holder, key = draw(st.sampled_from([*places_in(content)]))
        holder[key] = draw(jsons)
    return json.dumps(content).encode()


@st.composite
def inputs(draw: st.DrawFn) -> tuple[str, bytes, bool]:
    """Draw a kind of file, its content, and whether that is right: a third is."""
    kind = draw(st.sampled_from([*PLACES]))
    match draw(st.integers(0, 5)):
        case 0 | 1:
            more = {"FMU": b"", "record": b" \n"}.get(kind, b"\n")
            return kind, original(kind) + more * draw(st.integers(0, 3)), True
        case 2:
            return kind, draw(mangled(original(kind))), False
        case _:
            return kind, draw(record() if kind == "record" else changed(kind)), False


def listing(root: Path) -> list[str]:
    """Return all that lies in and beside the project but what MLflow and Optuna make of nothing."""
    found = (str(file.relative_to(root.parent)) for file in root.parent.rglob("*"))
    return sorted(name for name in found if "mlruns/" not in name or "mlruns/results" in name)


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    root = tmp_path / "project"
    add_case(root)
    (root / "studies.toml").write_text("schema = 1\n", encoding="utf-8")
    results = (root / PLACES["record"]).parent
    results.mkdir(parents=True)
    arrays = dict.fromkeys(("time", "y", "history_calls", "history_mse"), np.zeros(1))
    np.savez(results / "calibrate-adaptive.npz", **arrays)
    monkeypatch.setenv("STUDIES_ROOT", str(root))
    monkeypatch.chdir(root)
    return root


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_no_file_of_a_stranger_does_harm(project: Path) -> None:
    tried: Counter[tuple[str, bool]] = Counter()

    @seed(SEED)
    @settings(
        max_examples=N_INPUTS,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(inputs())
    def harmless(drawn: tuple[str, bytes, bool]) -> None:
        kind, content, is_right = drawn
        tried[kind, is_right] += 1
        for other, place in PLACES.items():
            (project / place).write_bytes(content if other == kind else original(other))
        command = ("status",) if kind == "record" else ("run", "wall", "--profile", "own.toml", "--dry-run")
        out, err, before, began = io.StringIO(), io.StringIO(), listing(project), time.monotonic()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main([*command, "--json"])
        assert time.monotonic() - began < LIMIT_S
        assert listing(project) == before
        assert code in ((0,) if is_right else (0, 1, 2)), err.getvalue()
        assert out.getvalue().strip()
        # What it does before it fails is no error.
        lines = [one for one in err.getvalue().splitlines() if not one.startswith("timing a simulation")]
        assert not code or [line[:16] for line in lines] == ["studies: error: "]
        assert not [line for line in lines if len(line) > LONGEST_LINE or has_control(line)]

    harmless()
    assert {kind for kind, _ in tried} == {*PLACES}
    assert sum(tried.values()) > N_INPUTS / 2


def drawn(number: int) -> list[tuple[str, bytes, bool]]:
    """Return the inputs that a seed draws."""
    found = []

    @seed(number)
    @settings(max_examples=12, database=None, phases=[Phase.generate])
    @given(inputs())
    def keep(one: tuple[str, bytes, bool]) -> None:
        found.append(one)

    keep()
    return found


def test_a_seed_draws_the_same_inputs_and_another_seed_others() -> None:
    """Else many runs would try what one has tried."""
    first = drawn(1)
    assert first == drawn(1)
    assert len([one for one in drawn(2) if one not in first and not one[2]]) > len(first) / 4


def test_what_a_command_leaves_is_seen(project: Path) -> None:
    (project / PLACES["record"]).write_bytes(original("record"))
    before = listing(project)
    (project.parent / "left").touch()
    assert listing(project) != before

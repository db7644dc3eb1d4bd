"""README, pages and help: their size, words and links, and whether what they show exists and runs."""

import argparse
import contextlib
import io
import math
import re
import shlex
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from project_for_tests import add_case, make_project

from simulation.case_file import CaseFile, InputTable, OutputTable, SimulationTable
from simulation.recording import read_recording
from studies.cli import COMMANDS, DESCRIPTION, EPILOG, build_parser, help_of

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
OTHERS = (
    "data/benchmarks/README.md",
    "mlruns/README.md",
    "SECURITY.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "DECISIONS.md",
)
DOCS = ROOT / "docs"
PAGES = [README, *sorted(DOCS.rglob("*.md")), *(ROOT / name for name in OTHERS)]
ROOMS = ("simulation", "pelsvae", "studies", "fmus", "data", "tests")
MAX_LINES, MAX_WORDS, MAX_SENTENCE = 120, 1000, 30
SHORTER = dict.fromkeys(("README.md", "docs/questions.md", "docs/glossary.md"), 25)
"""Words of a sentence on the pages that strangers read first."""
BANNED = re.compile(
    r"\b(nursery|arena|spool|campaign|row desk|hire[sd]?|fire[sd]?|bury|buries|buried|heart|hearts"
    r"|claim(s|ed)?|ghosts?|twins?|crown(s|ed)?|champion folder|keeping|looking|cards?|things?|known rows"
    r"|guides?|laws?|telling row|elsewhere|legs?|dull|doubt|horizon|stand-in|restriction|freeing|tells?|told"
    r"|hears?|heard|heed(s|ed)?|recipes?|somebody|nobody)\b",
    re.IGNORECASE,
)
CHECKED = """
assert found.converged and found.mse < 0.002
assert y.shape == (1, *found.y.shape)
assert (abs(y[0] - found.y).mean(axis=0) < 0.5 * rows.y.std(axis=(0, 1))).all()
"""


def read(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def without_code(text: str) -> str:
    return re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)


def code_blocks(text: str, kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)


def paragraphs_of_markdown(text: str) -> Iterator[str]:
    """Give paragraphs, items of lists and cells of tables, without markup."""
    text = re.sub(r"<!--.*?-->", "", without_code(text))
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*>|#]|\d+\.) ?)", text):
        if block.lstrip().startswith("|"):
            yield from block.strip().strip("|").split("|")
        else:
            yield " ".join(block.split())


def paragraphs_of_help(text: str) -> Iterator[str]:
    """Give paragraphs without lists and examples, which are indented."""
    yield from (
        " ".join(block.split()) for block in re.split(r"\n\s*\n|\n(?=\s)|(?<=:)\n", text) if block.strip()
    )


def helps() -> dict[str, list[str]]:
    """Return the texts of the help by command: paragraphs, then a line per option."""
    found = {"studies": [*paragraphs_of_help(DESCRIPTION), *paragraphs_of_help(EPILOG)]}
    (commands,) = (
        action for action in build_parser()._actions if isinstance(action, argparse._SubParsersAction)
    )
    for name in COMMANDS:
        summary, more = help_of(name)
        options = [str(action.help) for action in commands.choices[name]._actions]
        found[name] = [summary, *paragraphs_of_help(more), *options]
    return found


def sentences(paragraph: str) -> list[str]:
    return re.split(r"(?<=[.!?])[\"')*]*\s+(?=[\"'`*(A-Z0-9$-])", paragraph)


TEXTS = {str(page.relative_to(ROOT)): list(paragraphs_of_markdown(read(page))) for page in PAGES}
TEXTS |= {f"help of {name}": texts for name, texts in helps().items()}


def test_the_readme_is_one_page() -> None:
    text = read(README)
    assert len(text.splitlines()) <= MAX_LINES
    assert len(without_code(text).split()) <= MAX_WORDS


@pytest.mark.parametrize("name", TEXTS)
def test_sentences_are_short_and_words_are_those_of_the_field(name: str) -> None:
    every = [one for paragraph in TEXTS[name] for one in sentences(paragraph)]
    assert every
    assert not [one for one in every if len(one.split()) > SHORTER.get(name, MAX_SENTENCE)]
    assert not [paragraph for paragraph in TEXTS[name] if BANNED.search(paragraph)]


@pytest.mark.parametrize("room", ROOMS)
def test_words_of_the_code_are_those_of_the_field(room: str) -> None:
    """In names, messages, docstrings and comments; `study.tell` is Optuna's own name."""
    found = []
    for file in sorted({*(ROOT / room).rglob("*.py")} - {Path(__file__)}):
        for number, line in enumerate(read(file).replace(".tell(", "(").splitlines(), start=1):
            if BANNED.search(re.sub(r"(?<=[a-z])(?=[A-Z])|_", " ", line)):
                found.append(f"{file}:{number}: {line.strip()}")
    assert not found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files_and_headings(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", without_code(read(page))):
        if target.startswith("https://"):
            continue
        place, _, heading = target.partition("#")
        file = (page.parent / place).resolve() if place else page
        assert file.exists(), target
        headings = re.findall(r"^#+ (.*)$", read(file), flags=re.MULTILINE) if heading else []
        anchors = [re.sub(r"[^\w -]", "", one).lower().replace(" ", "-") for one in headings]
        assert not heading or heading in anchors, target


def test_every_page_is_listed() -> None:
    index = read(DOCS / "index.md")
    pages = {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")} - {"index.md"}
    assert not [name for name in pages if f"({name})" not in index]


def test_decisions_are_a_map() -> None:
    records = re.split(r"^### ", read(ROOT / "DECISIONS.md"), flags=re.MULTILINE)[1:]
    assert [int(record.partition(".")[0]) for record in records] == [*range(1, len(records) + 1)]
    assert len(records) <= 25
    for record in records:
        lines = record.partition("\n## ")[0].strip().splitlines()
        assert len(lines) <= 12, lines[0]
        assert max(map(len, lines)) <= 140, lines[0]
        assert re.search(r"^Status: (accepted|superseded by \d+)\.", record, flags=re.MULTILINE), lines[0]
        parts = re.findall(r"^- \*\*(\w+)\.\*\*", record, flags=re.MULTILINE)
        assert parts == ["Context", "Decision", "Consequence"], lines[0]
        assert "](docs/notes/" in record, lines[0]


def commands_shown() -> list[str]:
    """Return the lines of the code blocks that call the command line."""
    blocks = [block for page in PAGES for kind in ("sh", "text") for block in code_blocks(read(page), kind)]
    lines = [part.strip() for block in blocks for line in block.splitlines() for part in line.split("&&")]
    return sorted({line for line in lines if re.match(r"(\.venv/bin/)?studies ", line)})


@pytest.mark.parametrize("line", commands_shown())
def test_a_shown_command_exists(line: str) -> None:
    words = shlex.split(line, comments=True)[1:]
    complaints = io.StringIO()
    with contextlib.redirect_stderr(complaints):
        chosen = build_parser().parse_args(words)
    assert chosen.command == words[0]


def test_places_named_in_contributing_exist() -> None:
    rooms = "simulation|pelsvae|studies|fmus|tests|data|docs"
    named = re.findall(rf"`((?:{rooms})/[\w./-]+)`", read(ROOT / "CONTRIBUTING.md"))
    assert named
    assert not [name for name in named if not (ROOT / name).exists()]


def test_the_ranges_in_the_readme_are_those_of_the_quick_profile() -> None:
    from studies.profile import load_profile

    quick, text = load_profile("quick"), read(README)
    for name, searched in quick.tuning.space.items():
        if searched.when:
            assert f"`{name}`" in text
            continue
        found = re.search(rf"^\| `{name}`[^|]*\| (.*?) \|", text, re.M)
        assert found, name
        if searched.kind == "categorical":
            assert re.findall(r"`(.*?)`", found[1]) == list(searched.choices)
        else:
            assert found[1] == f"{searched.low:g} to {searched.high:g}" + ", logarithmic" * searched.log
    assert f"| {quick.tuning.n_trials} per size, `{quick.tuning.sampler['name']}`" in text
    assert ", ".join(map(str, quick.data.n_train)) in text


def test_the_profile_in_the_pages_is_one(tmp_path: Path) -> None:
    from studies.profile import load_profile

    (search, fixed, choices) = code_blocks(read(DOCS / "how-to" / "search-space.md"), "toml")
    file = tmp_path / "my.toml"
    text = f'name = "my"\n[data]\nn_train = [32]\n[tuning]\nn_trials = 20\n{choices}{search}{fixed}'
    file.write_text(text, encoding="utf-8")
    profile = load_profile(str(file))
    assert [name for name, one in profile.tuning.space.items() if one.when]
    assert profile.tuning.fixed
    assert not set(profile.tuning.fixed) & set(profile.tuning.space)

    from studies.tuning.sampler import make_pruner, make_sampler

    assert type(make_sampler(profile.tuning.sampler, 0)).__name__ == profile.tuning.sampler["name"]
    assert type(make_pruner(profile.tuning.pruner)).__name__ == profile.tuning.pruner["name"]


@pytest.mark.parametrize("name", ["data", "failing-fmu"])
def test_the_lines_of_case_files_in_the_pages_are_valid(name: str) -> None:
    tables = {"inputs": InputTable, "outputs": OutputTable, "simulation": SimulationTable}
    blocks = [tomllib.loads(block) for block in code_blocks(read(DOCS / "how-to" / f"{name}.md"), "toml")]
    assert blocks
    for key, value in (item for block in blocks for item in block.items()):
        assert key in CaseFile.model_fields
        for table in value if isinstance(value, list) else [value]:
            assert key not in tables or tables[key].model_validate(table)


def test_the_german_csv_file_in_the_pages_is_read(tmp_path: Path) -> None:
    (content,) = code_blocks(read(DOCS / "how-to" / "data.md"), "text")
    file = tmp_path / "measured.csv"
    file.write_bytes(content.encode("cp1252"))
    recording = read_recording(file, ["Raum", "Wärme"], time_column="Zeit", timezone="Europe/Berlin")
    assert recording.columns["Raum"].tolist() == [20.5, 20.6]
    assert recording.step_s == 1800.0
    assert math.isnan(recording.columns["Wärme"][1])


def test_the_examples_in_python_calibrate_and_predict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    objects, parts = code_blocks(read(ROOT / "docs" / "own-fmu.md"), "python")
    monkeypatch.chdir(make_project(tmp_path / "project"))
    add_case(tmp_path / "project")
    exec(objects, {})
    shown = capsys.readouterr().out
    assert re.search(r"^G12 .* W/K ", shown, re.MULTILINE)
    assert " True 0." in shown
    exec(f"{parts}{CHECKED}", {})
    assert re.fullmatch(r"\d simulations, MSE 0\.0019\d: \{.*\}\n", capsys.readouterr().out)

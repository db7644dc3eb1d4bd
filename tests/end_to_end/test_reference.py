"""The reference is what the code says, and the site builds without a warning."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def reference() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_reference", ROOT / "docs" / "make_reference.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_reference_is_what_the_code_says(reference: ModuleType) -> None:
    old = [
        name
        for name, text in reference.pages().items()
        if (reference.FOLDER / name).read_text("utf-8") != text
    ]
    assert not old, "write the pages again: python docs/make_reference.py"


def test_every_key_of_the_shipped_case_is_in_the_reference(reference: ModuleType) -> None:
    """An independent list of keys: the case file that the wall really has."""
    import tomllib

    case = tomllib.loads((ROOT / "fmus" / "wall" / "case.toml").read_text("utf-8"))
    page = reference.pages()["case-file.md"]
    tables = [case, case["time"], *case["inputs"], *case["outputs"], *case["parameters"]]
    assert not [key for table in tables for key in table if f"| `{key}` |" not in page]


@pytest.mark.skipif(importlib.util.find_spec("mkdocs") is None, reason="mkdocs is not installed (extra docs)")
def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    (program,) = tmp_path.glob("site/assets/javascripts/workers/search.*.min.js")
    assert program.read_text("utf-8").startswith((ROOT / "docs" / "search_words.js").read_text("utf-8"))
    index = json.loads((tmp_path / "site" / "search" / "search_index.json").read_text("utf-8"))
    sections = {entry["location"]: entry for entry in index["docs"]}
    assert "freeze" in sections["questions.html#my-fmu-crashes-hangs-or-returns-nan"]["words"]
    assert "meaningofaword" in sections["glossary.html#trial"]["words"]
    # The benchmark of the search names sections that exist.
    asked = json.loads((ROOT / "data" / "benchmarks" / "site_search.json").read_text("utf-8"))
    assert not {answer.removesuffix("*") for one in asked for answer in one["answers"]} - sections.keys()

"""The notebook of the pages runs in a kernel and shows what is stored in it."""

import importlib.util
import json
import re
from pathlib import Path
from typing import Any

import pytest
from mlflow_store_for_tests import give_store

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
NOTEBOOK = ROOT / "docs" / "tutorials" / "office-in-python.ipynb"
NUMBER = re.compile(r"\d+(?:\.\d+)?")
PROCESSORS_DIFFER = 0.6
"""A training ends in another local minimum on another kind of processor, and the polish begins from there."""


def shown(cells: list[dict[str, Any]]) -> str:
    """Return all that cells print or return as text."""
    outputs = [output for cell in cells for output in cell.get("outputs", ())]
    texts = [output["text"] for output in outputs if output.get("name") == "stdout"]
    texts += [output["data"]["text/plain"] for output in outputs if "data" in output]
    return "\n".join(text if isinstance(text, str) else "".join(text) for text in texts)


def test_links_of_the_notebook_lead_to_files() -> None:
    cells = json.loads(NOTEBOOK.read_text("utf-8"))["cells"]
    text = "".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    targets = re.findall(r"\]\(([^)#]+)", text)
    assert targets
    assert not [target for target in targets if not (NOTEBOOK.parent / target).exists()]


@pytest.mark.skipif(
    not all(map(importlib.util.find_spec, ("nbclient", "ipykernel"))),
    reason="nbclient or ipykernel is not installed (extra test)",
)
@pytest.mark.filterwarnings("ignore:.*TCP without encryption", "ignore::DeprecationWarning")
def test_the_notebook_shows_what_is_stored_in_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import nbformat
    from nbclient import NotebookClient

    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    give_store(tmp_path)
    (tmp_path / "studies.toml").write_text("schema = 1\n", encoding="utf-8")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    stored = shown(notebook.cells)
    NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    found = shown(list(notebook.cells))
    found, stored = (re.sub(r"<(IPython|Figure)[^>]*>\n?", "", text) for text in (found, stored))
    assert NUMBER.sub("#", " ".join(found.split())) == NUMBER.sub("#", " ".join(stored.split()))
    assert [*map(float, NUMBER.findall(found))] == pytest.approx(
        [*map(float, NUMBER.findall(stored))], rel=PROCESSORS_DIFFER
    )

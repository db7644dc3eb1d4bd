"""MkDocs hook: linked files of the repository outside `docs/`, notebooks and equations join the site.

README, DECISIONS, the benchmarks and their pictures stay where they are. Each gets the address
`repository/<its path>`, and each link to it leads there. A notebook is a page with its stored outputs.
matplotlib draws the equations, so that a page asks no server for fonts or programs.
"""

import io
import json
import os.path
import re
from html import escape
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import math_to_image
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
_LINK = re.compile(r"\[([^\]]*)\]\((?!\w+:|#)([^)\s#]+)(#[^)\s]*)?\)")
_EQUATION = re.compile(r"^```math\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_UNSEARCHED = ("CHANGELOG.md", "DECISIONS.md", "notes/", "publish.md")
"""Histories and maintenance: a search would find them before the page that answers."""


def on_files(files: Files, config: Any) -> None:
    """Add notebooks as pages, the README, what pages link to, and what is linked from there."""
    for notebook in sorted(DOCS.rglob("*.ipynb")):
        files.append(File.generated(config, _address(notebook), content=_markdown(notebook)))
    waiting = [DOCS / page.src_uri for page in files.documentation_pages() if page.abs_src_path]
    waiting.append(readme := ROOT / "README.md")
    files.append(File.generated(config, _address(readme), abs_src_path=str(readme)))
    seen = {readme}
    while waiting:
        page = waiting.pop()
        for _, target, _ in _LINK.findall(page.read_text(encoding="utf-8")):
            file = _file(page, target)
            if file is None or file in seen or file.is_relative_to(DOCS):
                continue
            seen.add(file)
            files.append(File.generated(config, _address(file), abs_src_path=str(file)))
            waiting += [file] * (file.suffix == ".md")


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Let each link lead to the place that its file has in the site."""
    source = Path(page.file.abs_src_path or DOCS / page.file.src_uri)
    here = os.path.dirname(page.file.src_uri)  # noqa: PTH120
    if page.file.src_uri.removeprefix("repository/").startswith(_UNSEARCHED):
        page.meta["search"] = {"exclude": True}

    def moved(link: re.Match[str]) -> str:
        words, target, heading = link.groups(default="")
        file = _file(source, target)
        if file is not None:
            return f"[{words}]({os.path.relpath(_address(file), here or '.')}{heading})"
        return words if (source.parent / target).is_dir() else link[0]  # a folder without a page

    return _EQUATION.sub(_drawn, _LINK.sub(moved, markdown))


def _drawn(equation: re.Match[str]) -> str:
    """Return an equation as an image in the colour of the text around it."""
    svg, source = io.StringIO(), " ".join(equation[1].split())
    with matplotlib.rc_context({"mathtext.fontset": "stix", "svg.hashsalt": "equation"}):
        math_to_image(f"${source}$", svg, prop=FontProperties(size=14), format="svg", color="#123456")
    image = svg.getvalue()[svg.getvalue().index("<svg") :].replace("#123456", "currentColor")
    image = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", image, flags=re.DOTALL)
    image = "".join(line.strip() + " " for line in image.splitlines())
    label = f'role="img" aria-label="{escape(source)}" style="max-width: 100%; font-size: 1em"'
    return f"<p>{image.replace('<svg', f'<svg {label}', 1)}</p>"


def _file(page: Path, target: str) -> Path | None:
    """Return the file of the repository that a link means; a folder is its README."""
    file = (page.parent / target).resolve()
    file = file / "README.md" if file.is_dir() else file
    return file if file.is_file() and file.is_relative_to(ROOT) else None


def _address(file: Path) -> str:
    if file.is_relative_to(DOCS):
        return file.relative_to(DOCS).as_posix().replace(".ipynb", ".md")
    return f"repository/{file.relative_to(ROOT).as_posix()}"


def _markdown(notebook: Path) -> str:
    """Return the cells of a notebook and what they showed when it was stored, as a page."""
    parts = [f'<a href="{notebook.name}" download>Download this notebook</a>']
    for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```python\n{source}\n```")
        for output in cell["outputs"]:
            shown = output.get("data", {"text/plain": output.get("text", "")})
            if "image/png" in shown:
                image = "".join(shown["image/png"]).strip()
                parts.append(f'<img alt="What the cell above draws" src="data:image/png;base64,{image}">')
            elif "text/html" in shown:
                table = "".join(shown["text/html"]).replace(' border="1" class="dataframe"', "")
                parts.append(f'<div style="overflow-x: auto">{table}</div>')
            else:
                parts.append(f"```text\n{''.join(shown['text/plain'])}\n```")
    title, *others = parts[1].split("\n", 1)
    return "\n\n".join([title, parts[0], *others, *parts[2:]])

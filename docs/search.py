"""MkDocs hook: the site's search finds pages by the words that people type.

Three changes to what the theme makes: questions are reduced to their words before they are looked up
(`search_words.js`), a page's first lines count no more than its sections, and each section is also found by
other words for what it says. Titles weigh less than usual (`mkdocs.yml`).
"""

import json
import re
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.plugins import event_priority

QUESTIONS = Path(__file__).with_name("search_words.js")
PAGE = 0.4
"""Weight of a page's first lines. The theme multiplies their score by up to 5, that of a section by 2."""
WEIGHTS = {
    "questions.": 1.5,
    **dict.fromkeys(("reference/", "repository/", "index.", "paper."), 0.4),
}
"""Of pages whose address begins so. Some name everything, and the answer is mostly on another page."""
GLOSSARY, MEANING = "glossary.html", "meaningofaword"
OTHER_WORDS = 3.0
"""Weight of words that mean the same; that of the text is 1."""
SAME = (
    "stop interrupt cancel abort pause quit",
    "resume continue restart",
    "crash hang freeze stuck segfault nan diverge",
    "delete remove erase clean reset uninstall",
    "computer machine laptop pc workstation",
    "cluster hpc slurm dask queue",
    "interval confidence credible",
    "gap missing nan empty",
    "timezone clock daylight dst summertime",
    "export write save",
    "simulator tool dymola openmodelica simulink modelica",
    "bound limit range",
    "repeat reproduce reproducible deterministic identical",
    "expensive slow hours minutes",
    "optimizer optimiser minimizer algorithm",
    "surrogate emulator metamodel",
    "picture plot figure chart graph diagram",
    "csv excel spreadsheet workbook xlsx",
    "disk storage gigabytes",
    "tunnel remote ssh",
    "telemetry privacy confidential upload",
    "licence license",
    "gpu cuda graphics card",
    "begin start quickstart",
    "experiment recording dataset",
    "outlier spike",
    "poor bad wrong",
    "macos mac osx apple",
    "watch monitor observe live",
    "weigh weight balance",
    "predict forecast extrapolate",
    "better best compare",
    "notebook jupyter",
    "colleague team",
    "postgresql postgres database",
)
"""Words that people use for the same: a section that has one is also found by the others."""
GROUPS = [frozenset(group.split()) for group in SAME]


@event_priority(-100)
def on_post_build(config: Any) -> None:
    """Change the index and the program of the search after the theme has written them."""
    site = Path(config["site_dir"])
    programs = list(site.glob("assets/javascripts/workers/search.*.min.js"))
    if len(programs) != 1:
        raise PluginError(f"the theme has {len(programs)} search programs; docs/search.py knows one")
    programs[0].write_text(QUESTIONS.read_text("utf-8") + programs[0].read_text("utf-8"), "utf-8")
    file = site / "search" / "search_index.json"
    index = json.loads(file.read_text("utf-8"))
    index["config"]["fields"]["words"] = {"boost": OTHER_WORDS}
    for entry in index["docs"]:
        page, _, section = entry["location"].partition("#")
        weight = next((one for begin, one in WEIGHTS.items() if page.startswith(begin)), 1.0)
        entry["boost"] = weight * (1.0 if section else PAGE) * entry.get("boost", 1.0)
        words = other_words(f"{entry['title']} {entry['text']}")
        # `search_words.js` asks for this word where one wants to know what a word means.
        entry["words"] = " ".join([*words, *[MEANING] * (page == GLOSSARY and bool(section))])
    file.write_text(json.dumps(index, ensure_ascii=False, separators=(",", ":")), "utf-8")


def other_words(text: str) -> list[str]:
    """Return words of the same meaning that a text does not have itself."""
    has = {one.removesuffix("s") for one in re.findall(r"\w+", re.sub(r"<[^>]*>", " ", text).lower())}
    found = (group - has for group in GROUPS if group & has)
    return sorted({word for words in found for word in words})

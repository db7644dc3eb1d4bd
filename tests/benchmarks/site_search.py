"""What the site's search finds first: `python tests/benchmarks/site_search.py [--site FOLDER] [--tried]`.

Types the questions of `data/benchmarks/site_search.json` into the search of the built site in Chromium;
without --site it builds the site. Prints a table: question, first hit, and whether that section answers it.
Questions marked as held out were not looked at while the search was changed (docs/notes/program.md).
Needs the extra `docs`, playwright and Chromium.
"""

import argparse
import functools
import json
import shutil
import subprocess
import sys
import tempfile
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, urlsplit

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROOT = Path(__file__).resolve().parents[2]
QUESTIONS = ROOT / "data" / "benchmarks" / "site_search.json"
LIMIT_MS = 6000
# The theme shows hits of one page together; of these the one with the largest score was found first.
FIRST = """entry => {
  const links = [...entry.querySelectorAll("a")];
  const score = link => Number(link.querySelector("article").dataset.mdScore);
  return links.reduce((best, link) => score(link) > score(best) ? link : best).href;
}"""


class _Silent(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the name of the base class
        """Write no line per file."""


def is_answer(address: str, answers: list[str]) -> bool:
    """Say whether an address is one of the answers; of an answer that ends with * every section counts."""
    page = address.partition("#")[0]
    return any(page == one.removesuffix("*") if one.endswith("*") else address == one for one in answers)


def first_hit(browser: "Browser", site: str, typed: str) -> str:
    """Return the address that the search shows first, "" if it shows none."""
    from playwright.sync_api import TimeoutError as NothingFound

    page = browser.new_page()
    try:
        page.goto(f"{site}/index.html?q={quote(typed)}")
        entry = page.wait_for_selector(".md-search-result__item", timeout=LIMIT_MS)
        address = urlsplit(entry.evaluate(FIRST)) if entry else urlsplit("")
    except NothingFound:
        return ""
    finally:
        page.close()
    return address.path.lstrip("/") + (f"#{address.fragment}" if address.fragment else "")


def main() -> int:
    """Ask and print."""
    from playwright.sync_api import sync_playwright

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--site", type=Path, help="a built site; default: build it")
    parser.add_argument("--tried", action="store_true", help="leave out the questions that are held out")
    options = parser.parse_args()
    asked = json.loads(QUESTIONS.read_text("utf-8"))
    asked = [one for one in asked if not (options.tried and one["held_out"])]
    with tempfile.TemporaryDirectory() as folder:
        site = options.site or Path(folder) / "site"
        if options.site is None:
            command = [sys.executable, "-m", "mkdocs", "build", "-q", "--site-dir", str(site)]
            subprocess.run(command, cwd=ROOT, check=True)
        entries = json.loads((site / "search" / "search_index.json").read_text("utf-8"))["docs"]
        there = {entry["location"] for entry in entries}
        gone = {answer for one in asked for answer in one["answers"]} - there
        gone = {answer for answer in gone if answer.removesuffix("*") not in there}
        print("".join(f"no section has the address {answer}\n" for answer in sorted(gone)), end="")
        handler = functools.partial(_Silent, directory=str(site))
        with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server, sync_playwright() as driver:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            browser = driver.chromium.launch(
                executable_path=shutil.which("chromium") or shutil.which("google-chrome"),
                args=["--no-sandbox"],
            )
            address = f"http://127.0.0.1:{server.server_port}"
            hits = [first_hit(browser, address, one["typed"]) for one in asked]
            browser.close()
            server.shutdown()
    right = [is_answer(hit, one["answers"]) for one, hit in zip(asked, hits, strict=True)]
    print("| typed | first hit | answers |\n|---|---|---|")
    for one, hit, is_right in zip(asked, hits, right, strict=True):
        held = " (held out)" * one["held_out"]
        print(f"| {one['typed']}{held} | {hit or 'nothing'} | {'yes' if is_right else 'no'} |")
    for name, is_of in (("tried", False), ("held out", True)):
        of = [yes for one, yes in zip(asked, right, strict=True) if one["held_out"] == is_of]
        print(f"\n{name}: {sum(of)} of {len(of)} are answered by the first hit", end="")
    print()
    return 0


if __name__ == "__main__":
    sys.exit(main())

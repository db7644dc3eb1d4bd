"""Where results of an earlier run come from, for tests of what is drawn from them."""

import io
import json
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

from studies.cli import main
from studies.paper.items import Origin

REPOSITORY = Path(__file__).resolve().parents[2]
COMMITTED = REPOSITORY / "data" / "paper-results"
ORIGIN = Origin(
    command="studies reproduce-paper office-recorded --budget full --only fig6",
    case="office-recorded",
    case_sha256="0" * 64,
    label="office-recorded-thorough",
    note="",
    budget="full",
    profile="thorough",
    seed=0,
    window_d=(8.0, 16.0),
    unit="K",
    n_validation=320,
    n_test=320,
    versions={},
)


def reproduce_paper(*words: str) -> tuple[int, dict[str, Any]]:
    """Run `studies reproduce-paper`; return exit code and document."""
    said = io.StringIO()
    with redirect_stdout(said):
        code = main(["reproduce-paper", *words, "--json", "--quiet"])
    return code, json.loads(said.getvalue())

"""Cases around the FMUs that misbehave: written by `studies new`, measured by their closed form."""

import re
import sys
from pathlib import Path

import numpy as np

from studies.cli import main

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "fmus" / "bad"))

from bad_fmus import SOMETIMES, build_bad_fmu, closed_form, counted

__all__ = ["counted", "make_bad_case"]
TRUE_K, TRUE_X0, STEP_S, TIMEOUT_S = 2e-4, 305.0, 3600.0, 1.0


def make_bad_case(project: Path, behaviour: str) -> Path:
    """Make a case of an FMU that misbehaves where `trouble` is at its upper bound, or always.

    Returns:
        The case file.
    """
    fmu = build_bad_fmu(behaviour, project)
    always = behaviour not in (*SOMETIMES, "GOOD")
    names = ["k", "x0"] if always else ["k", "x0", "trouble"]
    folder = project / "fmus" / "bad"
    assert main(["new", str(fmu), "--to", str(folder), "--parameter", *names, "-q"]) == 0
    file = folder / "case.toml"
    text = file.read_text(encoding="utf-8").replace("# timeout_s = 60", f"timeout_s = {TIMEOUT_S:g}")
    if not always:
        before, after = text.split('name = "trouble"')
        for key, value in (("estimate", 0.1), ("lower", 0), ("upper", 1)):
            after = re.sub(rf"^{key} = .*$", f"{key} = {value}", after, count=1, flags=re.MULTILINE)
        text = f'{before}name = "trouble"{after}'
    file.write_text(text, encoding="utf-8")
    time = np.arange(11) * STEP_S
    y = closed_form(np.array([[TRUE_K, TRUE_X0, 0.0]]), time)[0]
    rows = [f"{at:g},{value:.6f}" for at, value in zip(time, y, strict=True)]
    (project / "data" / "bad" / "measured.csv").write_text("\n".join(["time_s,y", *rows]) + "\n")
    return file

"""Example CSV files and the README of a new case's recordings: the right columns, never typed."""

from simulation.fmi.variable import FmuVariable
from studies.new.text import INPUTS_FILE, MEASURED_FILE, NewCase

N_EXAMPLE_ROWS = 3


def example_files(case: NewCase) -> dict[str, str]:
    """Return the example CSV files by name."""
    step = case.times.output_step_s
    files = {_example(MEASURED_FILE): _csv(case.outputs.used, step)}
    if case.inputs:
        files[_example(INPUTS_FILE)] = _csv(case.inputs, step)
    return files


def data_readme(case: NewCase) -> str:
    """Return the README of the recordings' folder."""
    tables = [(MEASURED_FILE, case.outputs.used, "measured")]
    if case.inputs:
        tables.insert(0, (INPUTS_FILE, case.inputs, "input"))
    rows = []
    for file, variables, what in tables:
        rows.append(f"| `{file}` | `time_s` | time, rising, since any moment | s |")
        rows += [
            f"| | `{v.name}` | {_cell(v.description) or what} | {_cell(v.unit) or '?'} |" for v in variables
        ]
    examples = ", ".join(f"`{name}`" for name in example_files(case))
    return f"""\
# Recordings for {case.name}

Put these here, as CSV with a header line, commas between the columns and points in the numbers:

| file | column | meaning | unit |
|---|---|---|---|
{chr(10).join(rows)}

{examples} show the form; copy, fill and rename. All files count time from the same moment. Other names of
files and columns are fine: change `file` and `column` in the case file. Temperatures may be in K or degC:
change `unit` there.

`studies check {case.place}` says what is still missing.
"""


def _example(file: str) -> str:
    return file.replace(".csv", ".example.csv")


def _csv(variables: tuple[FmuVariable, ...], step_s: float) -> str:
    values = [_start(v) for v in variables]
    lines = [",".join(["time_s", *(_quoted(v.name) for v in variables)])]
    lines += [",".join(f"{value:.10g}" for value in (i * step_s, *values)) for i in range(N_EXAMPLE_ROWS)]
    return "\n".join(lines) + "\n"


def _start(variable: FmuVariable) -> float:
    """Return a value that the variable can have."""
    if variable.start is not None:
        return variable.start
    if variable.kind == "Boolean":
        return float(variable.start_text.strip().lower() == "true")
    return float(next(iter(variable.items.values()), 0))


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if set(name) & set(',"') else name


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")

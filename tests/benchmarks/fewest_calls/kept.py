"""What is kept of the benchmark: problems and runs in one JSON file, rewritten after every run."""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from fewest_calls.counted import Run

SCHEMA = 1


@dataclass(frozen=True)
class KeptProblem:
    """A problem in the file.

    Attributes:
        name: As in the table.
        family: Its panel.
        unit: Of the error.
        best: Best error known. [unit]
        how: Where that comes from.
    """

    name: str
    family: str
    unit: str
    best: float
    how: str


class Kept:
    """Problems and runs, on disk at once."""

    def __init__(self, path: Path | None) -> None:
        """Read what is there.

        Args:
            path: The file; None to keep nothing.
        """
        self._path = path
        self.problems: dict[str, KeptProblem] = {}
        self._runs: dict[str, dict[str, dict[str, Run]]] = {}
        if path is not None and path.is_file():
            self.take(path)

    def take(self, path: Path) -> None:
        """Take in what another file holds; of two runs with one seed the longer one counts."""
        document = json.loads(path.read_text(encoding="utf-8"))
        if document.get("schema") != SCHEMA:
            raise SystemExit(f"{path}: not of schema {SCHEMA}; measure again into another file")
        for name, entry in document["problems"].items():
            theirs = KeptProblem(name=name, **entry)
            ours = self.problems.get(name)
            if ours is None or theirs.best < ours.best:
                self.problems[name] = theirs
        for name, methods in document["runs"].items():
            for method, seeds in methods.items():
                mine = self._runs.setdefault(name, {}).setdefault(method, {})
                for seed, entry in seeds.items():
                    run = Run(**entry)
                    if seed not in mine or run.n_calls >= mine[seed].n_calls:
                        mine[seed] = run

    def put_problem(self, problem: KeptProblem) -> None:
        """Keep a problem."""
        self.problems[problem.name] = problem
        self._write()

    def put(self, problem: str, method: str, seed: int, run: Run) -> None:
        """Keep a run; one that went below the best error known moves that."""
        self._runs.setdefault(problem, {}).setdefault(method, {})[str(seed)] = run
        known = self.problems[problem]
        if run.mse and run.mse[-1] < known.best:
            how = f"{method}, seed {seed}, {run.calls[-1]} calls"
            self.problems[problem] = KeptProblem(known.name, known.family, known.unit, run.mse[-1], how)
        self._write()

    def get(self, problem: str, method: str, seed: int) -> Run | None:
        """Return one run, None if it is not there."""
        return self._runs.get(problem, {}).get(method, {}).get(str(seed))

    def runs(self, problem: str, method: str) -> list[Run]:
        """Return the runs of a method on a problem in the order of their seeds."""
        seeds = self._runs.get(problem, {}).get(method, {})
        return [seeds[seed] for seed in sorted(seeds, key=int)]

    def methods(self) -> Iterator[str]:
        """Yield the methods that have runs."""
        yield from dict.fromkeys(method for methods in self._runs.values() for method in methods)

    def _write(self) -> None:
        if self._path is None:
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        document = {
            "schema": SCHEMA,
            "problems": {name: _without_name(one) for name, one in self.problems.items()},
            "runs": {
                name: {
                    method: {seed: asdict(run) for seed, run in seeds.items()}
                    for method, seeds in methods.items()
                }
                for name, methods in self._runs.items()
            },
        }
        part = self._path.with_suffix(".part")
        part.write_text(_one_line_per_run(document), encoding="utf-8")
        part.replace(self._path)


def _without_name(problem: KeptProblem) -> dict[str, Any]:
    entry = asdict(problem)
    del entry["name"]
    return entry


def _one_line_per_run(document: dict[str, Any]) -> str:
    """Return JSON in which a run is one line, so that differences can be read."""
    runs = [
        f'"{name}": {{\n'
        + ",\n".join(
            f'"{method}": {{\n'
            + ",\n".join(f'"{seed}": {json.dumps(run, separators=(",", ":"))}' for seed, run in seeds.items())
            + "\n}"
            for method, seeds in methods.items()
        )
        + "\n}"
        for name, methods in document["runs"].items()
    ]
    problems = json.dumps(document["problems"], indent=0, ensure_ascii=False)
    return (
        f'{{"schema": {document["schema"]},\n"problems": {problems},\n"runs": {{\n'
        + ",\n".join(runs)
        + "\n}}\n"
    )

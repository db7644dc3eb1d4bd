"""What is kept of the benchmark: all runs in one JSON file, rewritten after every run."""

import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from surrogate_rivals.measured import Run

SCHEMA = 1
Key = tuple[str, str, int, int]
"""Problem, method, rows asked for, seed."""


class Kept:
    """Runs and the problems' units, on disk at once."""

    def __init__(self, path: Path | None) -> None:
        """Read what is there.

        Args:
            path: The file; None to keep nothing.
        """
        self._path = path
        self.units: dict[str, str] = {}
        self._runs: dict[Key, Run] = {}
        if path is not None and path.is_file():
            self.take(path)

    def take(self, path: Path) -> None:
        """Take in what another file holds; of two runs of one kind the first one taken counts."""
        document = json.loads(path.read_text(encoding="utf-8"))
        if document.get("schema") != SCHEMA:
            raise SystemExit(f"{path}: not of schema {SCHEMA}; measure again into another file")
        self.units = document["units"] | self.units
        for entry in document["runs"]:
            key = (entry.pop("problem"), entry.pop("method"), entry.pop("size"), entry.pop("seed"))
            self._runs.setdefault(key, Run(**entry))

    def put(self, key: Key, unit: str, run: Run) -> None:
        """Keep a run."""
        self.units[key[0]] = unit
        self._runs[key] = run
        self._write()

    def __contains__(self, key: Key) -> bool:
        return key in self._runs

    def runs(self, problem: str, method: str, size: int) -> list[Run]:
        """Return the runs of a method on a problem with so many rows, in the order of their seeds."""
        found = [(key[3], run) for key, run in self._runs.items() if key[:3] == (problem, method, size)]
        return [run for _, run in sorted(found, key=lambda one: one[0])]

    def problems(self) -> Iterator[str]:
        """Yield the problems that have runs."""
        yield from dict.fromkeys(key[0] for key in self._runs)

    def methods(self, problem: str) -> set[str]:
        """Return the methods that have runs on a problem."""
        return {key[1] for key in self._runs if key[0] == problem}

    def sizes(self, problem: str) -> list[int]:
        """Return the training-set sizes that have runs on a problem."""
        return sorted({key[2] for key in self._runs if key[0] == problem})

    def _write(self) -> None:
        if self._path is None:
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        # One line per run, so that differences can be read.
        runs = ",\n".join(
            json.dumps({"problem": problem, "method": method, "size": size, "seed": seed, **asdict(run)})
            for (problem, method, size, seed), run in sorted(self._runs.items(), key=lambda one: one[0])
        )
        text = f'{{"schema": {SCHEMA},\n"units": {json.dumps(self.units)},\n"runs": [\n{runs}\n]}}\n'
        part = self._path.with_suffix(".part")
        part.write_text(text, encoding="utf-8")
        part.replace(self._path)

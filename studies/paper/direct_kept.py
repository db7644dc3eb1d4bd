"""Finished starts on disk: appended one by one, read by every row that shares them."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from studies.paper.direct_optimizers import StartResult


class KeptStarts:
    """The finished starts of a series: a line of a file for each, after one that says what they belong to.

    Attributes:
        starts: The starts by their number.
    """

    def __init__(self, file: Path, digest: str) -> None:
        """Read what there is; a file of other inputs begins anew.

        Args:
            file: Where the lines are.
            digest: Of all that decides the starts.
        """
        self._file = file
        self.starts: dict[int, StartResult] = {}
        lines = file.read_bytes().split(b"\n")[:-1] if file.is_file() else []
        known = [one for line in lines if (one := _parsed(line)) is not None]
        if known and known[0].get("series") == digest:
            for one in known[1:]:
                number = int(one.pop("start"))
                for key in ("theta0", "theta", "history"):
                    one[key] = np.array(one[key], dtype=np.float64)
                self.starts[number] = StartResult(**one)
            # A line that a crash cut short has no end: what comes next begins a new one.
            if not file.read_bytes().endswith(b"\n"):
                with file.open("ab") as stream:
                    stream.write(b"\n")
        else:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(json.dumps({"series": digest}) + "\n", encoding="utf-8")

    def add(self, number: int, start: StartResult) -> None:
        """Keep a start."""
        self.starts[number] = start
        values = {**asdict(start), "start": number}
        for key in ("theta0", "theta", "history"):
            values[key] = values[key].tolist()
        with self._file.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(values) + "\n")


def _parsed(line: bytes) -> dict[str, Any] | None:
    try:
        content = json.loads(line)
    except ValueError:
        return None
    return content if isinstance(content, dict) else None

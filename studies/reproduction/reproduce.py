"""`studies reproduce` as steps: find what was recorded, say what differs, make it again, compare."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simulation.errors import InputError
from studies.console import Column, Console
from studies.paths import ProjectPaths
from studies.reproduction.comparison import Compared, aligned, compare, n_equal, shortened
from studies.reproduction.conditions import Difference, differences, expectation
from studies.reproduction.recorded import Recorded, find_recorded
from studies.tracking.origin import environment


@dataclass(frozen=True)
class Reproduction:
    """What came of making a result again.

    Args:
        recorded: the result.
        differences: what differs in its circumstances.
        expectation: whether equal numbers could be expected.
        rows: its numbers, recorded and now.
        notes: what a user should know of how it was rebuilt.
        kept: folder of what was made, None where it was removed.
    """

    recorded: Recorded
    differences: list[Difference]
    expectation: str
    rows: list[Compared]
    notes: list[str]
    kept: Path | None

    @property
    def is_equal(self) -> bool:
        """Whether every number is equal to the last digit."""
        return all(row.is_equal for row in self.rows)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "run": self.recorded.name,
            "kind": self.recorded.kind,
            "recorded_in": self.recorded.place,
            "equal": self.is_equal,
            "expectation": self.expectation,
            "differences": [one.to_dict() for one in self.differences],
            "notes": self.notes,
            "numbers": [row.to_dict() for row in self.rows],
            "kept": None if self.kept is None else str(self.kept),
        }


def reproduce(paths: ProjectPaths, run: str, console: Console, *, n_jobs: int, is_kept: bool) -> Reproduction:
    """Make a recorded result again and compare every number.

    Args:
        paths: the project, which is only read.
        run: what the user calls it.
        console: tells the user.
        n_jobs: processes for simulations.
        is_kept: whether the scratch folder stays, in the project's mlruns/reproduced.

    Raises:
        InputError: nothing is called so, or something that is needed is missing.
    """
    recorded = find_recorded(paths, run)
    _require_repeatable(recorded)
    console.say(f"reproduce: {recorded.name} ({recorded.kind}), recorded in {recorded.place}")
    device = recorded.environment.get("device", "cpu")
    found = differences(recorded, paths, environment(_device_here(device)))
    expected_note = expectation(found, is_known=bool(recorded.environment))
    show_differences(console, found, expected_note)
    # Torch and the FMU's machinery are loaded only now: names that are wrong are answered at once.
    from studies.reproduction.rebuild import rebuilt
    from studies.reproduction.rerun import expected, make_again
    from studies.stages.calibrate import write_arrays
    from studies.stages.pipeline import write_json

    keep = (
        paths.mlruns / "reproduced" / recorded.name.replace("/", "-").replace(" ", "-") if is_kept else None
    )
    with (
        console.stage("reproduce", f"{recorded.name} once more, in a folder of its own"),
        rebuilt(recorded, paths, console, n_jobs=n_jobs, keep=keep) as again,
    ):
        numbers, arrays = make_again(again)
        if keep is not None:
            write_json(keep / "numbers.json", numbers)
            write_arrays(keep / "arrays.npz", arrays)
    rows = compare(expected(recorded), numbers) + compare(recorded.arrays, aligned(arrays, recorded.arrays))
    return Reproduction(recorded, found, expected_note, rows, again.notes, keep)


def show_differences(console: Console, found: list[Difference], expected_note: str) -> None:
    """Say before the work begins what is not as it was."""
    for one in found:
        mark = "!" if one.is_decisive else " "
        console.say(f"  {mark} {one.key}: {one.recorded} -> {one.now}")
        for line in one.detail:
            console.say(f"      {line}")
    console.say(f"reproduce: {expected_note}")


def show_reproduction(console: Console, done: Reproduction) -> None:
    """Print the numbers side by side and the verdict."""
    rows = []
    for row in done.rows:
        relative = "" if row.is_equal or row.relative is None else f"{row.relative:.1e}"
        shown = [shortened(row.recorded), shortened(row.now)]
        rows.append([row.name, *shown, relative, "equal" if row.is_equal else "DIFFERS"])
    console.table(
        f"{done.recorded.name}: recorded and made again",
        [
            Column("number"),
            Column("recorded", True),
            Column("now", True),
            Column("relative", True),
            Column(""),
        ],
        rows,
    )
    for note in done.notes:
        console.result(f"Note: {note}")
    if done.is_equal:
        console.result(f"equal: all {len(done.rows)} rows to the last digit")
    else:
        n_other = len(done.rows) - n_equal(done.rows)
        console.result(f"differs: {n_other} of {len(done.rows)} rows; {done.expectation}")
    if done.kept is not None:
        console.result(f"kept: {done.kept}; it is laid out like a project")


def _require_repeatable(recorded: Recorded) -> None:
    trial = recorded.trial
    if trial is not None and trial.state == "failed" and not trial.environment:
        raise InputError(
            f"{recorded.name} cannot be made again: {trial.reason}; it has no numbers of its own"
        )


def _device_here(device: str) -> str:
    """Return where a training recorded on a device would be made here."""
    if device != "cuda":
        return device
    from pelsvae.device import resolve_device

    return resolve_device("auto").type

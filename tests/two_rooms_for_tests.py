"""The two rooms with some of their experiments."""

from pathlib import Path

from simulation.case import Case, load_case

TWO_ROOMS = Path(__file__).resolve().parents[1] / "fmus" / "two-rooms"


def two_rooms_with(folder: Path, *names: str) -> Case:
    """Return the case with some of its experiments, in this order, written to a folder."""
    text = (TWO_ROOMS / "case.toml").read_text(encoding="utf-8")
    head, *tables = text.split("[[experiments]]")
    by_name = {table.split('"')[1]: table for table in tables}
    text = "[[experiments]]".join([head, *(by_name[name] for name in names)])
    for name in ("TwoRooms.fmu", "../../data/two-rooms"):
        text = text.replace(f'"{name}"', f'"{(TWO_ROOMS / name).resolve()}"')
    (folder / "case.toml").write_text(text, encoding="utf-8")
    return load_case(folder)

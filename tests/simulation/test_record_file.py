"""Records on disk: what was written is read, and whatever was damaged since is named."""

import json
from pathlib import Path

import numpy as np
import pytest

from simulation.errors import InputError
from simulation.record_file import CHECKSUM, read_json, write_json

CONTENT = {"b": [1, 0.1, None, True, float("inf")], "a": {"umlaut": "ä", "place": Path("x/y")}, "c": ""}
READ = {**CONTENT, "a": {"umlaut": "ä", "place": "x/y"}}


def test_what_is_written_is_read(tmp_path: Path) -> None:
    file = tmp_path / "record.json"
    assert read_json(file) is None
    write_json(file, CONTENT)
    assert read_json(file) == READ
    written = json.loads(file.read_text())
    assert [*written] == [*CONTENT, CHECKSUM]
    file.write_text(json.dumps(written, indent=None, sort_keys=True))
    assert read_json(file) == READ
    del written[CHECKSUM]  # as earlier versions wrote it
    file.write_text(json.dumps(written))
    assert read_json(file) == READ


def test_one_flipped_bit_is_named(tmp_path: Path) -> None:
    file = tmp_path / "record.json"
    write_json(file, CONTENT)
    whole = file.read_bytes()
    n_named, places = 0, np.random.default_rng(0).integers(0, 8 * (len(whole) - 1), 300)
    for place in places.tolist():
        damaged = bytearray(whole)
        damaged[place // 8] ^= 1 << place % 8
        file.write_bytes(damaged)
        try:
            found = read_json(file)
        except InputError:
            n_named += 1
        else:
            # The name of the checksum alone may be hit.
            assert found is not None
            assert {key: found[key] for key in READ} == READ
    assert n_named > 0.9 * len(places)


@pytest.mark.parametrize("text", ["", "{", "[1]", "null", "\x00" * 100, "[" * 100_000])
def test_what_is_no_record_is_named(tmp_path: Path, text: str) -> None:
    file = tmp_path / "record.json"
    file.write_text(text)
    with pytest.raises(InputError, match="is damaged; remove it"):
        read_json(file)

"""Resumable generation: nothing finished is done again, nothing damaged or foreign is trusted."""

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from simulation.counting import CountingModel
from simulation.design import uniform_design
from simulation.errors import InputError
from simulation.generate import generate
from simulation.toy import ProductToy, ToyRC
from simulation.trajectories import Trajectories

SPACE = ToyRC().parameter_space
ROOT = Path(__file__).parents[2]


def _design(n: int, seed: int = 0) -> np.ndarray:
    return uniform_design(SPACE, n, seed)


def test_a_second_call_simulates_nothing(tmp_path: Path):
    model = CountingModel(ToyRC())
    first = generate(model, _design(50), tmp_path / "train", chunk_size=16)
    assert (first.n_simulated, first.n_reused, model.n_calls) == (50, 0, 50)
    second = generate(model, _design(50), tmp_path / "train", chunk_size=16)
    assert (second.n_simulated, second.n_reused, model.n_calls) == (0, 50, 50)
    assert second.trajectories.digest == first.trajectories.digest == ToyRC().simulate(_design(50)).digest


def test_a_larger_design_pays_for_its_new_rows_alone_and_a_smaller_one_for_none(tmp_path: Path):
    model = CountingModel(ToyRC())
    generate(model, _design(40), tmp_path, chunk_size=16)
    larger = generate(model, _design(100), tmp_path, chunk_size=16)
    assert (larger.n_simulated, larger.n_reused, model.n_calls) == (60, 40, 100)
    smaller = generate(model, _design(20), tmp_path, chunk_size=16)
    assert (smaller.n_simulated, model.n_calls) == (0, 100)
    assert smaller.trajectories.digest == ToyRC().simulate(_design(20)).digest
    again = generate(model, _design(100), tmp_path, chunk_size=16)
    assert (again.n_simulated, again.trajectories.digest) == (0, ToyRC().simulate(_design(100)).digest)


@pytest.mark.parametrize("damage", ["truncated", "garbage", "empty", "flipped"])
def test_a_damaged_chunk_is_simulated_again(tmp_path: Path, damage: str):
    model = CountingModel(ToyRC())
    whole = generate(model, _design(50), tmp_path, chunk_size=16)
    chunk = tmp_path / "chunk-00001.npz"
    content = bytearray(chunk.read_bytes())
    content[len(content) // 2] ^= 0xFF
    chunk.write_bytes(
        {
            "truncated": chunk.read_bytes()[: len(content) // 2],
            "garbage": b"not a chunk",
            "empty": b"",
            "flipped": bytes(content),
        }[damage]
    )
    mended = generate(model, _design(50), tmp_path, chunk_size=16)
    assert (mended.n_simulated, mended.n_reused) == (16, 34)
    assert mended.trajectories.digest == whole.trajectories.digest


def test_failed_rows_are_kept_like_all_others(tmp_path: Path):
    model = CountingModel(ToyRC(fails_above_r=2.0))
    first = generate(model, _design(30), tmp_path, chunk_size=16)
    assert first.trajectories.failed.any()
    second = generate(model, _design(30), tmp_path, chunk_size=16)
    assert (second.n_simulated, second.trajectories.failures) == (0, first.trajectories.failures)


def test_another_design_model_or_chunk_size_is_refused(tmp_path: Path):
    generate(ToyRC(), _design(20), tmp_path, chunk_size=16, model_digest="a")
    with pytest.raises(InputError, match=r"chunk-00000\.npz: holds the rows of another design; delete"):
        generate(ToyRC(), _design(20, seed=1), tmp_path, chunk_size=16, model_digest="a")
    with pytest.raises(InputError, match=r"manifest\.json: model_digest is 'a', this model has 'b'"):
        generate(ToyRC(), _design(20), tmp_path, chunk_size=16, model_digest="b")
    with pytest.raises(InputError, match="chunk_size is 16, this model has 8"):
        generate(ToyRC(), _design(20), tmp_path, chunk_size=8, model_digest="a")
    with pytest.raises(InputError, match="time_digest"):
        generate(
            ProductToy(time=np.arange(25) * 60.0), _design(20), tmp_path, chunk_size=16, model_digest="a"
        )


def test_a_damaged_manifest_is_refused(tmp_path: Path):
    generate(ToyRC(), _design(20), tmp_path)
    (tmp_path / "manifest.json").write_text("{")
    with pytest.raises(InputError, match="not a readable manifest; delete the folder"):
        generate(ToyRC(), _design(20), tmp_path)


def test_the_manifest_names_the_model(tmp_path: Path):
    generate(ToyRC(), _design(20), tmp_path, model_digest="abc")
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert (manifest["model_digest"], manifest["parameter_names"], manifest["chunk_size"]) == (
        "abc",
        ["R", "C"],
        64,
    )


def test_progress_counts_what_is_reused_first(tmp_path: Path):
    generate(ToyRC(), _design(20), tmp_path, chunk_size=16)
    seen: list[tuple[int, int]] = []
    generate(ToyRC(), _design(40), tmp_path, chunk_size=16, on_progress=lambda *counts: seen.append(counts))
    assert seen == [(20, 40), (32, 40), (40, 40)]


def test_an_empty_design_is_refused(tmp_path: Path):
    with pytest.raises(ValueError, match="no rows"):
        generate(ToyRC(), _design(0), tmp_path)


SCRIPT = """
import sys
from pathlib import Path
sys.path[:0] = [{tests!r}, {root!r}]
from simulation.design import uniform_design
from simulation.generate import generate
from slow_models import SlowToy

model = SlowToy(row_s=0.005)
generate(model, uniform_design(model.parameter_space, 400, 0), Path({folder!r}), chunk_size=4)
"""


def test_a_killed_run_loses_at_most_its_chunk_in_flight(tmp_path: Path):
    folder = tmp_path / "train"
    script = SCRIPT.format(tests=str(Path(__file__).parent), root=str(ROOT), folder=str(folder))
    with subprocess.Popen([sys.executable, "-c", script]) as process:
        while not list(folder.glob("chunk-0000[3-9].npz")):
            assert process.poll() is None
            time.sleep(0.005)
        process.kill()
    held = sorted(folder.glob("chunk-*.npz"))
    assert [Trajectories.load(path).n for path in held] == [4] * len(held)
    model = CountingModel(ToyRC())
    result = generate(model, _design(400), folder, chunk_size=4)
    assert result.n_reused == 4 * len(held) > 0
    assert result.n_simulated == model.n_calls == 400 - 4 * len(held)
    assert result.trajectories.digest == ToyRC().simulate(_design(400)).digest

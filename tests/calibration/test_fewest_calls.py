"""The benchmark of fewest calls: its counter, its file, its instances."""

import json
import sys
from pathlib import Path

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))

from fewest_calls.__main__ import main  # noqa: E402
from fewest_calls.table import OURS  # noqa: E402

RUNS = ["--problems", "wall, instance 7", "--instances", "7", "--brute-force", "1", "--seeds", "1"]
RUNS += ["--max-calls", "25"]


def test_two_methods_on_the_wall_are_measured_once_and_shown(tmp_path, capsys):
    kept, picture = tmp_path / "kept.json", tmp_path / "picture.png"
    main([*RUNS, "--methods", "trf", "--json", str(kept)])
    first = json.loads(kept.read_text())["runs"]["wall, instance 7"]["trf"]["0"]
    assert first["n_calls"] <= 25
    assert first["ended"] == "budget"
    main([*RUNS, "--methods", "trf", OURS, "--json", str(kept)])
    # Processor time is part of a run: the same to the last digit is not measured twice.
    runs = json.loads(kept.read_text())["runs"]["wall, instance 7"]
    assert runs["trf"]["0"] == first
    assert set(runs) == {"trf", OURS}
    # A larger budget prolongs what the smaller one ended.
    main([*RUNS[:-1], "40", "--methods", "trf", "--json", str(kept)])
    assert json.loads(kept.read_text())["runs"]["wall, instance 7"]["trf"]["0"]["n_calls"] > 25
    capsys.readouterr()
    main(["--from", str(kept), "--plot", str(picture)])
    shown = capsys.readouterr().out
    assert "| wall, instance 7 |" in shown
    assert f"Where `{OURS}` loses:" in shown
    assert picture.stat().st_size > 10_000

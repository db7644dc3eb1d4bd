"""The house rules that tools can check: style, strict types, direction of imports."""

import ast
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize(
    "command",
    [
        ["ruff", "check", "."],
        ["ruff", "format", "--check", "."],
        ["pyrefly", "check", "--python-interpreter-path", sys.executable],
        ["lint-imports"],
    ],
    ids=lambda command: "-".join(command[:2]),
)
def test_tool_finds_nothing(command: list[str]) -> None:
    tool = Path(sys.executable).parent / command[0]
    if not tool.exists():
        pytest.skip(f"{command[0]} is not installed: pip install -e '.[test]'")
    done = subprocess.run([tool, *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_package_is_installed_with_the_project() -> None:
    declared = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    found = {
        ".".join(init.parent.relative_to(ROOT).parts)
        for room in ("simulation", "pelsvae", "studies")
        for init in (ROOT / room).rglob("__init__.py")
    }
    assert found | {"studies.cases.data", "studies.cases.fmus"} == declared


def test_nothing_of_the_recording_is_tracked() -> None:
    git = subprocess.run(
        ["git", "ls-files", "data/office-recorded", "mlruns"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    if git.returncode != 0:
        pytest.skip("not a git checkout")
    assert git.stdout.split() == ["mlruns/README.md"]


def test_every_constant_of_the_calibration_says_where_it_comes_from() -> None:
    silent = []
    for file in sorted((ROOT / "studies" / "calibration").rglob("*.py")):
        text = file.read_text(encoding="utf-8")
        lines, body = text.splitlines(), ast.parse(text).body
        for one, after in zip(body, [*body[1:], None], strict=True):
            name = ast.unparse(one).partition(" = ")[0]
            numbers = [part for part in ast.walk(one) if isinstance(part, ast.Constant)]
            if not (isinstance(one, ast.Assign) and name.isupper()):
                continue
            if not any(isinstance(number.value, int | float) for number in numbers):
                continue
            is_described = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            if not (is_described or "#" in lines[one.lineno - 2] + lines[one.lineno - 1]):
                silent.append(f"{file.name}: {name}")
    assert silent == []

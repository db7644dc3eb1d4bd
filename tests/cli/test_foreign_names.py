"""Names of cases, profiles and labels that lead outside or hold control signs, and long quotations."""

from pathlib import Path

import pytest
from project_for_tests import Run

from simulation.case_reading import read_experiments
from simulation.errors import InputError
from simulation.foreign_text import MOST_QUOTED
from studies.paths import ProjectPaths
from studies.profile import load_profile

BAD = ("..", "../x", "a/b", "/etc", "a\0b", "a\x1b[2J", "a\nb", "\u202ea", ".", "", "a" * 300)
LONG = "x" * 5000


def toml(text: str) -> str:
    """Write a text as TOML does."""
    return (
        '"'
        + "".join(f"\\u{ord(sign):04x}" if ord(sign) < 32 or ord(sign) > 126 else sign for sign in text)
        + '"'
    )


@pytest.mark.parametrize("name", BAD)
def test_no_folder_of_a_project_has_such_a_name(tmp_path: Path, name: str) -> None:
    paths = ProjectPaths(tmp_path)
    for place in (paths.results, paths.report, paths.generated):
        with pytest.raises(InputError, match="is no name of a case or a label"):
            place(name)


@pytest.mark.parametrize("name", BAD)
def test_a_case_of_such_a_name_is_refused(project: Path, studies: Run, name: str) -> None:
    case = project / "fmus" / "office" / "case.toml"
    text = case.read_text(encoding="utf-8")
    case.write_text(text.replace('name = "office"', f"name = {toml(name)}", 1), encoding="utf-8")
    answer = studies("check")
    assert answer.code == 2, answer.err
    (line,) = answer.err.splitlines()
    assert "name" in line
    assert len(line) < MOST_QUOTED * 5


@pytest.mark.parametrize(
    "content",
    [
        f'{LONG} = 1\nname = "a"',
        f"name = '{LONG}'",
        f"{LONG}",
        f"schema = {'9' * 6000}",
        f"seed = {'[' * 3000}{']' * 3000}",
    ],
)
def test_messages_about_files_are_short(tmp_path: Path, content: str) -> None:
    file = tmp_path / "file.toml"
    file.write_text(content, encoding="utf-8")
    for read in (read_experiments, lambda place: load_profile(str(place))):
        with pytest.raises(InputError) as found:
            read(file)
        assert len(str(found.value).replace(f"{file}", "")) < 5 * MOST_QUOTED

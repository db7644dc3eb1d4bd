"""SECURITY.md: its way to run an FMU apart keeps what it promises, and commands point to it."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from project_for_tests import OFFICE, REPOSITORY, Run

from studies.words.wording import NATIVE_CODE

NOTICE = f"{NATIVE_CODE}\n"
ATTACK = """
for attempt in "cat '{secret}'" "echo x > /usr/x" "ls /proc/{pid}/cwd"; do
  if (eval "$attempt") 2> /dev/null; then echo "could: $attempt"; fi
done
echo x > '{outside}'
cat /proc/net/dev | grep -c : ; echo written > inside
"""


def test_the_example_with_bubblewrap_keeps_an_fmu_apart(tmp_path: Path) -> None:
    if shutil.which("bwrap") is None:
        pytest.skip("bubblewrap is not installed")
    if subprocess.run(["bwrap", "--ro-bind", "/", "/", "--unshare-all", "true"], check=False).returncode:
        pytest.skip("this machine allows no namespaces")
    project, secret, outside = tmp_path / "project", tmp_path / "secret", tmp_path / "outside"
    project.mkdir()
    secret.write_text("secret")
    with subprocess.Popen(["sleep", "60"]) as other:
        attack = ATTACK.format(secret=secret, outside=outside, pid=other.pid)
        found = re.search(r"```sh\n(.*?)```", (REPOSITORY / "SECURITY.md").read_text(encoding="utf-8"), re.S)
        assert found is not None
        setting, _, example = found[1].partition("\n")
        assert setting.startswith("VENV=")
        command = example.replace('"$VENV/bin/studies" check my-case', '/bin/sh -c "$1"')
        assert command != example
        done = subprocess.run(
            ["sh", "-c", f"VENV={sys.prefix}\n{command}", "sh", attack],
            cwd=project,
            capture_output=True,
            text=True,
            check=False,
        )
        other.kill()
    assert (done.returncode, done.stderr, done.stdout.split()) == (0, "", ["1"]), "only its own loopback"
    assert (project / "inside").read_text() == "written\n"
    assert not outside.exists()


@pytest.mark.slow
def test_making_or_checking_a_case_says_once_what_an_fmu_is(project: Path, studies: Run) -> None:
    made = studies("new", str(OFFICE / "Office.fmu"), "--to", str(project / "room"))
    assert made.err.count(NOTICE) == 1
    checked = studies("check", "office", "--profile", "smoke")
    assert checked.err.count(NOTICE) == 1
    assert (REPOSITORY / "SECURITY.md").is_file()

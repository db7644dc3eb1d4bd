"""What git knows of a project is read without running what a stranger's checkout names."""

import os
import subprocess
from pathlib import Path

import pytest

from studies.tracking.origin import checked_out, environment, origin_tags

COMMIT = "0123456789abcdef0123456789abcdef01234567"
KEY = "mlflow.source.git.commit"


def git(folder: Path, *words: str) -> str:
    who = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "init.defaultBranch=main")
    # Hooks of git set variables that name another checkout.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    done = subprocess.run(["git", *who, *words], cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout with one commit."""
    root = tmp_path / "project"
    root.mkdir()
    git(root, "init")
    (root / "a.txt").write_text("1")
    git(root, "add", "a.txt")
    git(root, "commit", "-m", "one")
    return root


def bare(folder: Path, head: str) -> Path:
    """Write as little of a checkout as has a HEAD."""
    (folder / ".git").mkdir(parents=True)
    (folder / ".git" / "HEAD").write_text(head)
    return folder


def test_no_command_of_a_strangers_checkout_is_run(checkout: Path) -> None:
    trap, caught = checkout.parent / "trap.sh", checkout.parent / "caught"
    trap.write_text(f'#!/bin/sh\necho "$0" >> {caught}\ncat\n')
    trap.chmod(0o755)
    commit = git(checkout, "rev-parse", "HEAD")
    (checkout / ".gitattributes").write_text("* filter=trap diff=trap\n")
    (checkout / "a.txt").write_text("2")
    for key in ("core.fsmonitor", "diff.external", "core.pager", "filter.trap.clean", "diff.trap.textconv"):
        git(checkout, "config", key, f"{trap}")
    assert origin_tags(checkout)[KEY] == commit
    assert "code studies" in environment()
    assert not caught.exists()
    git(checkout, "status")
    assert caught.exists(), "the trap is none"


def test_the_commit_is_found_wherever_git_keeps_it(checkout: Path) -> None:
    commit = git(checkout, "rev-parse", "HEAD")
    below = checkout / "below" / "it"
    below.mkdir(parents=True)
    assert origin_tags(below)[KEY] == commit
    git(checkout, "checkout", "-b", "fix/a+b#1")
    assert checked_out(checkout) == commit
    git(checkout, "pack-refs", "--all")
    assert checked_out(checkout) == commit
    git(checkout, "worktree", "add", str(checkout.parent / "second"))
    assert checked_out(checkout.parent / "second") == commit
    git(checkout, "checkout", "--detach")
    assert checked_out(checkout) == commit
    assert checked_out(checkout / "below") == ""


@pytest.mark.parametrize(
    "head",
    [
        "--output=/tmp/x",
        COMMIT[:39],
        COMMIT.upper().replace("0", "A"),
        f"{COMMIT} ",
        f"{COMMIT}\nmore",
        "ref: refs/../../secret",
        "ref: /secret",
        "ref: refs/heads/\0",
        "ref: refs/heads/" + "a" * 5000,
        "",
    ],
)
def test_only_a_hash_is_a_commit(tmp_path: Path, head: str) -> None:
    (tmp_path / "secret").write_text(COMMIT)
    assert checked_out(bare(tmp_path / "p" / "q", head)) == (COMMIT if head == f"{COMMIT} " else "")


def test_a_file_that_never_ends_is_not_read(tmp_path: Path) -> None:
    root = bare(tmp_path, "ref: refs/heads/main")
    os.mkfifo(root / ".git" / "packed-refs")
    (root / ".git" / "commondir").symlink_to("/dev/zero")
    assert checked_out(root) == ""
    assert KEY not in origin_tags(root)

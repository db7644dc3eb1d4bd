"""Runs first: says what is missing on a machine that cannot run the rest."""

import platform
import sys
from collections.abc import Sequence

BAD_INPUT = 2


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line, or say in one line why this machine cannot."""
    machine = f"{platform.system() or sys.platform} on {platform.machine() or 'an unknown processor'}"
    if sys.platform != "linux" or platform.machine().lower() not in ("x86_64", "amd64"):
        sys.stderr.write(
            f"studies: error: Linux on x86-64 is missing, this machine has {machine}; use a container or a "
            "virtual machine\n"
        )
        return BAD_INPUT
    # Only now: the rest needs Linux already when it is imported.
    import studies.rare_collection  # noqa: F401
    from studies.cli import main as run

    return run(argv)

"""Command line: `python -m fmus.compiler FOLDER [--output FILE]`."""

import argparse
import hashlib
import sys
from pathlib import Path

from fmus.compiler.settings import CompileError


def main(arguments: list[str] | None = None) -> int:
    """Build one FMU and print its path and checksum.

    Args:
        arguments: Command line without the program's name; by default the process's own.

    Returns:
        Exit code: 0, or 2 after an error that is printed in one line.
    """
    parser = argparse.ArgumentParser(
        prog="python -m fmus.compiler",
        description="Compile the Modelica model in FOLDER (build.toml names it) to an FMU of FMI 2.0 or "
        "3.0 for co-simulation and model exchange, with a linux64 binary and its C sources.",
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="such as fmus/office")
    parser.add_argument("--output", type=Path, metavar="FILE", help="FMU to write (default: into FOLDER)")
    options = parser.parse_args(arguments)
    try:
        try:
            from fmus.compiler.package import build_fmu
        except ModuleNotFoundError as error:
            raise CompileError(f"{error.name} is not installed; pip install -e '.[modelica]'") from None
        target = build_fmu(options.folder, options.output)
    except (CompileError, OSError) as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    sys.stdout.write(f"{target}  sha256 {hashlib.sha256(target.read_bytes()).hexdigest()}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

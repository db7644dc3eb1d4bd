"""The generators of the made-up recordings, whose solutions of the equations owe nothing to an FMU."""

import importlib.util

from fmu_for_tests import REPOSITORY


def generator_of(name):
    """Import data/<name>/generate.py."""
    path = REPOSITORY / "data" / name / "generate.py"
    spec = importlib.util.spec_from_file_location(f"generate_{name}", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module

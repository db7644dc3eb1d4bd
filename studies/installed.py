"""Classes of installed packages that a profile names; what lies in its folder is not imported."""

import sysconfig
from importlib import import_module
from importlib.machinery import PathFinder
from importlib.util import find_spec

from simulation.errors import InputError
from simulation.foreign_text import quoted


def installed_class(key: str, name: str) -> type:
    """Return a class of an installed package by `module:Class`.

    A profile may be a stranger's: what lies in its folder, or in the working folder, is not imported.

    Args:
        key: of the profile, for the message.
        name: the class.

    Raises:
        InputError: there is no such class.
    """
    module, _, class_name = name.partition(":")
    package, remedy = module.partition(".")[0], "name a class of an installed package, as module:Class"
    if not all(part.isidentifier() for part in (*module.split("."), class_name)):
        raise InputError(f"{key}: {quoted(name)} is no module:Class; {remedy}")
    places = [sysconfig.get_path(one) for one in ("purelib", "platlib")]
    there, taken = PathFinder.find_spec(package, places), find_spec(package)
    if there is None or taken is None or there.origin is None or there.origin != taken.origin:
        raise InputError(f"{key}: no package {package!r} is installed; type: pip install {package}")
    try:
        found = getattr(import_module(module), class_name, None)
    except ImportError as error:
        raise InputError(f"{key}: {module} cannot be imported: {error}") from None
    if not isinstance(found, type):
        raise InputError(f"{key}: {quoted(name)} is no {key.rpartition('.')[2]}; {remedy}")
    return found

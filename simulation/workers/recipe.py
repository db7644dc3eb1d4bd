"""Recipes: how a process learns what a model is without opening it, and how another process opens it."""

import pickle
import pickletools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from simulation.arrays import FloatArray
from simulation.forward_model import ForwardModel
from simulation.parameters import ParameterSpace

Recipe = Callable[[], ForwardModel]


@dataclass(frozen=True, eq=False)
class Facts:
    """What is known of a model without simulating.

    Attributes:
        parameter_space: Its parameters.
        output_names: Its outputs.
        time: Its output times. Shape (t,). [s]
    """

    parameter_space: ParameterSpace
    output_names: tuple[str, ...]
    time: FloatArray


@runtime_checkable
class _Described(Protocol):
    @property
    def parameter_space(self) -> ParameterSpace: ...
    @property
    def output_names(self) -> tuple[str, ...]: ...
    @property
    def time(self) -> FloatArray: ...


def known_facts(recipe: Recipe) -> Facts | None:
    """Return what the owner of a recipe says of its model; None where only the open model can tell.

    Args:
        recipe: The recipe; its owner is the object that it is a bound method of.
    """
    owner = getattr(recipe, "__self__", None)
    if isinstance(owner, _Described):
        return Facts(owner.parameter_space, owner.output_names, owner.time)
    return None


def subject(recipe: Recipe) -> str:
    """Return what errors about opening a model are about: its file, where there is one.

    Args:
        recipe: The recipe.
    """
    return str(getattr(getattr(recipe, "__self__", None), "path", recipe))


def packed(recipe: Recipe) -> bytes:
    """Return a recipe as bytes for another process.

    Args:
        recipe: The recipe.

    Raises:
        RuntimeError: If no other process could read it.
    """
    try:
        content = pickle.dumps(recipe)
    except Exception as error:
        said = " ".join(str(error).split())
        raise RuntimeError(
            f"the recipe {recipe!r} cannot be sent to worker processes ({said}); give a function of a "
            "module, or a method of an object that can be pickled"
        ) from error
    if any(argument == "__main__" for _, argument, _ in pickletools.genops(content)):
        raise RuntimeError(
            f"the recipe {recipe!r} is defined in the script itself, where worker processes cannot find it; "
            "move it to a module"
        )
    return content

"""Factories of models: what is known of a model before it is opened, and how another process opens it."""

import pickle
import pickletools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from simulation.arrays import FloatArray
from simulation.forward_model import ForwardModel
from simulation.parameters import ParameterSpace

Factory = Callable[[], ForwardModel]


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


def known_facts(make_model: Factory) -> Facts | None:
    """Return what the owner of a factory declares of its model; None where only the open model knows.

    Args:
        make_model: The factory; its owner is the object that it is a bound method of.
    """
    try:
        owner: Any = make_model.__self__  # type: ignore[attr-defined]
        return Facts(owner.parameter_space, owner.output_names, owner.time)
    except AttributeError:
        return None


def subject(make_model: Factory) -> str:
    """Return what errors about opening a model are about: its file, where there is one.

    Args:
        make_model: The factory.
    """
    return str(getattr(getattr(make_model, "__self__", None), "path", make_model))


def packed(make_model: Factory) -> bytes:
    """Return a factory as bytes for another process.

    Args:
        make_model: The factory.

    Raises:
        RuntimeError: If no other process could read it.
    """
    try:
        content = pickle.dumps(make_model)
    except Exception as error:
        said = " ".join(str(error).split())
        raise RuntimeError(
            f"the factory {make_model!r} cannot be sent to worker processes ({said}); give a function of a "
            "module, or a method of an object that can be pickled"
        ) from error
    if any(argument == "__main__" for _, argument, _ in pickletools.genops(content)):
        raise RuntimeError(
            f"the factory {make_model!r} is defined in the script itself, where worker processes cannot find "
            "it; move it to a module"
        )
    return content

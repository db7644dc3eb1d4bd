"""Several minimizations by L-BFGS-B whose functions are looked at together, a batch in every step."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from queue import SimpleQueue

import numpy as np
from scipy.optimize import minimize

from pelsvae.standardize import Array

N_CORRECTIONS = 20
Found = tuple[float, Array]
"""A minimum: its value, and where it is."""


class _GivenUpError(Exception):
    """No one asks any more."""


def minimize_in_step(
    losses: Callable[[list[int], Array], tuple[Array, Array]],
    starts: Sequence[Array],
    bounds: Sequence[tuple[float, float]],
    max_iterations: int,
) -> list[Found]:
    """Minimize several functions, each as it would be alone.

    SciPy asks for one point after the other, so every minimization has a thread, which waits until all others
    have asked too or are done.

    Args:
        losses: Returns values (b,) and gradients (b, h) of functions, by their places, at points (b, h).
        starts: Where each begins. Shapes (h,).
        bounds: Lower and upper, of all. h pairs.
        max_iterations: Of each.

    Returns:
        What each has found.
    """
    asked: SimpleQueue[tuple[int, Array | Found | BaseException]] = SimpleQueue()
    answers: list[SimpleQueue[tuple[float, Array] | None]] = [SimpleQueue() for _ in starts]

    def search(place: int) -> None:
        def loss(point: Array) -> tuple[float, Array]:
            asked.put((place, point.copy()))
            if (answer := answers[place].get()) is None:
                raise _GivenUpError
            return answer

        try:
            asked.put((place, _minimum(loss, starts[place], bounds, max_iterations)))
        except BaseException as error:
            asked.put((place, error))

    threads = [threading.Thread(target=search, args=(place,), daemon=True) for place in range(len(starts))]
    found: dict[int, Found] = {}
    try:
        for thread in threads:
            thread.start()
        while len(found) < len(starts):
            points: dict[int, Array] = {}
            for place, said in sorted(
                (asked.get() for _ in range(len(starts) - len(found))), key=lambda pair: pair[0]
            ):
                if isinstance(said, BaseException):
                    raise said
                if isinstance(said, tuple):
                    found[place] = said
                else:
                    points[place] = said
            if points:
                values, gradients = losses(list(points), np.array(list(points.values())))
                for place, value, gradient in zip(points, values, gradients, strict=True):
                    answers[place].put((float(value), gradient))
    finally:
        for answer in answers:
            answer.put(None)
        for thread in threads:
            if thread.ident is not None:
                thread.join()
    return [found[place] for place in range(len(starts))]


def _minimum(
    loss: Callable[[Array], tuple[float, Array]],
    start: Array,
    bounds: Sequence[tuple[float, float]],
    max_iterations: int,
) -> Found:
    found = minimize(
        loss,
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": max_iterations, "maxcor": N_CORRECTIONS},
    )
    return float(found.fun), np.asarray(found.x, dtype=np.float64)

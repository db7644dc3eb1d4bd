"""The benchmark in words: per problem the median errors of every method over n, then times and coverage."""

import statistics
from collections.abc import Callable, Iterator

from surrogate_rivals.kept import Kept
from surrogate_rivals.measured import Run
from surrogate_rivals.methods import METHODS
from surrogate_rivals.problems import PROBLEMS

Value = Callable[[Run], float | None]


def order(kept: Kept, problem: str) -> list[str]:
    """Return the methods that have runs on a problem, in the order of the registry."""
    present = kept.methods(problem)
    return [name for name in METHODS if name in present] + sorted(present - set(METHODS))


def lines(kept: Kept, *, is_detailed: bool) -> Iterator[str]:
    """Yield the whole report in Markdown."""
    for problem in [name for name in PROBLEMS if name in set(kept.problems())]:
        title, unit = PROBLEMS[problem].title, kept.units[problem]
        yield f"### {title}"
        yield ""
        yield from _block(kept, problem, f"test MAE [{unit}]", lambda run: run.mae, marks_least=True)
        if is_detailed:
            yield from _block(
                kept, problem, f"90th percentile [{unit}]", lambda run: run.p90, marks_least=True
            )
        yield from _block(kept, problem, "training, choices included [CPU s]", lambda run: run.train_s)
        if is_detailed:
            yield from _block(kept, problem, "the last fit alone [CPU s]", lambda run: run.fit_s)
        yield from _block(kept, problem, "10,000 predictions [CPU s]", lambda run: run.predict_s)
        yield from _block(
            kept, problem, "coverage of the 90 % band [%]", lambda run: run.coverage and 100.0 * run.coverage
        )
        yield from _verdict(kept, problem)
    yield from _number_of_runs(kept)


def median(kept: Kept, problem: str, method: str, size: int, value: Value) -> float | None:
    """Return the median over seeds, None without a run."""
    found = [one for run in kept.runs(problem, method, size) if (one := value(run)) is not None]
    return statistics.median(found) if found else None


def _block(kept: Kept, problem: str, what: str, value: Value, *, marks_least: bool = False) -> Iterator[str]:
    sizes, methods = kept.sizes(problem), order(kept, problem)
    cells = {m: [median(kept, problem, m, size, value) for size in sizes] for m in methods}
    if all(one is None for row in cells.values() for one in row):
        return
    columns = zip(*cells.values(), strict=True)
    least = [min((one for one in column if one is not None), default=None) for column in columns]
    yield f"| {what} | " + " | ".join(f"n = {size}" for size in sizes) + " |"
    yield "|---" * (1 + len(sizes)) + "|"
    for method, row in cells.items():
        if any(one is not None for one in row):
            texts = [
                _text(one, is_least=marks_least and one == best) for one, best in zip(row, least, strict=True)
            ]
            yield f"| {method} | " + " | ".join(texts) + " |"
    yield ""


def _text(value: float | None, *, is_least: bool) -> str:
    if value is None:
        return ""
    return f"**{value:.3g}**" if is_least else f"{value:.3g}"


def _verdict(kept: Kept, problem: str) -> Iterator[str]:
    """Yield at which sizes the best of ours is ahead of the best rival, and by how much."""
    comparisons = []
    for size in kept.sizes(problem):
        errors: dict[bool, dict[str, float]] = {True: {}, False: {}}
        for method in order(kept, problem):
            mae = median(kept, problem, method, size, lambda run: run.mae)
            if mae is not None:
                errors[method in METHODS and METHODS[method].is_ours][method] = mae
        if errors[True] and errors[False]:
            ours, rival = (min(errors[own], key=errors[own].__getitem__) for own in (True, False))
            ratio = errors[True][ours] / errors[False][rival]
            comparisons.append(f"n = {size}: `{ours}` {ratio:.2f} times the MAE of {rival}")
    if comparisons:
        yield "Best of ours against the best rival: " + "; ".join(comparisons) + "."
        yield ""


def _number_of_runs(kept: Kept) -> Iterator[str]:
    for problem in kept.problems():
        parts = []
        for method in order(kept, problem):
            counts = {size: len(kept.runs(problem, method, size)) for size in kept.sizes(problem)}
            parts.append(f"{method} " + "/".join(str(count) for count in counts.values()))
        sizes = "/".join(str(size) for size in kept.sizes(problem))
        yield f"Seeds of {problem} at n = {sizes}: " + "; ".join(parts) + "."

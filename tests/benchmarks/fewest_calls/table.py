"""The benchmark in words: median and worst calls to each target, the best method of each problem, losses."""

import statistics
from collections.abc import Iterator
from dataclasses import dataclass

from fewest_calls.counted import Run
from fewest_calls.kept import Kept
from fewest_calls.methods import METHODS
from fewest_calls.problems import FAMILIES

FACTORS = (1.17, 1.05, 1.02)
RIGHT = FACTORS[-1]
OURS = "adaptive, state equations"
# The command's own budget, unless --max-calls names another one.
USUAL_CALLS = 100
NEVER = float("inf")


def order(kept: Kept) -> list[str]:
    """Return the methods that have runs in the order of the registry."""
    present = set(kept.methods())
    return [name for name in METHODS if name in present] + sorted(present - set(METHODS))


def cell(counts: list[float]) -> str:
    """Return median and worst; counts that are infinite are runs that never arrived."""
    if not counts:
        return ""
    n_never = sum(count == NEVER for count in counts)
    never = f"never {n_never} of {len(counts)}"
    median = _median(counts)
    if median == NEVER:
        return never
    return f"{median:g} ({never if n_never else f'{max(counts):g}'})"


def _median(counts: list[float]) -> float:
    """Return the middle count, of two the mean; infinite if either is."""
    return statistics.median(counts)


def counts_to(
    kept: Kept, problem: str, method: str, factor: float, *, in_rounds: bool = False
) -> list[float]:
    """Return the calls, or the rounds, of every run until a multiple of the best error known.

    A peer that ended at its target had reached 1.02 times the best error known then; one that was found
    since, up to 0.4 % lower, takes nothing from it.
    """
    target = factor * kept.problems[problem].best
    counted = Run.rounds_to if in_rounds else Run.calls_to
    found = []
    for run in kept.runs(problem, method):
        is_at_target = run.ended == "target" and factor == RIGHT
        found.append(counted(run, run.mse[-1] if is_at_target else target))
    return found


def lines(kept: Kept) -> Iterator[str]:
    """Yield the whole report in Markdown."""
    yield from _by_family(kept)
    yield ""
    yield from _by_problem(kept)
    yield ""
    yield from _by_family(kept, in_rounds=True)
    yield from _losses(kept)
    yield ""
    yield from ends(kept)
    yield from _runs_fewer(kept)


def ends(kept: Kept) -> Iterator[str]:
    """Yield how ours ended by themselves, and how often "converged" was true."""
    for method in order(kept):
        found = {
            problem.name: [run for run in kept.runs(problem.name, method) if run.said]
            for problem in kept.problems.values()
        }
        if not any(found.values()):
            continue
        yield f"How `{method}` ended by itself: medians (worst); right is at most {RIGHT:g} times the best"
        yield ""
        yield (
            "| problem | calls | final / best error | "
            + " | ".join(f"calls to {factor:g} times" for factor in (FACTORS[0], FACTORS[-1]))
            + f" | right | right within {USUAL_CALLS} calls | right, and said converged"
            + " | wrong, and said converged |"
        )
        yield "|---" * 9 + "|"
        for name, runs in found.items():
            if runs:
                yield f"| {name} | " + " | ".join(_ending(runs, kept.problems[name].best)) + " |"
        together = [_Endings.of(runs, kept.problems[name].best) for name, runs in found.items() if runs]
        n, n_right = sum(one.n for one in together), sum(one.n_right for one in together)
        n_said, n_false = sum(one.n_said for one in together), sum(one.n_false for one in together)
        n_usual = sum(one.n_usual for one in together)
        yield ""
        yield (
            f"Of {n} runs {n_false} ({n_false / n:.1%}) said that they converged and were wrong; of "
            f"{n_right} right ones {n_said} ({n_said / max(n_right, 1):.0%}) said that they converged, and "
            f"{n_usual} were right within {USUAL_CALLS} calls."
        )
        yield ""


@dataclass(frozen=True)
class _Endings:
    """How many of some runs ended right, were so within the usual calls, said so, and said so falsely."""

    n: int
    n_right: int
    n_usual: int
    n_said: int
    n_false: int

    @classmethod
    def of(cls, runs: list[Run], best: float) -> "_Endings":
        right = [run for run in runs if run.first(RIGHT * best) is not None]
        n_said = sum(run.converged is True for run in right)
        n_converged = sum(run.converged is True for run in runs)
        n_usual = sum(run.calls_to(RIGHT * best) <= USUAL_CALLS for run in runs)
        return cls(len(runs), len(right), n_usual, n_said, n_converged - n_said)


def _ending(runs: list[Run], best: float) -> Iterator[str]:
    yield cell([float(run.n_calls) for run in runs])
    ratios = [run.mse[-1] / best if run.mse else NEVER for run in runs]
    yield f"{statistics.median(ratios):.3f} ({max(ratios):.3f})"
    for factor in (FACTORS[0], FACTORS[-1]):
        yield cell([run.calls_to(factor * best) for run in runs])
    found = _Endings.of(runs, best)
    yield f"{found.n_right} of {found.n}"
    yield from (str(found.n_usual), str(found.n_said), str(found.n_false))


def details(kept: Kept) -> Iterator[str]:
    """Yield a row for every method on every problem."""
    yield (
        "| problem | method | runs | "
        + " | ".join(f"to {f:g} times" for f in FACTORS)
        + " | CPU s per call |"
    )
    yield "|---" * (4 + len(FACTORS)) + "|"
    for problem in kept.problems:
        for method in order(kept):
            runs = kept.runs(problem, method)
            if runs:
                cells = [cell(counts_to(kept, problem, method, factor)) for factor in FACTORS]
                seconds = sum(run.seconds for run in runs) / max(sum(run.n_calls for run in runs), 1)
                yield f"| {problem} | {method} | {len(runs)} | " + " | ".join(cells) + f" | {seconds:.2g} |"


def _by_family(kept: Kept, *, in_rounds: bool = False) -> Iterator[str]:
    methods = order(kept)
    if in_rounds:
        methods = [name for name in methods if name in METHODS and METHODS[name].at_once > 1]
    if not methods:
        return
    counted = "Rounds of parallel calls" if in_rounds else "Calls"
    met = [one for one in kept.problems.values() if any(kept.runs(one.name, name) for name in methods)]
    families = [f for f in FAMILIES if any(one.family == f for one in met)]
    for factor in (FACTORS[0], FACTORS[-1]):
        yield f"{counted} to {factor:g} times the best error known: median (worst) over problems and seeds"
        yield ""
        yield "| method | " + " | ".join(FAMILIES[f].replace(", ", ",<br>") for f in families) + " |"
        yield "|---" * (1 + len(families)) + "|"
        for method in methods:
            cells = [
                cell(
                    [
                        count
                        for problem in met
                        if problem.family == family
                        for count in counts_to(kept, problem.name, method, factor, in_rounds=in_rounds)
                    ]
                )
                for family in families
            ]
            yield f"| {method} | " + " | ".join(cells) + " |"
        yield ""


def _best_peer(kept: Kept, problem: str, factor: float) -> tuple[str, list[float]]:
    """Return the peer with the lowest median; of equals the one with fewer failures, then the lower worst."""
    peers = {
        method: counts_to(kept, problem, method, factor)
        for method in order(kept)
        if method not in METHODS or not METHODS[method].is_ours
    }
    peers = {method: counts for method, counts in peers.items() if counts}
    if not peers:
        return "", []
    return min(peers.items(), key=lambda one: (_median(one[1]), one[1].count(NEVER), max(one[1])))


def _by_problem(kept: Kept) -> Iterator[str]:
    yield (
        "| problem | best error known | "
        + " | ".join(f"ours to {f:g} | best peer to {f:g}" for f in FACTORS)
        + " |"
    )
    yield "|---" * (2 + 2 * len(FACTORS)) + "|"
    for problem in kept.problems.values():
        cells = []
        for factor in FACTORS:
            ours = counts_to(kept, problem.name, OURS, factor)
            peer, theirs = _best_peer(kept, problem.name, factor)
            wins = bool(ours) and (not theirs or _median(ours) <= _median(theirs))
            cells.append(f"**{cell(ours)}**" if wins and _median(ours) < NEVER else cell(ours))
            name = peer if theirs and _median(theirs) < NEVER else ""
            cells.append(f"{cell(theirs)} {name}".strip() if name else ("none arrives" if theirs else ""))
        yield f"| {problem.name} | {problem.best:.4g} {problem.unit} | " + " | ".join(cells) + " |"


def _losses(kept: Kept) -> Iterator[str]:
    """Yield where a peer's median is lower than ours, or ours never arrives."""
    lost = []
    n_compared = 0
    for problem in kept.problems:
        for factor in FACTORS:
            ours = counts_to(kept, problem, OURS, factor)
            peer, theirs = _best_peer(kept, problem, factor)
            if not ours or not theirs:
                continue
            n_compared += 1
            if _median(theirs) < _median(ours):
                text = f"{cell(theirs)} calls against {cell(ours)}"
                lost.append(f"behind {peer} on {problem} to {factor:g} times: {text}")
            elif _median(ours) == NEVER:
                lost.append(f"no method arrives on {problem} at {factor:g} times: ours {cell(ours)}")
    if n_compared:
        yield (
            f"Where `{OURS}` loses: {len(lost)} of {n_compared} comparisons of medians with the best peer"
            + (". " + "; ".join(lost) + "." if lost else ".")
        )


def _runs_fewer(kept: Kept) -> Iterator[str]:
    """Yield which methods had how many runs and what budget."""
    parts = []
    for method in order(kept):
        counts = [len(kept.runs(problem, method)) for problem in kept.problems]
        budgets = [run.max_calls for problem in kept.problems for run in kept.runs(problem, method)]
        some = [count for count in counts if count]
        where = "" if len(some) == len(counts) else f" on {len(some)} of {len(counts)} problems"
        runs = f"{min(some)}" if min(some) == max(some) else f"{min(some)} to {max(some)}"
        budget = f"{min(budgets)}" if min(budgets) == max(budgets) else f"{min(budgets)} to {max(budgets)}"
        parts.append(f"{method} {runs} runs{where}, at most {budget} calls")
    yield "Runs per problem and budgets: " + "; ".join(parts) + "."

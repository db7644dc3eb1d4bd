"""Search phases: rounds around one simulation, until they gain too little."""

from dataclasses import dataclass, field

# A search phase owes this relative gain within so many rounds. By hand.
STALL_ROUNDS, STALL_GAIN = 10, 0.02
# The same away from the best simulation (docs/notes/adaptive-search.md, Truncated windows: restarts at every
# stagnation).
STALL_ROUNDS_AWAY, STALL_GAIN_AWAY = 5, 0.2
# Relative gain, expected and found, below which a round stagnates, in the whole trajectories and in a
# truncated window (the same section).
STAGNANT, STAGNANT_IN_WINDOW = 1e-4, 0.1
# So many in a row end a search phase, around the best simulation and away from it. By hand.
STAGNANT_ROUNDS, STAGNANT_ROUNDS_AWAY = 2, 3


@dataclass
class SearchPhase:
    """What the rounds of a phase have brought.

    Attributes:
        first: It sees the simulations from this one on; 0 where it is around the best of all.
        is_far: Whether it began near another local minimum.
        lowest: Its lowest objective after every round. [unit squared]
        n_idle: Rounds in a row that neither expected nor gained `ftol`.
        n_stagnant: Rounds in a row that neither expected nor gained what makes a round worth while.
    """

    first: int = 0
    is_far: bool = False
    lowest: list[float] = field(default_factory=list)
    n_idle: int = 0
    n_stagnant: int = 0

    def note(self, hope: float, rest: float, ftol: float, *, is_whole: bool) -> None:
        """Take note of a round.

        Args:
            hope: The larger of its expected and its found gain. [unit squared]
            rest: The objective that gains are measured against. [unit squared]
            ftol: Relative gain that is too small to go on. [1]
            is_whole: Whether whole trajectories are compared.
        """
        stagnant = max(ftol, STAGNANT if is_whole else STAGNANT_IN_WINDOW)
        self.n_idle = self.n_idle + 1 if hope <= ftol * rest else 0
        self.n_stagnant = self.n_stagnant + 1 if hope <= stagnant * rest else 0

    @property
    def has_settled(self) -> bool:
        """Whether so many rounds have stagnated that nothing more is expected around its best point."""
        return self.n_stagnant >= STAGNANT_ROUNDS

    def gains_little(self, outlying: float, *, is_at_best: bool, is_whole: bool) -> bool:
        """Return whether it stagnates or gains less than it owes.

        Args:
            outlying: Part of its lowest objective that is its largest samples'. [unit squared]
            is_at_best: Whether it is around the best simulation of all.
            is_whole: Whether whole trajectories are compared.
        """
        is_away = is_whole and not is_at_best
        if self.n_stagnant >= (STAGNANT_ROUNDS_AWAY if is_away else STAGNANT_ROUNDS):
            return True
        n, owed = (STALL_ROUNDS, STALL_GAIN) if is_at_best else (STALL_ROUNDS_AWAY, STALL_GAIN_AWAY)
        if len(self.lowest) <= n:
            return False
        return self.lowest[-1] - outlying > (1.0 - owed) * (self.lowest[-1 - n] - outlying)

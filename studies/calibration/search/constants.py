"""The constants of the adaptive search, each with where its value comes from.

"Note" names a section of docs/notes/adaptive-search.md, whose measurement chose the value. "By definition"
follows from what counts as a right answer, 1.02 times the best error. "Rounding" keeps numbers finite. "By
hand" was set once, and no measurement of its own exists.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class SearchConstants:
    """What no user sets; see `adaptive.Adaptive` for what one may.

    Attributes:
        decimals: Of the unit cube, to which points are rounded: should the last bits of the linear algebra
            differ, the rows do not, and a store finds them again. Rounding.
        margin: Part of each coordinate's range that the first design and random places leave out at both
            ends. By hand.
        caution: Part of the predictive variance that counts as error: 0 trusts the surrogate's mean. By hand.
        n_descents: Descents on the surrogate per point, the first from the best row. By hand.
        radius: First half width of the trust region in the unit cube. Note, First form (a wider one gained
            nothing).
        least_radius: Half width below which a bad step no longer shrinks it, only failures do. By hand.
        good_step, bad_step: Shares of the expected gain from and below which a step widens or shrinks the
            trust region. By hand, as is usual (Conn, Gould and Toint, 2000); wider ones: note, Two kernels.
        at_the_edge: Share of the trust region's half width from which a step lies at its edge. By hand.
        grow, shrink, shrink_after_failure: Factors of the half width. By hand.
        smallest_radius: Half width to which failures shrink it. By hand.
        stall_rounds, stall_gain: A search phase owes this relative gain within so many rounds. By hand.
        stall_rounds_away, stall_gain_away: The same away from the best row. Note, Truncated windows (restarts
            at every stagnation).
        stagnant, stagnant_in_window: Relative gain, expected and found, below which a round stagnates, in the
            whole trajectories and in a truncated window. Note, Truncated windows.
        stagnant_rounds, stagnant_rounds_away: So many in a row end a search phase, around the best row and
            away from it. By hand.
        came_back: Distance to the best row at which a restarted phase has come back. By hand.
        diverged: A row whose error is so many times that of most of the first design has diverged. By hand.
        falling, falling_rounds: A search whose best error falls by this factor within so many rounds needs no
            truncated window. Note, Truncated windows.
        exact: Share of the measured variance that an exact fit leaves at most. Note, Convergence.
        beside: Step of the differences beside an exact fit, as in studies/calibration/uncertainty/assess.py.
        vain_proposals: State equations are given up after so many proposals in a row that gained less than
            the equations erred by. By hand; an epidemic solved by Euler's method took 95 of 100 calls so.
        n_across, flat: A parameter whose error at so many values across its range varies by less than this
            part has no effect. By hand.
        n_probes: Rows that are simulated where equations may act that no row has shown.
            docs/notes/state-equations.md, Ranges that no row has shown.
        restarts_owed: Restarts without gain before a search may converge, each between two rounds of tests:
            per call, restarts gained two to three times as often as tests. Note, Convergence, later.
        restarts_owed_to_one: The same of a single parameter, whose range a few rows fill: of 80 searches with
            one none ended wrong, in 11 to 30 calls instead of 15 to 44 (medians of four problems).
        most_restarts: Restarts without gain after which a search above the misfit threshold stops anyway.
            Note, Convergence.
        confirmed: Relative gain below which earlier tests still count. By definition.
        promised, quantile: A search has converged where this quantile of the functions that tests draw
            promises at most this gain. By definition; note, Convergence, later.
        away: A restart along a valley is the surrogate's minimum within this distance of a random point.
            By hand.
        least_descents, descents_per_point, n_spread: Descents and spread points among which a restart in
            another valley is chosen. By hand.
        wanted: Such a valley is worth a restart if its error may be this part of the best. Note, When an
            error above the sensor's uncertainty ends the search.
        apart: Distance between restarts of one round. By hand.
        worth: A test is worth a call where the error may be this part of the best. By definition.
        n_independent_errors: Residuals that vary independently where an error's variance is estimated: few,
            as few directions in the box are left unknown. By hand.
        n_drawn: Functions that a round of tests draws. Note, Convergence.
        rough: Relative gain at which a descent on such a function ends. By hand.
        known: A place so near to a row is known. By hand.
        unexplained: Share of an output's measured variance above which the window is truncated. Note,
            Truncated windows.
        explained, nearly_explained: Shares below which the window is doubled, at once, and once nothing more
            is gained in it. Note, Truncated windows.
        shortest: First truncated window, as a share of the whole. Note, Truncated windows.
        n_blocks, least_block: Blocks of time of which features are taken, and the fewest samples in each.
            By hand.
        feature_weight: A share of a feature's squares counts so many times a share of the measured variance.
            By hand.
        as_good, uncertain: A point is surely no better if it is expected above this part of the best error,
            with a variance below the second part of it. By definition; by hand.
        surprise: Part of the error by which a surrogate that knows a valley's bottom does not err. Note,
            Truncated windows.
        spread, most_spread: Places may be as good whose objective is expected to be greater by this part, in
            the mean of random ones and at most. Note, Rounds of several points.
        n_places: Places among which the informative points of a round are chosen. By hand.
        failed_share, failed_weight: Expected share of failures from which a place is penalized, and the
            penalty where all fail, in objectives of the row that a step begins at. Note, Failed simulations.
        sharp, kink_apart, visible: A kink is a second difference so many times those so many samples before
            and after it, where smooth motion has similar ones, and at least the third part of the
            trajectory's standard deviation, so that rounding at rest is none. By hand.
        least_kinks: Trajectories with fewer kinks have none. By hand.
        same_kink: Another trajectory has the same kink where its own second difference, there or one sample
            beside, is at least this part of it: kinks that inputs make differ in size. By hand.
        moved: Share of kinks that another trajectory lacks, median over pairs, from which a model switches:
            0.00 to 0.09 where inputs alone drive it, 0.23 to 0.49 in thermostats. Note, Models that switch.
        n_compared: Trajectories that are compared, of parameter sets that lie apart. By hand.
    """

    decimals: int = 5
    margin: float = 0.15
    caution: float = 0.1
    n_descents: int = 3
    radius: float = 0.3
    least_radius: float = 0.05
    good_step: float = 0.5
    bad_step: float = 0.1
    at_the_edge: float = 0.9
    grow: float = 1.5
    shrink: float = 0.7
    shrink_after_failure: float = 0.5
    smallest_radius: float = 1e-4
    stall_rounds: int = 10
    stall_gain: float = 0.02
    stall_rounds_away: int = 5
    stall_gain_away: float = 0.2
    stagnant: float = 1e-4
    stagnant_in_window: float = 0.1
    stagnant_rounds: int = 2
    stagnant_rounds_away: int = 3
    came_back: float = 0.1
    diverged: float = 1e6
    falling: float = 0.5
    falling_rounds: int = 3
    exact: float = 1e-8
    beside: float = 0.01
    vain_proposals: int = 3
    n_across: int = 9
    flat: float = 1e-3
    n_probes: int = 4
    restarts_owed: int = 3
    restarts_owed_to_one: int = 1
    most_restarts: int = 8
    confirmed: float = 1e-2
    promised: float = 0.02
    quantile: float = 0.9
    away: float = 0.5
    least_descents: int = 20
    descents_per_point: int = 4
    n_spread: int = 100
    wanted: float = 0.5
    apart: float = 0.05
    worth: float = 0.98
    n_independent_errors: float = 2.0
    n_drawn: int = 16
    rough: float = 2e-3
    known: float = 0.02
    unexplained: float = 0.25
    explained: float = 0.02
    nearly_explained: float = 0.1
    shortest: float = 1.0 / 32.0
    n_blocks: int = 4
    least_block: int = 8
    feature_weight: float = 2.0
    as_good: float = 0.98
    uncertain: float = 0.1
    surprise: float = 0.1
    spread: float = 0.02
    most_spread: float = 0.06
    n_places: int = 200
    failed_share: float = 0.3
    failed_weight: float = 10.0
    sharp: float = 10.0
    kink_apart: int = 3
    visible: float = 1e-3
    least_kinks: int = 2
    same_kink: float = 0.2
    moved: float = 0.15
    n_compared: int = 8


SEARCH = SearchConstants()

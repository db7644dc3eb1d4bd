"""Which configurations are trained with further seeds once the trials of a size have ended."""

from collections import Counter

from pelsvae.config import SurrogateConfig
from studies.profile import Confirmation
from studies.results.trials import TrialView, TunedStudy
from studies.tuning import attempts


def to_confirm(found: TunedStudy, confirm: Confirmation) -> list[tuple[TrialView, int]]:
    """Return the trials whose settings are to be confirmed, and how many further seeds are missing.

    Args:
        found: all studies whose errors compare.
        confirm: how many of the best, and how many seeds.
    """
    first: dict[SurrogateConfig, TrialView] = {}
    for one in found.usable:
        if not one.spec.is_confirmation:
            first.setdefault(one.settings, one)
    chosen = [*first.values()][: confirm.top]
    if found.default is not None and found.default.settings not in [one.settings for one in chosen]:
        chosen.append(found.default)
    # Those that failed count, too: their settings would fail again.
    given = [one for one in found.trials if one.proposed_by == attempts.CONFIRMATION]
    n_given = Counter(one.settings for one in given)
    return [(one, max(0, confirm.seeds - n_given[one.settings])) for one in chosen]

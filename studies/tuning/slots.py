"""Which trial of a study may begin now, and with what: the same answer for everybody who asks.

Trial i may begin once all trials up to i - K are finished, K being the study's `n_parallel`. It knows their
results, and of the K - 1 trials between only the hyperparameters, also where some have ended. So it is a
function of the study and of trials before it, whoever trains them, in whatever order they end.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from studies.tuning.claim import Claim, is_dead, this_machine
from studies.tuning.known_good import Neighbour
from studies.tuning.search_space import SearchExhaustedError, propose
from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_record import TrialRecord
from studies.tuning.trial_store import TrialStore

MAX_CRASHES = 2  # a trial that brings its process down so often would do so for ever
MAX_LOST = 5  # nobody knows why its owner vanished: the trial is the last to be blamed


@dataclass(frozen=True)
class Slot:
    """A trial that this process may train now.

    Args:
        claim: the claim on it, with its owner.
        finished: the trials whose results it may know, in order.
    """

    claim: Claim
    finished: tuple[TrialRecord, ...]


Answer = Slot | Literal["busy", "done"]
"""A trial to train, or why there is none: others are at work, or all trials are finished."""


def take_slot(
    spec: StudySpec,
    store: TrialStore,
    *,
    n_trials: int,
    owner: dict[str, Any],
    neighbours: Callable[[], Sequence[Neighbour]] = tuple,
) -> Answer:
    """Claim the next trial of a study.

    Args:
        spec: the study.
        store: its records.
        n_trials: finished trials the study shall have in total.
        owner: who claims it, and trains no other trial now.
        neighbours: finds the finished studies of other sizes.
    """
    claimed = [(_without(claim, owner), silence_s) for claim, silence_s in store.claims()]
    answer = _look(spec, store.finished(), claimed, n_trials)
    if not isinstance(answer, int):
        return answer
    with store.lock():
        claims = {index: _without(claim, owner) for index, claim in reap(spec, store).items()}
        finished = store.records()
        known = {record.index for record in finished}
        answer = _look(spec, sorted(known), [(claim, 0.0) for claim in claims.values()], n_trials)
        if not isinstance(answer, int):
            return answer
        horizon = answer - spec.n_parallel
        visible = tuple(record for record in finished if record.index <= horizon)
        claim = claims.get(answer)
        if claim is None:
            params = {record.index: record.params for record in finished}
            params |= {index: claim.params for index, claim in claims.items()}
            beside = [params[index] for index in range(max(0, horizon + 1), answer)]
            try:
                proposal = propose(spec, answer, visible, beside, neighbours=neighbours)
            except SearchExhaustedError:
                return "busy" if any(claim.is_owned for claim in claims.values()) else "done"
            claim = Claim(
                index=answer,
                params=proposal.params,
                config=proposal.config.to_dict(),
                seed=proposal.seed,
                origin=proposal.origin,
                started_s=0.0,
                max_epochs=proposal.config.max_epochs,
            )
        claim = claim.taken(owner, time.time())
        store.put_claim(claim)
    return Slot(claim, visible)


def reap(
    spec: StudySpec,
    store: TrialStore,
    *,
    crashed: Mapping[int, str] | None = None,
    stopped: Sequence[int] = (),
) -> dict[int, Claim]:
    """Free the trials whose owners are dead; to be called by whoever holds the store's lock.

    A freed trial is tried again, with the same hyperparameters and the same seed. One that keeps bringing its
    process down is recorded as failed instead.

    Args:
        spec: the study.
        store: its records.
        crashed: how processes of this machine came to their ends, by process id.
        stopped: processes of this machine that were told to stop.

    Returns:
        The claims that are left, by index.
    """
    left = {}
    for claim, silence_s in store.claims():
        pid = claim.owner.get("pid") if claim.owner.get("machine") == this_machine() else None
        crash = (crashed or {}).get(pid or 0, "")
        if not claim.is_owned or not (crash or pid in stopped or is_dead(claim.owner, silence_s)):
            left[claim.index] = claim
            continue
        freed = claim.released(crash=crash, lost=not crash and pid not in stopped)
        reason = ""
        if freed.n_crashes >= MAX_CRASHES:
            reason = f"its process ended {'twice' if freed.n_crashes == 2 else 'often'} ({freed.crash})"
        elif freed.n_lost >= MAX_LOST:
            reason = f"its command or machine died {freed.n_lost} times"
        if reason:
            store.write(_failure(spec, claim, reason), {})
        else:
            store.put_claim(freed)
            left[claim.index] = freed
    return left


def release(store: TrialStore, claim: Claim) -> None:
    """Give a trial back that this process was told to stop, unless somebody has taken it over."""
    with store.lock():
        if any(other.token == claim.token for other, _ in store.claims()):
            store.put_claim(claim.released())


def _look(
    spec: StudySpec, finished: Sequence[int], claims: Sequence[tuple[Claim, float]], n_trials: int
) -> int | Literal["busy", "done"]:
    """Return the next trial that nobody works on, "busy" where it may not begin yet."""
    known = set(finished)
    alive = {claim.index for claim, silence in claims if claim.is_owned and not is_dead(claim.owner, silence)}
    missing = [index for index in range(n_trials) if index not in known]
    if not missing:
        return "done"
    free = next((index for index in missing if index not in alive), None)
    return "busy" if free is None or missing[0] <= free - spec.n_parallel else free


def _without(claim: Claim, owner: Mapping[str, Any]) -> Claim:
    """Free a claim of somebody who asks for a trial: the answer to an earlier question has not reached it."""
    return replace(claim, owner={}, token="") if claim.owner == owner else claim


def _failure(spec: StudySpec, claim: Claim, reason: str) -> TrialRecord:
    return TrialRecord(
        study=spec.name,
        n_train=spec.n_train,
        index=claim.index,
        state="failed",
        reason=reason,
        params=claim.params,
        config=claim.config,
        seed=claim.seed,
        started_s=claim.started_s,
        wall_s=max(0.0, time.time() - claim.started_s),
        digests=spec.digests,
        owner=claim.owner,
        origin=claim.origin,
        attempts=claim.attempt,
    )

"""The best trials where two errors are minimized: those that no other trial beats in both."""

from collections.abc import Sequence

from studies.tuning.trial_record import TrialRecord


def pareto_front(records: Sequence[TrialRecord], objectives: Sequence[str]) -> list[TrialRecord]:
    """Return the completed trials that no other one equals in all errors and beats in one.

    Args:
        records: trials of a study.
        objectives: names of the errors.

    Returns:
        The front by ascending first error; its first trial is the champion where that is the MAE.
    """

    def errors(record: TrialRecord) -> tuple[float, ...]:
        return tuple(record.metrics[name] for name in objectives)

    front: list[TrialRecord] = []
    complete = [record for record in records if record.state == "complete"]
    for record in sorted(complete, key=lambda record: (*errors(record), record.index)):
        mine = errors(record)
        if not any(all(a <= b for a, b in zip(errors(other), mine, strict=True)) for other in front):
            front.append(record)
    return front

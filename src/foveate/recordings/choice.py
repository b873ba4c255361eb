"""Choose one of several trained policies by a part of a recording that does not judge it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from foveate.experiment.resolve import Subject
from foveate.io.progress import logger
from foveate.recordings.measures import ReplayRow


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """Means of a policy over the starts on the part to choose on: share of time in view, log det [nat]."""

    run: str
    seen_time_fraction: float
    log_det_mean: float


def best_of(
    subjects: Sequence[Subject], rows: Mapping[str, Sequence[ReplayRow]]
) -> tuple[Subject, tuple[Candidate, ...]]:
    """The subject with the most of what the first was trained for, and the means of all; says which, and why.

    That is the time in view for the objective "seen", the log det of the beliefs for others. `rows` are by name.
    """
    found = tuple(
        Candidate(
            run=name,
            seen_time_fraction=float(np.mean([row.seen_time_fraction for row in ours])),
            log_det_mean=float(np.mean(np.array([row.log_det_mean for row in ours], float))),
        )
        for name, ours in rows.items()
    )
    by_view = subjects[0].objective in ("seen", None)
    values = [each.seen_time_fraction if by_view else each.log_det_mean for each in found]
    best = found[int(np.argmax(values))].run
    measure = "in view" if by_view else "log det [nat]"
    listed = ", ".join(f"{each.run} {v:{'.1%' if by_view else '.2f'}}" for each, v in zip(found, values, strict=True))
    logger.info(f"chosen: {best}; {measure} on the part to choose on: {listed}")
    return next(subject for subject in subjects if subject.name == best), found

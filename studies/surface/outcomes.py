"""Outcomes of the study's registrations, read back from its sums."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ronna_hw.arrays import Array, Mask
from studies.campaign import bounds
from studies.campaign.bounds import Bounded
from studies.campaign.study import Sums
from studies.surface.conditions import SHIFTED
from studies.surface.study import CHANGED, DRAWN, ERROR, LIMIT, REFUSED, RMS

ROWS = (ERROR, RMS, LIMIT, DRAWN)
FEWEST_FOR_CORRELATION = 10


@dataclass(frozen=True)
class Outcome:
    """One registration: its conditions, the code of a refusal, and per target what came of it.

    `targets` has rows of error, predicted rms, predicted limit, and an error drawn from the prediction, in
    mm; `depths` names each row's depth.
    """

    coverage: str
    skin: str
    head: int
    values: Mapping[str, float]
    refusal: str | None
    targets: Array = field(repr=False)
    depths: tuple[str, ...]

    @property
    def is_within(self) -> Mask:
        """Whether each target's error is within its limit."""
        return np.asarray(self.targets[:, 0] <= self.targets[:, 2])

    def at_depth(self, depth: str) -> Outcome:
        """Return the outcome at the targets of one depth."""
        rows = [number for number, one in enumerate(self.depths) if one == depth]
        return Outcome(
            self.coverage,
            self.skin,
            self.head,
            self.values,
            self.refusal,
            self.targets[rows],
            tuple(self.depths[row] for row in rows),
        )


def read_outcomes(sums: Mapping[str, Sums]) -> list[Outcome]:
    """Return all outcomes, in the order of conditions and heads."""
    found: list[Outcome] = []
    for condition, content in sums.items():
        by_head: dict[int, dict[str, float]] = defaultdict(dict)
        for key, value in content.items():
            head, name = key.split("|", 1)
            by_head[int(head)][name] = value
        coverage, _, skin = condition.partition("|")
        found += [
            _read(coverage, skin or SHIFTED, number, values) for number, values in sorted(by_head.items())
        ]
    return found


def _read(coverage: str, skin: str, head: int, values: Mapping[str, float]) -> Outcome:
    refusals = [name.partition("|")[2] for name in values if name.startswith(f"{REFUSED}|")]
    places = [name.rpartition("|")[0] for name in values if name.endswith(f"|{ERROR}")]
    targets = [[values[f"{place}|{what}"] for what in ROWS] for place in places]
    alone = {name: value for name, value in values.items() if "|" not in name or name == CHANGED}
    return Outcome(
        coverage,
        skin,
        head,
        alone,
        refusals[0] if refusals else None,
        np.array(targets).reshape(-1, len(ROWS)),
        tuple(place.partition("|")[0] for place in places),
    )


def accepted(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Return the outcomes that were not refused."""
    return [one for one in outcomes if one.refusal is None]


def targets_of(outcomes: Sequence[Outcome]) -> Array:
    """Return the rows of all targets, as `Outcome` has them."""
    return np.concatenate([np.zeros((0, len(ROWS))), *(one.targets for one in outcomes)])


def refused_share(outcomes: Sequence[Outcome]) -> Bounded:
    """Return the percentage of registrations that were refused."""
    return bounds.percent(len(outcomes) - len(accepted(outcomes)), len(outcomes))


def share_within(outcomes: Sequence[Outcome]) -> Bounded | None:
    """Return the percentage of targets within their limits; the targets of a head depend on each other."""
    by_head: dict[int, list[Mask]] = defaultdict(list)
    for one in accepted(outcomes):
        by_head[one.head].append(one.is_within)
    within = [np.concatenate(each) for each in by_head.values()]
    counted = np.array([float(each.sum()) for each in within])
    of = np.array([float(len(each)) for each in within])
    return bounds.share_by_group(
        float(counted.sum()),
        float(of.sum()),
        float(counted @ counted),
        float(counted @ of),
        float(of @ of),
        len(within),
    )


def correlation_squared(outcomes: Sequence[Outcome], of: str = ERROR) -> float | None:
    """Return R² of the errors, or of those drawn from the predictions, by the predicted rms.

    That of the drawn errors is what a prediction reaches that is right each time: an error is a draw.
    """
    targets = targets_of(outcomes)
    if len(targets) < FEWEST_FOR_CORRELATION:
        return None
    return bounds.correlation(targets[:, ROWS.index(of)], targets[:, ROWS.index(RMS)]).value ** 2

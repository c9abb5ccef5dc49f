"""Health of the robot's real-time link, as a step leaves it in its record before the link is ended."""

from __future__ import annotations

import itertools
from dataclasses import asdict
from typing import Self

from pydantic import Field, NonNegativeFloat, NonNegativeInt, model_validator

from procedures.engine.context import StepContext
from procedures.journal.results import Values


class LinkHealth(Values):
    """Counters, turnaround and jitter since the arm was last activated. Times are host time."""

    lock_step: bool = Field(description="Theatre time stood still between telegrams: not a real-time figure.")
    cycles: int = Field(description="Telegrams that were answered.")
    late_cycles: int = Field(description="Replies that came too late, according to the controller.")
    lost_cycles: int = Field(description="Cycles missing from the telegram counter.")
    rejected_telegrams: int = Field(description="Telegrams that were not understood.")
    foreign_telegrams: int = Field(description="Telegrams from another sender.")
    turnaround_median_us: float = Field(description="From telegram to reply.")
    turnaround_p99_us: float = Field(description="99 % within.")
    jitter_median_us: float = Field(description="Of a telegram from its place in the controller's pace.")
    jitter_p99_us: float = Field(description="99 % within.")
    histogram_edges_us: tuple[NonNegativeFloat, ...] = Field(description="Of both histograms.")
    histogram_counts: tuple[NonNegativeInt, ...] = Field(description="Of the turnaround.")
    jitter_counts: tuple[NonNegativeInt, ...] = Field(description="Of the jitter.")

    @model_validator(mode="after")
    def _bins_have_counts(self) -> Self:
        edges, bins = self.histogram_edges_us, max(0, len(self.histogram_edges_us) - 1)
        if len(self.histogram_counts) != bins or len(self.jitter_counts) not in (0, bins):
            raise ValueError(f"expected {bins} counts of turnaround, and as many or none of jitter")
        if any(low >= high for low, high in itertools.pairwise(edges)):
            raise ValueError("the edges of the histograms do not ascend")
        return self


def link_health(context: StepContext) -> LinkHealth:
    """Read it; right before the stream is ended."""
    statistics = asdict(context.workcell.link_statistics())
    fields = {name: value for name, value in statistics.items() if name in LinkHealth.model_fields}
    return LinkHealth(lock_step=not context.setting.clock.paced, **fields)

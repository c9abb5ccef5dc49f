"""Health of the robot's real-time link, as a step leaves it in its record before the link is ended."""

from __future__ import annotations

from dataclasses import asdict

from pydantic import Field

from procedures.engine.context import StepContext
from procedures.results.result import Values


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
    histogram_edges_us: tuple[float, ...] = Field(description="Of both histograms.")
    histogram_counts: tuple[int, ...] = Field(description="Of the turnaround.")
    jitter_counts: tuple[int, ...] = Field(description="Of the jitter.")


def link_health(context: StepContext) -> LinkHealth:
    """Read it; right before the stream is ended."""
    statistics = asdict(context.workcell.link_statistics())
    fields = {name: value for name, value in statistics.items() if name in LinkHealth.model_fields}
    return LinkHealth(lock_step=not context.setting.clock.paced, **fields)

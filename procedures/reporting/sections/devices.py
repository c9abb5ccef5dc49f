"""Devices, calibrations and tools of the run, and the health of the links."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from procedures.engine.case import Stored
from procedures.reporting.pictures import LinkBin, link_figure, sum_histograms
from procedures.reporting.run_reading import RunReading
from procedures.reporting.run_statistics import DeviceCounters, link_counters
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import ConfirmedTarget, LinkHealth
from procedures.steps.clinical.retreat import Retreated
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.clinical.tool_change import MountedGuide
from procedures.steps.clinical.tool_check import CheckedTool


class StreamHealth(NamedTuple):
    """Health of an arm's link over one stream, with what the arm carried."""

    carried: str
    link: LinkHealth


@dataclass(frozen=True)
class Devices:
    """Devices, records and tools as found at set-up, and the links over the whole run."""

    set_up: CheckedSetUp | None
    planned_tool: str  # empty without a plan
    tools: tuple[Stored[MountedGuide], ...]
    tool_checks: tuple[Stored[CheckedTool], ...]
    links: tuple[StreamHealth, ...]
    link_bins: tuple[LinkBin, ...]
    link_picture: str  # SVG; empty without bins
    tracked: GlobalLocalization | None
    counters: tuple[DeviceCounters, ...]

    @property
    def lock_step(self) -> bool:
        """Whether theatre time stood still between telegrams in any stream."""
        return any(one.link.lock_step for one in self.links)


def read_devices(reading: RunReading) -> Devices:
    """Read the section."""
    links = _read_links(reading)
    bins = sum_histograms([one.link for one in links])
    plan = reading.find(CheckedPlan)
    return Devices(
        set_up=reading.find(CheckedSetUp),
        planned_tool="" if plan is None else plan.plan.tool,
        tools=reading.valid_results(MountedGuide),
        tool_checks=reading.valid_results(CheckedTool),
        links=links,
        link_bins=bins,
        link_picture=link_figure(bins) if bins else "",
        tracked=reading.find(GlobalLocalization),
        counters=link_counters(reading.log),
    )


def _read_links(reading: RunReading) -> tuple[StreamHealth, ...]:
    """Return the health of each stream that a step ended, those of the assistant last."""
    heads = [one.result for one in reading.valid_results(MountedGuide)]
    ends: list[Retreated | ConfirmedTarget] = [one.result for one in reading.valid_results(Retreated)]
    ends += [one.result for one in reading.valid_results(ConfirmedTarget)]
    links: list[tuple[str, LinkHealth | None]] = [("stereo head", one.link) for one in heads]
    links += [("guide", one.link) for one in ends]
    links += [("holder of the assistant", one.assistant_link) for one in heads]
    links += [("holder of the assistant", one.assistant_link) for one in ends]
    return tuple(StreamHealth(name, link) for name, link in links if link is not None)

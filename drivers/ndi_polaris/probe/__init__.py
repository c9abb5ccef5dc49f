"""Diagnoses a tracker that does not answer: checks its line, then connects as a procedure would."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.ndi_polaris.driver import PolarisTracker
from drivers.ndi_polaris.probe.diagnosis import line_diagnostic
from drivers.ndi_polaris.probe.line import look_at_line
from drivers.ndi_polaris.probe.tracker_discovery import example_tracker, find_trackers
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.probing import (
    Diagnostic,
    Inspection,
    Progress,
    Proposal,
    Search,
    connect_and_leave,
    endpoints_of,
    leave_alone,
)
from ronna_hw.endpoints import Endpoint

LINE_SHARE = 0.5  # of the whole probe; the rest is for connecting


class PolarisProbe:
    """The probe of this driver; its `look_at` also serves bare endpoints, its `find` a new theatre file."""

    endpoint_schemes = frozenset({"serial", "tcp"})
    table = "tracker"

    def __call__(
        self, name: str, config: DeviceConfig, progress: Progress, inspect: Inspection = leave_alone
    ) -> Sequence[Diagnostic]:
        lines = [each for each in endpoints_of(config) if each.scheme in self.endpoint_schemes]
        diagnostics = _looked_at(lines, lambda share: progress(LINE_SHARE * share), of_tracker=True)
        advice = next((diagnostic.advice for diagnostic in diagnostics if not diagnostic.well), "")
        return (*diagnostics, *connect_and_leave(name, config, PolarisTracker, advice, inspect))

    def look_at(self, endpoints: Sequence[Endpoint], progress: Progress) -> Sequence[Diagnostic]:
        return _looked_at(endpoints, progress, of_tracker=False)

    def find(self, search: Search, progress: Progress) -> Sequence[Proposal]:
        return find_trackers(search, progress)

    def example(self, search: Search) -> Proposal:
        return example_tracker()


probe = PolarisProbe()


def _looked_at(endpoints: Sequence[Endpoint], progress: Progress, *, of_tracker: bool) -> list[Diagnostic]:
    diagnostics: list[Diagnostic] = []
    for endpoint in endpoints:
        diagnostics.append(line_diagnostic(look_at_line(endpoint), of_tracker=of_tracker))
        progress(len(diagnostics) / len(endpoints))
    return diagnostics

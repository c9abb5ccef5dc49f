"""Finds out why a tracker does not answer: looks at its line, then connects as a procedure would."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.ndi_polaris.driver import PolarisTracker
from drivers.ndi_polaris.probe.diagnosis import line_finding
from drivers.ndi_polaris.probe.line import look_at_line
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.probing import Finding, Progress, connect_and_leave, endpoints_of
from ronna_hw.endpoints import Endpoint

LINE_SHARE = 0.5  # of the whole probe; the rest is connecting


class PolarisProbe:
    """The probe of this driver; its `look_at` also serves bare endpoints."""

    endpoint_schemes = frozenset({"serial", "tcp"})

    def __call__(self, name: str, config: DeviceConfig, progress: Progress) -> Sequence[Finding]:
        lines = [each for each in endpoints_of(config) if each.scheme in self.endpoint_schemes]
        findings = self.look_at(lines, lambda share: progress(LINE_SHARE * share))
        advice = next((finding.advice for finding in findings if not finding.well), "")
        return (*findings, connect_and_leave(name, config, PolarisTracker, advice))

    def look_at(self, endpoints: Sequence[Endpoint], progress: Progress) -> Sequence[Finding]:
        findings = []
        for endpoint in endpoints:
            findings.append(line_finding(look_at_line(endpoint)))
            progress(len(findings) / len(endpoints))
        return findings


probe = PolarisProbe()

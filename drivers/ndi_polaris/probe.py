"""Diagnosis of an unresponsive tracker and search for trackers on local lines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, get_args

from drivers.ndi_polaris.driver import PolarisTracker
from drivers.ndi_polaris.line_check import LineOpening, check_line, line_diagnostic
from drivers.ndi_polaris.options import PolarisOptions
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.probing import (
    CONNECT_LIMIT_S,
    ONLY,
    Diagnostic,
    Inspection,
    Option,
    Progress,
    Proposal,
    Search,
    connect_and_identify,
    describe_options,
    endpoints_of,
    inspect_nothing,
    reporting,
)
from ronna_hw.endpoints import Endpoint
from ronna_hw.errors import RonnaError

DRIVER = "ndi_polaris"
EXAMPLE_LINE = "serial:///dev/ttyUSB0"
# Drawn for the published type of frame; a lab's own definition has its own distances.
FRAME = {"name": "robot_frame", "rom": "robot_frame.rom"}
TOOLS = (
    "tools: give the definition of the frame on your mount; the one entered here is shipped with the driver. "
    "ronna-rom compare shows the distances of two definitions.",
)
LINE_SHARE = 0.5  # of the whole probe; the rest is for connecting


class PolarisProbe:
    """Diagnosis and discovery for the Polaris driver."""

    endpoint_schemes = frozenset({"serial", "tcp"})
    table = "tracker"

    def __call__(
        self, name: str, config: DeviceConfig, progress: Progress, inspect: Inspection = inspect_nothing
    ) -> Sequence[Diagnostic]:
        lines = [each for each in endpoints_of(config) if each.scheme in self.endpoint_schemes]
        diagnostics = _diagnose_lines(lines, lambda share: progress(LINE_SHARE * share), of_tracker=True)
        advice = next((diagnostic.advice for diagnostic in diagnostics if not diagnostic.well), "")
        return (*diagnostics, *connect_and_identify(name, config, PolarisTracker, advice, inspect))

    def probe_endpoints(self, endpoints: Sequence[Endpoint], progress: Progress) -> Sequence[Diagnostic]:
        return _diagnose_lines(endpoints, progress, of_tracker=False)

    def find(self, search: Search, progress: Progress) -> Sequence[Proposal]:
        """Propose every line with a responding unit, and report missing lines.

        A unit is identified as a procedure would identify it.
        """
        found = []
        for line in reporting(search.lines, progress):
            state = check_line(line)
            if state.answered_attempt is not None:
                found.append(_make_proposal(line))
            elif state.opening is LineOpening.MISSING:
                found.append(_missing_proposal(line))
        return found

    def example(self, search: Search) -> Proposal:
        return Proposal(DRIVER, "", {ONLY: EXAMPLE_LINE}, _options({}), TOOLS)


probe = PolarisProbe()


def _diagnose_lines(
    endpoints: Sequence[Endpoint], progress: Progress, *, of_tracker: bool
) -> list[Diagnostic]:
    return [
        line_diagnostic(check_line(endpoint), of_tracker=of_tracker)
        for endpoint in reporting(endpoints, progress)
    ]


def _make_proposal(line: Endpoint) -> Proposal:
    tracker = PolarisTracker("tracker", DeviceConfig(driver=DRIVER, endpoint=str(line)), HostClock())
    try:
        identity = tracker.connect(CONNECT_LIMIT_S)
    except RonnaError as error:
        remark = f"It answers, but could not be identified: {error.code} {error.summary}"
        return Proposal(DRIVER, "a unit", {ONLY: str(line)}, _options({}), (remark, *TOOLS))
    finally:
        tracker.close()
    known = get_args(get_args(PolarisOptions.model_fields["expected_model"].annotation)[0])
    model = next((name for name in known if name in identity.model.lower()), None)
    chosen = {"expected_model": model} if model else {}
    if identity.serial:
        chosen["expected_serial"] = identity.serial
    what = f"{identity.model} {identity.serial} {identity.firmware}".strip()
    return Proposal(DRIVER, what, {ONLY: str(line)}, _options(chosen), TOOLS)


def _missing_proposal(line: Endpoint) -> Proposal:
    from serial.tools import list_ports

    ports = ", ".join(sorted(str(port.device) for port in list_ports.comports()))
    absent = f"{line.path} does not exist; the serial ports of this computer: {ports or 'none'}"
    return Proposal(DRIVER, "", {ONLY: str(line)}, _options({}), TOOLS, absent)


def _options(chosen: dict[str, Any]) -> tuple[Option, ...]:
    return describe_options(PolarisOptions, {"tools": [FRAME], **chosen})

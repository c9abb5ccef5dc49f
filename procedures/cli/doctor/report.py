"""Runs the checks of the computer and the probes of the drivers, and shows what they found."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from procedures.cli.doctor.computer import computer_findings
from ronna_hw.command_line.console import Progress, print_json, print_table
from ronna_hw.config import DeviceConfig, read_theatre_file
from ronna_hw.devices.probing import Finding
from ronna_hw.endpoints import BadEndpoint, Endpoint, parse_endpoint
from ronna_hw.errors import EXIT_NOT_FOUND, RonnaError
from ronna_hw.registry import endpoint_probes, load_probe

SECTIONS = ("lines", "cameras")  # of the JSON, also when they are empty

Look = Callable[[Progress], Sequence[Finding]]


@dataclass(frozen=True)
class Report:
    """What was found on the computer, and at the devices."""

    computer: tuple[Finding, ...]
    devices: tuple[Finding, ...]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Everything, in the order in which it is shown."""
        return self.computer + self.devices

    def section(self, name: str) -> list[Mapping[str, Any]]:
        """The documents of one section."""
        return [f.document for f in self.devices if f.section == name and f.document is not None]


def examine(
    config: Path | None, endpoints: Sequence[str] = (), progress: Progress = lambda share: None
) -> Report:
    """Look at the computer, at each endpoint, and at every device of a theatre file.

    Raises CFG-001 for a bad theatre file, CFG-002 for an endpoint that no probe can look at.
    """
    looks = [*_looks_at_endpoints(endpoints)]
    if config is not None:
        looks += [partial(_probe, name, device) for name, device in read_theatre_file(config).devices.items()]
    computer = tuple(computer_findings())
    found: list[Finding] = []
    for number, look in enumerate(looks):
        found += look(partial(_advance, progress, number, len(looks)))
        progress((number + 1) / len(looks))
    return Report(computer, tuple(found))


def show(report: Report, *, as_json: bool) -> None:
    """Print the findings; ends with exit code 4 when a device or an endpoint has a problem."""
    if as_json:
        sections = dict.fromkeys((*SECTIONS, *(f.section for f in report.devices if f.section)))
        print_json(
            {
                "findings": [
                    {"subject": f.subject, "well": f.well, "seen": f.seen, "advice": f.advice}
                    for f in report.findings
                ]
            }
            | {name: report.section(name) for name in sections}
        )
    else:
        print_table(
            "Doctor",
            ("checked", "", "found", "what to do"),
            [(f.subject, "ok" if f.well else "PROBLEM", f.seen, f.advice) for f in report.findings],
        )
    if not all(finding.well for finding in report.devices):
        raise SystemExit(EXIT_NOT_FOUND)


def _looks_at_endpoints(texts: Sequence[str]) -> Iterator[Look]:
    """One look for each probe that is asked for, with all its endpoints."""
    if not texts:
        return
    probes = endpoint_probes()
    schemes = sorted({scheme for probe in probes.values() for scheme in probe.endpoint_schemes})
    asked: dict[str, list[Endpoint]] = {}
    for endpoint in map(parse_endpoint, texts):
        endpoint.require(*schemes)
        drivers = [name for name, probe in probes.items() if endpoint.scheme in probe.endpoint_schemes]
        if len(drivers) > 1:
            raise BadEndpoint(
                f"{endpoint}: {' and '.join(drivers)} can look at this kind of endpoint",
                action="Name the driver in a theatre file, and use --config.",
            )
        asked.setdefault(drivers[0], []).append(endpoint)
    for driver, endpoints in asked.items():
        yield partial(probes[driver].look_at, endpoints)


def _probe(name: str, config: DeviceConfig, progress: Progress) -> Sequence[Finding]:
    """What the driver's probe finds. One that fails is a finding too: the other devices still follow."""
    try:
        return load_probe(config.driver)(name, config, progress)
    except RonnaError as error:
        return (Finding(f"device {name}", False, f"{error.code} {error.what}", error.advice),)


def _advance(progress: Progress, number: int, looks: int, share: float) -> None:
    progress((number + share) / looks)

"""The doctor's report: running computer checks and driver probes, deriving verdicts, printing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from procedures.cli.doctor.calibrations import calibration_diagnostics, setting_diagnostics, tool_diagnostics
from procedures.cli.doctor.inspection import advise_on_serials, inspection
from procedures.cli.doctor.theatre_checks import (
    CLOCK,
    INSTRUMENT,
    NEEDED,
    RUN,
    RUNS,
    advise_on_unfinished_run,
    case_diagnostics,
    computer_diagnostics,
    use_diagnostics,
)
from procedures.runs.theatre_lock import require_free_theatre
from ronna_hw.command_line.errors import as_ronna_error
from ronna_hw.command_line.options import log_failure
from ronna_hw.command_line.terminal import Progress, print_json, print_table
from ronna_hw.config import DeviceConfig, TheatreFile, read_theatre_file
from ronna_hw.devices.probing import Diagnostic, endpoints_of, refusal
from ronna_hw.endpoints import BadEndpoint, Endpoint, parse_endpoint
from ronna_hw.errors import EXIT_NOT_FOUND, EXIT_REFUSED
from ronna_hw.registry import endpoint_probes, load_probe

CASE = "case"
STEREO = "stereo"  # the table of the cameras
SECTIONS = ("lines", "cameras")  # of the JSON, also when they are empty
Examination = Callable[[Progress], Sequence[Diagnostic]]


@dataclass(frozen=True)
class Verdict:
    """Verdict on a device or case; `because` lists the failed checks in display order."""

    of: str
    ready: bool
    because: tuple[str, ...]


def verdicts(case: Sequence[Diagnostic], devices: Mapping[str, Sequence[Diagnostic]]) -> Iterator[Verdict]:
    """Yield a verdict for each device table of the theatre file, then one for the case."""
    for name, found in devices.items():
        yield _verdict(name, found)
    needed = [one for name in NEEDED for one in devices.get(name, ())]
    yield _verdict(CASE, [*case, *needed])


def _verdict(of: str, found: Sequence[Diagnostic]) -> Verdict:
    because = tuple(f"{one.subject.removeprefix(f'{of}: ')}: {one.seen}" for one in found if not one.well)
    return Verdict(of, not because, because)


@dataclass(frozen=True)
class Report:
    """Diagnostics of the computer, the theatre file and its records, and the devices."""

    computer: tuple[Diagnostic, ...]
    devices: tuple[Diagnostic, ...]
    calibrations: tuple[Diagnostic, ...] = ()
    case: tuple[Diagnostic, ...] = ()  # what else a case needs of theatre file and computer
    verdicts: tuple[Verdict, ...] = ()  # of each device of the theatre, then of the case

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """All diagnostics in display order; an instrument left in the head comes first."""
        everything = self.computer + self.case + self.calibrations + self.devices
        return tuple(sorted(everything, key=lambda one: one.subject != INSTRUMENT))

    def section(self, name: str) -> list[Mapping[str, Any]]:
        """Return the diagnostics of one section as plain documents."""
        return [f.document for f in self.devices if f.section == name and f.document is not None]


def examine(
    config: Path | None,
    endpoints: Sequence[str] = (),
    progress: Progress = lambda share: None,
    *,
    out: Path = RUNS,
) -> Report:
    """Check this computer, each endpoint and every device in a theatre file, for runs in `out`.

    Raises CFG-001 for a bad theatre file, CFG-002 for an endpoint that no probe can look at, PRO-043 for one
    of a theatre that a run uses.
    """
    parsed = [parse_endpoint(text) for text in endpoints]
    examinations: dict[str, Examination] = dict(_endpoint_examinations(parsed))
    calibrations: tuple[Diagnostic, ...] = ()
    case: tuple[Diagnostic, ...] = ()
    devices: list[str] = []
    if config is not None:
        file = read_theatre_file(config)
        now = datetime.now(UTC)
        calibrations = (
            *calibration_diagnostics(file, config, now),
            *tool_diagnostics(file, now),
            *setting_diagnostics(file),
        )
        case = (*use_diagnostics(config), *case_diagnostics(file, out))
        if any(one in endpoints_of(device) for device in file.devices.values() for one in parsed):
            require_free_theatre(config)
        if all(one.subject != RUN for one in case):
            devices = list(file.devices)
            for name, device in file.devices.items():
                examinations[name] = partial(_probe, name, device, file)
    computer = tuple(computer_diagnostics())
    found: dict[str, Sequence[Diagnostic]] = {}
    for number, (name, examination) in enumerate(examinations.items()):

        def advance(share: float, before: int = number) -> None:
            progress((before + share) / len(examinations))

        found[name] = examination(advance)
        if config is not None and name in devices:
            found[name] = advise_on_unfinished_run(config, found[name])
        advance(1.0)
    of_devices = {name: found[name] for name in devices}
    case_verdicts = () if config is None else tuple(verdicts(case + calibrations, of_devices))
    return Report(
        computer, tuple(one for each in found.values() for one in each), calibrations, case, case_verdicts
    )


def show(report: Report, *, as_json: bool) -> None:
    """Print the diagnostics, then exit with an error code if a check failed.

    The code is 4 for a problem with a device, endpoint or calibration, or if the theatre is in use or its
    clock cannot be read; it is 3 if only something else prevents a case.
    """
    show_findings(report, as_json=as_json)
    in_use = tuple(one for one in report.case if one.subject in (RUN, CLOCK))
    if not all(diagnostic.well for diagnostic in in_use + report.calibrations + report.devices):
        raise SystemExit(EXIT_NOT_FOUND)
    if not all(verdict.ready for verdict in report.verdicts if verdict.of == CASE):
        raise SystemExit(EXIT_REFUSED)


def show_findings(report: Report, *, as_json: bool) -> None:
    """Print the diagnostics and any verdicts."""
    if as_json:
        sections = dict.fromkeys((*SECTIONS, *(f.section for f in report.devices if f.section)))
        print_json(
            {
                "findings": [
                    {"subject": f.subject, "well": f.well, "seen": f.seen, "advice": f.advice}
                    for f in report.diagnostics
                ]
            }
            | {name: report.section(name) for name in sections}
            | {"verdicts": [asdict(verdict) for verdict in report.verdicts]}
        )
    else:
        print_table(
            "Doctor",
            ("checked", "", "found", "what to do"),
            [(f.subject, "ok" if f.well else "PROBLEM", f.seen, f.advice) for f in report.diagnostics],
        )
        if report.verdicts:
            print_table(
                "Readiness",
                ("", "", "because"),
                [
                    (one.of, "ready" if one.ready else "NOT READY", "; ".join(_reasons(one, report)))
                    for one in report.verdicts
                ],
            )


def _reasons(verdict: Verdict, report: Report) -> Sequence[str]:
    """Return the reasons for a verdict; for a case, only the subjects of the failed checks."""
    if verdict.of != CASE:
        return verdict.because
    failed = (one.subject for one in report.diagnostics if f"{one.subject}: {one.seen}" in verdict.because)
    return tuple(dict.fromkeys(failed))


def _endpoint_examinations(endpoints: Sequence[Endpoint]) -> Iterator[tuple[str, Examination]]:
    """Yield one examination per driver probe, covering all requested endpoints it supports."""
    if not endpoints:
        return
    probes = endpoint_probes()
    schemes = sorted({scheme for probe in probes.values() for scheme in probe.endpoint_schemes})
    by_driver: dict[str, list[Endpoint]] = {}
    for endpoint in endpoints:
        endpoint.require(*schemes)
        drivers = [name for name, probe in probes.items() if endpoint.scheme in probe.endpoint_schemes]
        if len(drivers) > 1:
            raise BadEndpoint(
                f"{endpoint}: {' and '.join(drivers)} can check this kind of endpoint",
                action="Name the driver in a theatre file, and use --config.",
            )
        by_driver.setdefault(drivers[0], []).append(endpoint)
    for driver, driver_endpoints in by_driver.items():
        yield f"endpoints of {driver}", partial(probes[driver].probe_endpoints, driver_endpoints)


def _probe(name: str, config: DeviceConfig, theatre: TheatreFile, progress: Progress) -> Sequence[Diagnostic]:
    """Return the diagnostics from a driver's probe. A failed probe is itself a diagnostic."""
    try:
        found = load_probe(config.driver)(name, config, progress, inspection(name, theatre))
    except Exception as problem:  # a driver of another package may raise anything
        error = as_ronna_error(problem)
        log_failure(problem, error)
        return (refusal(f"device {name}", error),)
    if name != STEREO or theatre.calibration is None:
        return found
    return advise_on_serials(found, config, theatre.calibration.stereo_head)

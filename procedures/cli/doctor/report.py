"""The doctor's report: running computer checks and driver probes, deriving verdicts, printing."""

from __future__ import annotations

import shlex
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import partial
from itertools import chain
from pathlib import Path
from textwrap import wrap
from typing import Any

from procedures.cli.doctor import theatre_checks
from procedures.cli.doctor.calibrations import (
    calibration_diagnostics,
    history_diagnostics,
    setting_diagnostics,
    tool_diagnostics,
)
from procedures.cli.doctor.inspection import (
    STEREO,
    advise_on_serials,
    frame_diagnostics,
    inspection,
    two_arm_diagnostics,
)
from procedures.runs.arm_notes import list_noted_theatres
from procedures.runs.theatre_lock import require_free_theatre
from ronna_hw.clock import HostClock
from ronna_hw.command_line.errors import as_ronna_error
from ronna_hw.command_line.options import log_failure
from ronna_hw.command_line.terminal import Progress, on_terminal, print_json, print_table, say
from ronna_hw.config import ARM_RECORDS, Calibrations, DeviceConfig, TheatreFile, read_theatre_file
from ronna_hw.devices import OpticalTracker
from ronna_hw.devices.probing import Diagnostic, EndpointProbe, PortProbe, endpoints_of, refusal
from ronna_hw.endpoints import BadEndpoint, Endpoint, parse_endpoint
from ronna_hw.errors import EXIT_NOT_FOUND, EXIT_REFUSED, RonnaError
from ronna_hw.registry import endpoint_probes, load_probe, make_device
from ronna_hw.roles import MASTER
from ronna_hw.text import format_count

# Of arms beside the master, which only a case with several arms needs.
OTHERS = [role for role in ARM_RECORDS if role != MASTER]
RECORDS_OF_OTHERS = tuple(f"calibration {name}" for role in OTHERS for name in ARM_RECORDS[role])
CASE, TWO_ARM_CASE = "case", "case with two arms"
TRACKER = "tracker"  # table
PROBLEM, NOTE, OK = "PROBLEM", "note", "ok"
FRAMES = ": frames named in records"
FINDING = ("subject", "well", "seen", "advice", "command")  # fields of the JSON
INDENT = "   "
SECTIONS = ("lines", "cameras")  # of the JSON, also when they are empty
Examination = Callable[[Progress], Sequence[Diagnostic]]


@dataclass(frozen=True)
class Verdict:
    """Verdict on a device or case; `because` lists the failed checks in display order."""

    of: str
    ready: bool
    because: tuple[str, ...]


def verdicts(
    case: Sequence[Diagnostic],
    devices: Mapping[str, Sequence[Diagnostic]],
    of_several: Sequence[Diagnostic] = (),
) -> Iterator[Verdict]:
    """Yield a verdict for each device table of the theatre file, then one for the case.

    With an assistant in the file, or its records, follows one for a case with both arms, which also needs
    `of_several`.
    """
    for name, found in devices.items():
        yield _verdict(name, found)
    needed = [*case, *(one for name in theatre_checks.NEEDED for one in devices.get(name, ()))]
    yield _verdict(CASE, needed)
    others = [devices[name] for name in (f"robot.{role}" for role in OTHERS) if name in devices]
    if others or not all(one.well for one in of_several):
        yield _verdict(TWO_ARM_CASE, [*needed, *chain.from_iterable(others), *of_several])


def _verdict(of: str, found: Sequence[Diagnostic]) -> Verdict:
    because = tuple(
        f"{one.subject.removeprefix(f'{of}: ')}: {one.seen}"
        for one in found
        if not (one.well or one.explained)
    )
    return Verdict(of, not because, because)


@dataclass(frozen=True)
class Report:
    """Diagnostics of the computer, the theatre file and its records, and the devices."""

    computer: tuple[Diagnostic, ...]
    devices: tuple[Diagnostic, ...]
    calibrations: tuple[Diagnostic, ...] = ()
    case: tuple[Diagnostic, ...] = ()  # what else a case needs of theatre file and computer
    verdicts: tuple[Verdict, ...] = ()  # of each device of the theatre, then of the case, and with two arms

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """All diagnostics in display order; an instrument left in the head comes first."""
        everything = self.computer + self.case + self.calibrations + self.devices
        return tuple(sorted(everything, key=lambda one: one.subject != theatre_checks.INSTRUMENT))

    @property
    def problems(self) -> tuple[Diagnostic, ...]:
        """Failed checks that keep a case from beginning or concern a device, each cause once, in order."""
        failed = (one for one in self.diagnostics if self.grade(one) == PROBLEM)
        return tuple(one for one in failed if not one.explained)

    @property
    def notes(self) -> tuple[Diagnostic, ...]:
        """Findings worth knowing that keep nothing from beginning, in display order."""
        return tuple(one for one in self.diagnostics if self.grade(one) == NOTE)

    @property
    def replies(self) -> tuple[Diagnostic, ...]:
        """Good findings at bare endpoints, which somebody has asked for; a theatre has verdicts instead."""
        return () if self.verdicts else tuple(one for one in self.devices if self.grade(one) == OK)

    def grade(self, one: Diagnostic) -> str:
        """Return how a finding is shown. A case can live with the shortcomings of the computer."""
        if not one.well and one not in self.computer:
            return PROBLEM
        return OK if one.well and not one.advice else NOTE

    def section(self, name: str) -> list[Mapping[str, Any]]:
        """Return the diagnostics of one section as plain documents."""
        return [f.document for f in self.devices if f.section == name and f.document is not None]


def _names_any(theatre: Path, endpoints: Sequence[Endpoint]) -> bool:
    """Whether a theatre file names one of the endpoints; not if it cannot be read any more."""
    with suppress(RonnaError, OSError):
        devices = read_theatre_file(theatre).devices.values()
        return any(one in endpoints_of(device) for device in devices for one in endpoints)
    return False


def examine(
    config: Path | None,
    endpoints: Sequence[str] = (),
    progress: Progress = lambda share: None,
    *,
    out: Path = theatre_checks.RUNS,
) -> Report:
    """Check this computer, each endpoint and every device in a theatre file, for runs in `out`.

    Raises CFG-001 for a bad theatre file, CFG-002 for an endpoint that no probe can look at, PRO-043 for one
    of a theatre that a run uses.
    """
    parsed = [parse_endpoint(text) for text in endpoints]
    examinations: dict[str, Examination] = dict(_endpoint_examinations(parsed))
    calibrations: tuple[Diagnostic, ...] = ()
    case: tuple[Diagnostic, ...] = ()
    two_arms: tuple[Diagnostic, ...] = ()
    devices: list[str] = []
    if config is not None:
        file = read_theatre_file(config)
        now = datetime.now(UTC)
        calibrations = (
            *calibration_diagnostics(file, config, now),
            *tool_diagnostics(file, config, now),
            *setting_diagnostics(file),
            *history_diagnostics(config),
        )
        case = (*theatre_checks.use_diagnostics(config), *theatre_checks.case_diagnostics(file, config, out))
        of_others = tuple(one for one in calibrations if one.subject in RECORDS_OF_OTHERS)
        calibrations = tuple(one for one in calibrations if one not in of_others)
        two_arms = (*of_others, *theatre_checks.assistant_diagnostics(file))
        if any(one in endpoints_of(device) for device in file.devices.values() for one in parsed):
            require_free_theatre(config)
        if all(one.subject != theatre_checks.RUN for one in case):
            devices = list(file.devices)
            for name, device in file.devices.items():
                examinations[name] = partial(_probe, name, device, file)
    if parsed:
        for theatre in list_noted_theatres():  # a run holds its devices before it has connected them
            if _names_any(theatre, parsed):
                require_free_theatre(theatre)
    computer = tuple(theatre_checks.computer_diagnostics())
    found: dict[str, Sequence[Diagnostic]] = {}
    for number, (name, examination) in enumerate(examinations.items()):

        def advance(share: float, before: int = number) -> None:
            progress((before + share) / len(examinations))

        found[name] = examination(advance)
        if config is not None and name in devices:
            found[name] = theatre_checks.advise_on_unfinished_run(config, found[name])
        advance(1.0)
    of_devices = {name: found[name] for name in devices}
    two_arms = (*two_arms, *two_arm_diagnostics(of_devices))
    case_verdicts = () if config is None else tuple(verdicts(case + calibrations, of_devices, two_arms))

    def advised(diagnostics: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
        return tuple(_with_command(one, config) for one in diagnostics)

    return Report(
        advised(computer),
        advised(one for each in found.values() for one in each),
        advised(calibrations),
        advised(case + two_arms),
        case_verdicts,
    )


def _with_command(one: Diagnostic, config: Path | None) -> Diagnostic:
    """Give a problem that no command solves the one that checks it again, against the theatre file if any."""
    if one.well or one.command:
        return one
    if config is not None:
        return replace(one, command=f"ronna-procedure doctor --config {shlex.quote(str(config))}")
    endpoint = (one.document or {}).get("endpoint")
    if endpoint is not None:
        return replace(one, command=f"ronna-procedure doctor --endpoint {shlex.quote(str(endpoint))}")
    return one


def show(report: Report, *, as_json: bool, everything: bool = False) -> None:
    """Print the diagnostics, then exit with an error code if a check failed.

    The code is 4 for a problem with a device, endpoint or calibration, or if the theatre is in use or its
    clock cannot be read; it is 3 if only something else prevents a case.
    """
    show_findings(report, as_json=as_json, everything=everything)
    in_use = tuple(one for one in report.case if one.subject in (theatre_checks.RUN, theatre_checks.CLOCK))
    if not all(diagnostic.well for diagnostic in in_use + report.calibrations + report.devices):
        raise SystemExit(EXIT_NOT_FOUND)
    if not all(verdict.ready for verdict in report.verdicts if verdict.of in (CASE, TWO_ARM_CASE)):
        raise SystemExit(EXIT_REFUSED)


def show_findings(report: Report, *, as_json: bool, everything: bool = False) -> None:
    """Print the problems, what is worth knowing, and any verdicts; with `everything` all checks."""
    if as_json:
        sections = dict.fromkeys((*SECTIONS, *(f.section for f in report.devices if f.section)))
        print_json(
            {"findings": [{name: getattr(one, name) for name in FINDING} for one in report.diagnostics]}
            | {name: report.section(name) for name in sections}
            | {"verdicts": [asdict(verdict) for verdict in report.verdicts]}
        )
        return
    for line in _format_findings(report):
        say(line)
    if everything:
        rows = [(one.subject, report.grade(one), one.seen, one.advice) for one in report.diagnostics]
        print_table("All checks", ("checked", "", "found", "what to do"), rows)
    elif folded := sum(report.grade(one) == OK for one in report.diagnostics) - len(report.replies):
        say(f"{format_count(folded, 'check')} without a finding; --all lists them")
    if report.verdicts:
        readiness = [
            (one.of, "ready" if one.ready else "NOT READY", "; ".join(_reasons(one, report)))
            for one in report.verdicts
        ]
        print_table("Readiness", ("", "", "because"), readiness)


def _format_findings(report: Report) -> Iterator[str]:
    """Yield lines: a numbered list of problems, then notes, then what was asked for."""
    if not report.problems:
        yield "No problem found."
    else:
        yield f"{format_count(len(report.problems), 'problem')}:"
        for number, one in enumerate(report.problems, start=1):
            yield from _format_finding(f"{number}. ", one)
    if report.notes:
        yield ""
        yield "Worth knowing:"
        for one in report.notes:
            yield from _format_finding("-  ", one)
    if report.replies:
        yield ""
        for one in report.replies:
            yield from _wrap(f"ok {one.subject}: {one.seen}", "")
    yield ""


def _format_finding(bullet: str, one: Diagnostic) -> Iterator[str]:
    yield from _wrap(f"{one.subject}: {one.seen}", bullet)
    if one.advice:
        yield from _wrap(one.advice, INDENT)
    if one.command:
        yield f"{INDENT}{one.command}"  # on one line, whatever the width: it is copied


def _wrap(text: str, first: str) -> Iterator[str]:
    """Wrap at the terminal's width without splitting words; elsewhere yield one line."""
    text = " ".join(text.split())
    if not on_terminal(sys.stdout):
        yield first + text
        return
    width = max(shutil.get_terminal_size().columns - 1, 2 * len(INDENT))
    yield from wrap(
        text,
        width,
        initial_indent=first,
        subsequent_indent=INDENT,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _reasons(verdict: Verdict, report: Report) -> Sequence[str]:
    """Return the reasons for a verdict; for a case, only the subjects of the failed checks."""
    if verdict.of not in (CASE, TWO_ARM_CASE):
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
        drivers = _drivers_checking(endpoint, probes)
        if len(drivers) != 1:
            raise BadEndpoint(
                f"{endpoint}: {' and '.join(drivers) or 'no driver'} can check this kind of endpoint",
                action="Name the driver in a theatre file, and use --config.",
            )
        by_driver.setdefault(drivers[0], []).append(endpoint)
    for driver, driver_endpoints in by_driver.items():
        yield f"endpoints of {driver}", partial(probes[driver].probe_endpoints, driver_endpoints)


def _drivers_checking(endpoint: Endpoint, probes: Mapping[str, EndpointProbe]) -> list[str]:
    """Return the drivers that can check an endpoint: those of a device with this fixed port, or others."""
    fitting = {name: probe for name, probe in probes.items() if endpoint.scheme in probe.endpoint_schemes}
    fixed = {name: probe for name, probe in fitting.items() if isinstance(probe, PortProbe)}
    at_port = [name for name, probe in fixed.items() if endpoint.port in probe.endpoint_ports]
    return at_port or [name for name in fitting if name not in fixed]


def _check_frames_offline(
    config: DeviceConfig, theatre: TheatreFile, calibrations: Calibrations
) -> Iterator[Diagnostic]:
    """Check the named frames of a tracker that could not be connected, as far as its options are valid."""
    try:
        tracker = make_device(TRACKER, config, HostClock())
    except Exception:  # its probe has said why
        return
    if isinstance(tracker, OpticalTracker):
        yield from frame_diagnostics(f"{TRACKER}: ", tracker, calibrations, theatre)


def _probe(name: str, config: DeviceConfig, theatre: TheatreFile, progress: Progress) -> Sequence[Diagnostic]:
    """Return the diagnostics from a driver's probe. A failed probe is itself a diagnostic."""
    try:
        found = load_probe(config.driver)(name, config, progress, inspection(name, theatre))
    except Exception as problem:  # a driver of another package may raise anything
        error = as_ronna_error(problem)
        log_failure(problem, error)
        return (refusal(f"device {name}", error),)
    if theatre.calibration is None:
        return found
    if name == TRACKER and not any(one.subject.endswith(FRAMES) for one in found):
        return (*found, *_check_frames_offline(config, theatre, theatre.calibration))
    if name != STEREO:
        return found
    return advise_on_serials(found, config, theatre.calibration.stereo_head)

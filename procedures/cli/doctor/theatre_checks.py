"""Checks of the theatre file, its current use and this computer. No device is accessed."""

from __future__ import annotations

import getpass
import os
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from procedures.journal.free_space import NO_DISK, describe_shortage
from procedures.runs.reopening import resumable_run
from procedures.runs.request_checks import require_two_arms
from procedures.runs.theatre_lock import find_theatre_user, find_unwritable_note, read_former_run
from ronna_hw.bounded_input import LARGEST_TOML_BYTES, read_bounded
from ronna_hw.clock import SharedClock, open_clock
from ronna_hw.config import ARM_RECORDS, TheatreFile
from ronna_hw.devices.capabilities import MESSAGES
from ronna_hw.devices.probing import Diagnostic, refusal
from ronna_hw.errors import RonnaError
from ronna_hw.host.files import require_open_files
from ronna_hw.mistakes import suggest_keys
from ronna_hw.roles import ASSISTANT, MASTER
from ronna_hw.text import format_count
from ronna_hw.theatre_kind import is_simulated, require_one_kind

CASE_OPEN_FILES = 96  # as a case requires
CLOCK = "clock of the theatre"
RUNS = Path("runs")  # where a case is written by default
NEEDED = ("tracker", f"robot.{MASTER}", "stereo")
RUN = "run"  # subject of a theatre that is in use
INSTRUMENT = "instrument"  # subject of an instrument that a run left in the head; shown first
TOOL = "mounted tool"
LIMITS_FILE = "/etc/security/limits.d/ronna-hw.conf"
RECEIVE_BUFFER_WANTED = 4 * 1024 * 1024  # bytes; a full frame of both cameras at 1500-byte packets


def case_diagnostics(theatre: TheatreFile, config: Path, out: Path) -> Iterator[Diagnostic]:
    """Check everything that a case in `out` needs apart from its devices and records."""
    kind = "all simulated" if is_simulated(theatre) else "all real"
    yield run_check("theatre file", kind, lambda: require_one_kind(theatre))
    yield run_check(CLOCK, f"{theatre.clock.endpoint}", lambda: _read_clock(theatre))
    missing = [name for name in NEEDED if name not in theatre.devices]
    yield Diagnostic(
        "devices of a case",
        not missing,
        f"without {', '.join(missing)}" if missing else ", ".join(NEEDED),
        " ".join(_advise_on_missing_table(config, name) for name in missing),
    )
    allowed = f"at least {CASE_OPEN_FILES} allowed"
    yield run_check("open files", allowed, lambda: require_open_files(CASE_OPEN_FILES))
    resolved = out.resolve()
    folder = next(path for path in (resolved, *resolved.parents) if path.exists())  # a run makes the others
    shortage = describe_shortage(folder)
    found = f"{folder}: {shortage or 'enough for a case'}"
    advice, command = ("Free some space.", f"df -h {shlex.quote(str(folder))}") if shortage else ("", "")
    if shortage == NO_DISK:
        advice, command = "Choose another folder with --out.", ""
    yield Diagnostic("disk", not shortage, found, advice, command=command)


def assistant_diagnostics(theatre: TheatreFile) -> Iterator[Diagnostic]:
    """Check the records that two arms need, and name the arms in roles that no procedure has."""
    records = {} if theatre.calibration is None else theatre.calibration.records
    with_records = (role for role, names in ARM_RECORDS.items() if not records.keys().isdisjoint(names))
    named = {*theatre.robot, *with_records}
    if named & ARM_RECORDS.keys() - {MASTER}:
        yield run_check("records of two arms", "complete", lambda: require_two_arms(theatre))
    if theatre.procedure.assistant_drills and (why := _why_a_hand_drills(theatre)):
        yield Diagnostic("assistant_drills", False, f"a hand drills: {why}", "Correct it, or omit the line.")
    for name in theatre.robot:
        if name not in ARM_RECORDS:
            advice = f"Name the table by the role of its arm{suggest_keys(name, tuple(ARM_RECORDS))}."
            yield Diagnostic(f"table robot.{name}", True, "no procedure uses this arm", advice)


def _why_a_hand_drills(theatre: TheatreFile) -> str:
    """Return what keeps the assistant from drilling, as far as the theatre file tells it, or ''."""
    from procedures.steps.clinical.two_arms.drill_plan import FREE_N

    arm = theatre.robot.get(ASSISTANT)
    if arm is None:
        return f"the theatre has no [robot.{ASSISTANT}]"
    error_N = arm.options.get("force_error_N", 0.0)
    if isinstance(error_N, int | float) and error_N > FREE_N:
        return f"force_error_N of the assistant is {error_N:g}, above {FREE_N:g} N"
    return ""


def _advise_on_missing_table(config: Path, name: str) -> str:
    """Advise on adding a device's table, or on completing the example that `new-theatre` wrote."""
    text = read_bounded(config, LARGEST_TOML_BYTES).decode(errors="replace")
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip() == f"# [{name}]":
            return (
                f"[{name}] stands as an example from line {number} of {config.name}: correct it, then remove "
                "the first # of each of its lines."
            )
    return f"Add [{name}] to the theatre file."


def _read_clock(theatre: TheatreFile) -> None:
    clock = open_clock(theatre.clock.endpoint)
    clock.now_s()
    if isinstance(clock, SharedClock):
        clock.close()


def run_check(subject: str, found: str, require: Callable[[], object]) -> Diagnostic:
    """Run `require`; return a diagnostic with the text `found`, or with the error raised."""
    try:
        require()
    except RonnaError as error:
        return refusal(subject, error)
    return Diagnostic(subject, True, found)


def use_diagnostics(theatre: Path) -> Iterator[Diagnostic]:
    """Yield obstacles to a new case from current or earlier use of the theatre; subject `RUN` if in use."""
    if (user := find_theatre_user(theatre)) is not None:
        seen = f"{user.seen}: its devices were not checked"
        yield Diagnostic(RUN, False, seen, user.advice("check again"))
        return
    former = read_former_run(theatre)
    if (refused := former.refusal) is not None:
        yield Diagnostic(INSTRUMENT, False, refused.what, refused.advice, command=former.home or "")
    if former.not_home is not None:
        hint = "" if refused else "A new case asks whether to take where the arm stands as its home."
        subject = INSTRUMENT if former.inside and not refused else "home of the arm"
        yield Diagnostic(subject, False, former.not_home, hint)
    if (note := find_unwritable_note(theatre)) is not None:
        advice = "Give this user the right to write it: it tells a later run what this one left."
        yield Diagnostic("note of the last run", False, f"{note} cannot be written", advice)


def advise_on_unfinished_run(theatre: Path, found: Sequence[Diagnostic]) -> list[Diagnostic]:
    """Adapt the advice in device diagnostics to the theatre and its unfinished run."""
    run, inside = resumable_run(theatre), read_former_run(theatre).inside
    advised = list(found)
    for place, one in enumerate(found):
        if one.well:
            continue
        if inside is not None and one.subject.endswith(f": {TOOL}"):
            advised[place] = replace(one, advice=f"Do not touch the tool: {inside}.")
        elif one.subject.endswith(f": {MESSAGES}"):
            of = f"--config {shlex.quote(str(theatre))}" if run is None else shlex.quote(str(run))
            command = f"ronna-procedure acknowledge {of} --by 'YOUR NAME'"
            advice = one.advice if run is None else f"Remove its cause; then {command}."
            advised[place] = replace(one, advice=advice, command=command)
    return advised


def computer_diagnostics() -> Iterator[Diagnostic]:
    """Yield diagnostics of this computer."""
    yield Diagnostic("Python", sys.version_info >= (3, 11), sys.version.split()[0])
    yield _own_packages()
    yield _receive_buffer()
    yield _real_time()
    yield from _serial_ports()


def _own_packages() -> Diagnostic:
    """Check that no other distribution has replaced files of ours; foreign packages are refused before."""
    from ronna_hw.host.own_packages import find_replaced_files

    if replaced := find_replaced_files():
        what = f"{format_count(len(replaced), 'file')} replaced or missing, such as {replaced[0]}"
        advice = "Install ronna-hw again, in a virtual environment of its own."
        return Diagnostic("packages", False, what, advice)
    return Diagnostic("packages", True, "none foreign")


def _receive_buffer() -> Diagnostic:
    try:
        size = int(Path("/proc/sys/net/core/rmem_max").read_text())
    except OSError:
        return Diagnostic("camera receive buffer", True, "unknown on this system")
    large = size >= RECEIVE_BUFFER_WANTED
    seen = f"net.core.rmem_max {size}"
    if large:
        return Diagnostic("camera receive buffer", True, seen)
    advice = "For real cameras: enlarge it, or use jumbo packets."
    command = f"sudo sysctl -w net.core.rmem_max={RECEIVE_BUFFER_WANTED}"
    return Diagnostic("camera receive buffer", False, seen, advice, command=command)


def _real_time() -> Diagnostic:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    except PermissionError:
        advice = "For a real arm: permit it, then log in again; simulators do not need it."
        command = f"echo '{getpass.getuser()} - rtprio 80' | sudo tee {LIMITS_FILE}"
        return Diagnostic("real-time priority", False, "not permitted", advice, command=command)
    return Diagnostic("real-time priority", True, "permitted")


def _serial_ports() -> Iterator[Diagnostic]:
    from serial.tools import list_ports

    from ronna_hw.host.port_users import advise_on_permission, describe_permissions, find_serial_port_users

    ports = sorted(list_ports.comports(), key=lambda port: str(port.device))
    if not ports:
        yield Diagnostic("serial ports", True, "none on this computer")
    for port in ports:
        description = "no description" if port.description == "n/a" else str(port.description)
        path = str(port.device)
        subject, seen = f"serial port {path}", f"{description}; {describe_permissions(path)}"
        if not os.access(path, os.R_OK | os.W_OK):
            yield Diagnostic(subject, False, f"{seen}; permission denied", advise_on_permission(path))
            continue
        if users := find_serial_port_users(path):
            seen += "; in use by " + " and ".join(map(str, users))
        yield Diagnostic(subject, True, seen)

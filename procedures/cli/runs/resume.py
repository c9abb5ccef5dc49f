"""`ronna-procedure resume`, `home` and `acknowledge`: recovery from interruptions and faults."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from procedures.cli.case.display import follow, observe_run, show_outcome
from procedures.engine.device_faults import recover_faults
from procedures.engine.errors import FAULT_OF_RUN, RECOVERY_REFUSED
from procedures.runs import reopening
from procedures.runs.arm_notes import FormerRun
from procedures.runs.case_outcome import finish_case, is_all_done, outcome_as_recorded, with_report
from procedures.runs.finishing import complete_seal, finalize_run
from procedures.runs.interrupted_run import InterruptedRun, Resumption
from procedures.runs.lifecycle import open_run
from procedures.runs.observers import RunObservers
from procedures.runs.request import CalibrationProcedure, RunRequest
from procedures.runs.request_checks import check_asking
from procedures.runs.theatre_lock import hold_theatre, read_former_run, require_free_theatre
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.terminal import on_terminal, print_json, say, tell
from ronna_hw.devices.lifecycle import Lifecycle, require_person
from ronna_hw.errors import RonnaError

if TYPE_CHECKING:
    from procedures.runs.console_link import ConsoleRequest
    from procedures.workcell.device_views import DeviceView


def resume(
    folder: Path, *, accept: bool, answers: Path | None, as_json: bool, console: ConsoleRequest | None = None
) -> None:
    """Resume and finish a run; if already finished, just show its outcome.

    With a console, nothing is read until someone is in its seat, unless a script accepts. A case begun by
    `step` goes on so, unless a console or a script that wants JSON leads it. Raises PRO-030 to PRO-034,
    PRO-043, PRO-003 if nothing can be written, and the errors of devices and steps.
    """
    request = reopening.read_reopened_request(folder, accept=accept, answers=answers, reuse_answers=True)
    with reopening.hold_interrupted_run(folder) as interrupted:
        if isinstance(request.procedure, CalibrationProcedure):
            if console is not None:
                raise UsageMistake(
                    "--console operates cases, and this is a calibration", action="Omit --console."
                )
            from procedures.cli.calibrating.calibration import resume_calibration

            resume_calibration(request, interrupted, accepted=accept, as_json=as_json)
        elif interrupted.finished:
            with complete_seal(interrupted) as closed:
                outcome = outcome_as_recorded(request, closed)
            tell(f"{interrupted.run.name} is finished: nothing remains to be done")
            show_outcome(with_report(outcome, interrupted.folder), as_json=as_json)
        else:
            check_asking(request, interrupted.folder)
            reopening.require_ready_devices(request, interrupted.folder)
            reopening.prepare_folder(interrupted)
            if request.by_step and console is None and not as_json and not is_all_done(request, interrupted):
                from procedures.cli.case.stepping import resume_by_step

                resume_by_step(request, interrupted, accepted=accept)
                return
            finish = partial(finish_case, request, interrupted, accepted=accept)
            follow(
                request,
                interrupted.folder,
                finish,
                console,
                as_json=as_json,
                waits=not accept,
                left=interrupted,
            )


def home(folder: Path, *, accept: bool, answers: Path | None, as_json: bool) -> None:
    """Once the findings are accepted, ask for removal of any instrument and move the arm home.

    Raises the errors of `resume`; the run is unchanged and can be resumed.
    """
    request = reopening.read_reopened_request(folder, accept=accept, answers=answers)
    with reopening.hold_interrupted_run(folder, only_leaving=True) as interrupted:
        if (nothing := interrupted.why_home_needs_no_device) is not None:
            _require_last_run(interrupted, request)
            _print_outcome(
                interrupted, nothing, home=interrupted.parked or None, moved=False, as_json=as_json
            )
            return
        check_asking(request, interrupted.folder)
        reopening.require_ready_devices(request, interrupted.folder)
        reopening.prepare_folder(interrupted)
        with finalize_run(interrupted.folder, interrupted), observe_run(quiet=as_json) as observers:
            from procedures.runs.recovery import bring_home

            resumption = Resumption(interrupted, accept, only_leaving=True)
            with open_run(request, interrupted.folder, observers, resumption) as engine:
                moved = bring_home(engine, interrupted)
                arms = len(engine.setting.workcell.arms)
        state = "home" if moved else "already home"
        words = f"both arms are {state}" if arms > 1 else f"the arm {'is' if moved else 'was'} {state}"
        _print_outcome(interrupted, words, moved=moved, as_json=as_json)


def _require_last_run(interrupted: InterruptedRun, request: RunRequest) -> None:
    """Raise PRO-032 or PRO-047 if another run must bring the arm home first, PRO-043 while it is active."""
    if request.config is None:
        return
    former = read_former_run(request.config, interrupted.folder, request.roles)
    if former == FormerRun():
        return
    reopening.require_ready_devices(request, interrupted.folder)
    raise RECOVERY_REFUSED(former.not_home or "", action="Nothing was moved.")


def _print_outcome(
    interrupted: InterruptedRun, words: str, *, moved: bool, as_json: bool, home: Literal[True] | None = True
) -> None:
    """Print the outcome; `home` is None if the arm was not queried."""
    if as_json:
        print_json({"run": interrupted.folder.name, "home": home, "moved": moved})
    else:
        say(words)


def acknowledge_run(folder: Path, by: str | None, *, as_json: bool) -> None:
    """Acknowledge the device faults of a run and record this in its journal.

    Raises the errors of `home` and of `acknowledge_theatre`.
    """
    request = reopening.read_reopened_request(folder)
    with reopening.hold_interrupted_run(folder, only_leaving=True) as interrupted:
        by = _acknowledging_person(by)
        path = interrupted.folder
        if interrupted.parked:
            words = "the run is finished, and had no fault left"
            if request.config is not None:
                words = (
                    "the run is finished; for a fault of its theatre since: ronna-procedure acknowledge "
                    f"{shlex.quote(str(request.config))} --by 'YOUR NAME'"
                )
            _print_faults({}, {}, by, as_json=as_json, nothing=words, run=path.name)
            return
        if request.config is not None:
            require_free_theatre(request.config, request.roles)
            _require_own_fault(request.config, path)
        reopening.prepare_folder(interrupted)
        resumption = Resumption(interrupted, False, only_leaving=True, asks=False)
        with finalize_run(path, interrupted), open_run(request, path, RunObservers(), resumption) as engine:
            _recover_all(
                engine.setting.workcell.devices,
                lambda: engine.faults.acknowledge(by),
                by,
                as_json=as_json,
                run=path.name,
            )


def acknowledge_theatre(file: Path, by: str | None, *, as_json: bool) -> None:
    """Acknowledge the device faults of a theatre.

    Raises DEV-006, PRO-043, PRO-044, and the error of a driver that cannot be recovered yet.
    """
    from ronna_hw.theatre import Theatre

    by = _acknowledging_person(by)
    require_free_theatre(file)
    _require_own_fault(file, None)
    with Theatre.from_file(file) as theatre, hold_theatre(file, None, only_leaving=True):
        devices = theatre.devices
        _recover_all(
            devices,
            lambda: dict(recover_faults(devices, lambda name: devices[name].recover(by))),
            by,
            as_json=as_json,
            theatre=theatre.file.theatre,
        )


def _require_own_fault(theatre: Path, run: Path | None) -> None:
    """Raise PRO-044 if the devices were last used by a different, resumable run.

    Only that run's journal can put its earlier localizations in doubt.
    """
    if (last := reopening.resumable_run(theatre, run)) is not None:
        raise FAULT_OF_RUN(
            f"run {last.name} on this theatre is unfinished: after a fault it must ask which results are "
            "still valid",
            action=f"Use ronna-procedure acknowledge {shlex.quote(str(last))} --by 'YOUR NAME'.",
        )


def _acknowledging_person(by: str | None) -> str:
    """Return the acknowledging person's name, prompting if not given; the login name is never used.

    Raises DEV-006.
    """
    if by is None and on_terminal(sys.stdin) and on_terminal(sys.stderr):
        by = str(typer.prompt("Name of the person acknowledging", err=True))
    return require_person(by or "")


def _recover_all(
    devices: Mapping[str, DeviceView],
    acknowledge: Callable[[], dict[str, str]],
    by: str,
    *,
    as_json: bool,
    **about: str,
) -> None:
    """Connect and configure every device without motion, and recover any faults found.

    A device that does not respond does not block the others; its error is raised at the end.
    """
    problems: dict[str, RonnaError] = {}
    for name, device in devices.items():
        try:
            device.connect()
        except RonnaError as problem:
            problems[name] = problem
    done = acknowledge()
    for name, device in devices.items():
        if device.observe().state is Lifecycle.CONNECTED:
            try:
                device.configure()
            except RonnaError as problem:
                if device.observe().state is not Lifecycle.FAULT:
                    problems[name] = problem
    done |= acknowledge()
    _print_faults(done, problems, by, as_json=as_json, **about)
    *others, last = [None, *problems.values()]
    for one in others[1:]:
        tell(str(one))
    if last is not None:
        raise last


def _print_faults(
    done: Mapping[str, str],
    problems: Mapping[str, RonnaError],
    by: str,
    *,
    as_json: bool,
    nothing: str = "no device is in fault",
    **about: str,
) -> None:
    """Print the recovered faults and any problems, or `nothing` if there was nothing to recover."""
    if as_json:
        unreached = {name: str(problem) for name, problem in problems.items()}
        print_json({**about, "acknowledged": done, "unreached": unreached})
    else:
        rows = [f"acknowledged by {by}: {name}: {fault}" for name, fault in done.items()] or [nothing]
        say("\n".join(rows))

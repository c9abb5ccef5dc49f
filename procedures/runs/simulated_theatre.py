"""Simulated theatre, patient and staff in child processes, and ground truth about a run."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

from procedures.engine.errors import CommandRefused
from procedures.journal.errors import RunDeleted
from procedures.operator.question import Task
from procedures.runs.request import CaseProcedure, RunRequest
from ronna_hw.bounded_input import LARGEST_TOML_BYTES, read_bounded
from ronna_hw.control_port import ControlPortSilent, ask_control_port
from ronna_hw.errors import EXIT_DONE, EXIT_FAILED, EXIT_LINK_LOST, RonnaError
from ronna_hw.evidence.manifest import WITH_PORTS
from ronna_hw.host.child_process import ChildNotReady, await_end, command, run_command
from ronna_hw.host.process import describe_exit
from ronna_hw.records import write_atomically
from ronna_hw.roles import ASSISTANT
from ronna_hw.theatre import SIMULATOR_NAME, TheatreProcess
from ronna_hw.wire.room_tasks import SCAN

if TYPE_CHECKING:
    from procedures.reporting.outcome import Truth

PHANTOM_TIMEOUT_S = 120.0  # host time; a full series takes a few seconds
SCANNER = "ronna-sim phantom --cone-beam"
SCAN_TIMEOUT_S = 600.0  # host time; a scan takes a quarter of a minute
VERIFIER = "ronna-sim verify"
VERIFY_TIMEOUT_S = 60.0  # host time; it reads a few small files
THEATRE_FOLDER = "theatre"  # of a run that has a theatre of its own


class SimulatedTheatre:
    """Simulated theatre in one folder and, if `phantom` is given, a patient (CT and plan) in another."""

    def __init__(
        self,
        request: RunRequest,
        folder: Path,
        phantom: Path | None,
        *,
        continued: bool = False,
        on_controller_message: Callable[[str], None] = lambda _line: None,
    ) -> None:
        """Start the theatre. `continued` resumes an earlier state and ignores the fault script."""
        self._file = folder.parent / WITH_PORTS  # written anew when it is ready, with its ports
        is_resumed = continued and self._file.exists()
        self._former = read_bounded(self._file, LARGEST_TOML_BYTES) if is_resumed else None
        arguments = ["--speed", request.speed, "--out", str(folder), "--run", folder.parent.name]
        if request.faults is not None and not continued:
            arguments += ["--faults", str(request.faults)]
        if isinstance(request.procedure, CaseProcedure) and request.procedure.measure_targets:
            arguments.append("--target-balls")
        if ASSISTANT in request.roles:
            arguments += ["--dual", "--assistant-arm", request.choice.assistant_arm]
            arguments += ["--drill"] if request.choice.drill else []
        if continued:
            arguments.append("--continue")
        scene = request.choice.theatre_arguments()
        self.theatre = TheatreProcess(*scene, *arguments, on_controller_message=on_controller_message)
        try:
            self._phantom = None if phantom is None else _start_phantom(request.choice.arguments(), phantom)
        except BaseException:  # such as no process left: nobody will leave this block
            self.theatre.end()
            raise

    def await_patient(self) -> None:
        """Wait until CT series and plan are complete. Raises PRO-013 with the message of a failed command.

        A refused theatre is reported at once; PRC-001 if time runs out.
        """
        assert self._phantom is not None, "this theatre has no patient"

        def check_theatre() -> None:
            if not self.theatre.child.alive:
                self.await_theatre()  # it was refused: nobody needs the patient

        _, messages = await_end("ronna-sim phantom", self._phantom, PHANTOM_TIMEOUT_S, check_theatre)
        if self._phantom.returncode != 0:
            raise CommandRefused("ronna-sim phantom", messages, self._phantom.returncode)

    def await_theatre(self) -> None:
        """Wait until all devices are ready. Raises PRO-013 with the simulator's message, or else PRC-001."""
        child = self.theatre.child
        try:
            self.theatre.await_ready()
        except ChildNotReady as error:
            if not child.messages:
                raise
            code = EXIT_FAILED if error.limit else child.process.returncode  # the former: ended by us
            raise CommandRefused(SIMULATOR_NAME, child.messages[-1], code) from error

    def keep_file(self) -> None:
        """Keep the current theatre file on exit instead of restoring the earlier one."""
        self._former = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._phantom is not None:
            if self._phantom.poll() is None:
                self._phantom.kill()
                self._phantom.wait()
            if self._phantom.stderr is not None:
                self._phantom.stderr.close()
        child = self.theatre.child
        halted = isinstance(error, ControlPortSilent) and child.alive
        theatre_gone = bool(child.ready) and (halted or not child.alive)
        self.theatre.end()
        if self._former is not None:
            write_atomically(self._file, self._former)
        if theatre_gone and error is not None and not isinstance(error, RunDeleted):
            # what the procedure met is only the consequence
            ended = describe_exit(child.process.returncode or 0)
            words = "it no longer responds" if halted else " / ".join(child.messages) or f"it ended: {ended}"
            raise CommandRefused(SIMULATOR_NAME, words, EXIT_LINK_LOST) from error


def _start_phantom(scene: list[str], folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        command("sim.cli", "phantom", "--with-parent", *scene, "--out", str(folder)),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


class SimulatedRoom:
    """Simulated theatre staff; the only client of the control port.

    The port closes idle connections, so each request opens one of its own.
    """

    def __init__(self, control: str, scan: Callable[[], None] = lambda: None) -> None:
        """`control` is the control port's endpoint with its token; `scan` scans the head in its theatre."""
        self._control = control
        self._afterwards = {SCAN: scan}

    def announce(self, step: str) -> None:
        """Tell the theatre which step is running."""
        ask_control_port(self._control, "step", name=step)

    def change_tool(self, number: int, description: str) -> None:
        """Mount the tool with this number."""
        ask_control_port(self._control, "mount", number=number)

    def prepare_stand(self, holds: str) -> None:
        """Put the ball or the divot on the calibration stand."""
        ask_control_port(self._control, "stand", holds=holds)

    def work(self, task: Task) -> tuple[float, ...]:
        """Perform the task and return its readings."""
        what = {"task": task.name, "trajectory": task.trajectory or "", "numbers": list(task.numbers)}
        answer = ask_control_port(self._control, "work", **what)
        self._afterwards.get(task.name, lambda: None)()
        return tuple(float(reading) for reading in answer.get("readings", ()))

    def read_wristband(self) -> str:
        """Return the identifier on the simulated patient's wristband."""
        return str(ask_control_port(self._control, "wristband")["wristband"])

    def tell_missed_faults(self, tell: Callable[[str], None]) -> Callable[[object, object, object], None]:
        """Return an exit callback that reports room faults scheduled too late to take effect."""

        def at_exit(_kind: object, problem: object, _trace: object) -> None:
            if isinstance(problem, ControlPortSilent) or not isinstance(problem, RonnaError | None):
                return
            with suppress(RonnaError):  # the theatre may have ended
                for missed in ask_control_port(self._control, "missed_faults")["missed"]:
                    tell(f"warning: {missed}")

        return at_exit


def scan_head(theatre: Path, seed: int, out: Path) -> None:
    """Scan the head in a simulated theatre as it is now, into a folder that holds nothing else.

    Raises PRO-013 if the command fails, PRC-001 if it hangs.
    """
    shutil.rmtree(out, ignore_errors=True)  # of an earlier scan
    options = ("--cone-beam", "--theatre", str(theatre), "--seed", str(seed), "--out", str(out))
    ended = run_command(SCANNER, command("sim.cli", "phantom", *options), SCAN_TIMEOUT_S)
    if ended.returncode != EXIT_DONE:
        raise CommandRefused(SCANNER, ended.stderr, ended.returncode)


def ask_verifier(folder: Path) -> Truth:
    """Ask the verifier for the ground truth about a run. Raises PRO-013 if it fails, PRC-001 if it hangs."""
    from procedures.reporting.outcome import Truth

    answer = run_command(
        VERIFIER, command("sim.cli", "verify", str(folder), "--json"), VERIFY_TIMEOUT_S, _import_report
    )
    # A run that reached no target is a failure of that command, after its answer.
    if answer.returncode not in (EXIT_DONE, EXIT_FAILED) or not answer.stdout:
        raise CommandRefused(VERIFIER, answer.stderr, answer.returncode)
    return Truth.model_validate_json(answer.stdout)


def _import_report() -> None:
    """Import what the report needs, which follows the verifier."""
    import jinja2  # noqa: F401 - only to have it loaded

    import procedures.reporting.report  # noqa: F401 - only to have it loaded


def find_truth(folder: Path) -> Truth | None:
    """Return the ground truth for a run, or None if it is unavailable."""
    if not (folder / THEATRE_FOLDER).is_dir():
        return None
    try:
        return ask_verifier(folder)
    except (CommandRefused, ChildNotReady):
        return None

"""A simulated theatre and its patient, started as commands: what `--sim` means and nothing more."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

from procedures.cli.case.request import TheatreRequest
from procedures.engine.errors import CommandRefused
from ronna_hw.bounded_input import LARGEST_TOML_BYTES, read_bounded
from ronna_hw.errors import EXIT_FAILED, EXIT_LINK_LOST
from ronna_hw.evidence.manifest import WITH_PORTS
from ronna_hw.host.child_process import ChildNotReady, await_end, command
from ronna_hw.host.control_port import ControlPortSilent
from ronna_hw.records import write_whole
from ronna_hw.theatre import SIMULATOR_NAME, TheatreProcess

PHANTOM_TIMEOUT_S = 120.0  # host time; a full series takes a few seconds


class SimulatedCase:
    """A theatre in a folder, and with `phantom` a patient in another: `ct/` and `plan.toml`."""

    def __init__(
        self,
        request: TheatreRequest,
        folder: Path,
        phantom: Path | None,
        *,
        goes_on: bool = False,
        on_controller_message: Callable[[str], None] = lambda _line: None,
    ) -> None:
        """`goes_on` where the world of another theatre goes on: the fault script of the run is over then."""
        self._file = folder.parent / WITH_PORTS  # written anew when it is ready, with its ports
        left = goes_on and self._file.exists()
        self._former = read_bounded(self._file, LARGEST_TOML_BYTES) if left else None
        scene = request.choice.theatre_arguments()
        more = ["--faults", str(request.faults)] if request.faults is not None and not goes_on else []
        if request.measure_targets:
            more.append("--target-balls")
        if goes_on:
            more.append("--continue")
        self.theatre = TheatreProcess(
            *scene,
            "--speed",
            request.speed,
            "--out",
            str(folder),
            *more,
            on_controller_message=on_controller_message,
        )
        try:
            self._phantom = None if phantom is None else _start_phantom(request.choice.arguments(), phantom)
        except BaseException:  # such as no process left: nobody will leave this block
            self.theatre.end()
            raise

    def await_patient(self) -> None:
        """Return when the CT series and the plan are written; raises PRO-013 with the command's words.

        That of the theatre as soon as it is refused; PRC-001 when they are not in time.
        """
        assert self._phantom is not None, "this theatre has no patient"

        def meanwhile() -> None:
            if not self.theatre.child.alive:
                self.await_theatre()  # it was refused: nobody needs the patient

        _, messages = await_end("ronna-sim phantom", self._phantom, PHANTOM_TIMEOUT_S, meanwhile)
        if self._phantom.returncode != 0:
            raise CommandRefused("ronna-sim phantom", messages, self._phantom.returncode)

    def await_theatre(self) -> None:
        """Return when every device is ready; raises PRO-013 with the command's words, PRC-001 without any."""
        child = self.theatre.child
        try:
            self.theatre.await_ready()
        except ChildNotReady as error:
            if not child.messages:
                raise
            code = EXIT_FAILED if error.limit else child.process.returncode  # the former: ended by us
            raise CommandRefused(SIMULATOR_NAME, child.messages[-1], code) from error

    def taken_up(self) -> None:
        """The run's journal names the theatre as it is now; without that it is left as it was."""
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
        gone = bool(child.ready) and (halted or not child.alive)
        self.theatre.end()
        if self._former is not None:
            write_whole(self._file, self._former)
        if gone and error is not None:  # what the procedure met is only the consequence
            words = "it no longer responds" if halted else " / ".join(child.messages) or "no message"
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

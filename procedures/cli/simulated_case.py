"""A simulated theatre with its patient, started as commands: what `--sim` means and nothing more."""

from __future__ import annotations

import subprocess
from pathlib import Path
from types import TracebackType
from typing import Self

from procedures.cli.scene_choice import SceneChoice
from procedures.engine.errors import CommandRefused
from ronna_hw.child_process import ChildNotReady, ChildProcess, command
from ronna_hw.errors import EXIT_LINK_LOST

PHANTOM_TIMEOUT_S = 120.0  # host time; a full series takes a few seconds


class SimulatedCase:
    """Theatre and phantom in a run folder: `theatre/theatre.toml`, `case/ct/`, `case/plan.toml`."""

    def __init__(self, choice: SceneChoice, folder: Path, *, speed: str, faults: Path | None) -> None:
        self.series = folder / "case" / "ct"
        self.plan = folder / "case" / "plan.toml"
        arguments = [*choice.arguments(), "--speed", speed, "--out", str(folder / "theatre")]
        if faults is not None:
            arguments += ["--faults", str(faults)]
        self._theatre = ChildProcess.begun("ronna-sim theatre", command("sim.cli", "theatre", *arguments))
        self._phantom = subprocess.Popen(
            command(
                "sim.cli", "phantom", "--with-parent", *choice.arguments(), "--out", str(folder / "case")
            ),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def await_patient(self) -> None:
        """Return when the CT series and the plan are written; raises PRO-013 with the command's words.

        PRC-001 when they are not in time.
        """
        try:
            _, messages = self._phantom.communicate(timeout=PHANTOM_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            raise ChildNotReady(
                "ronna-sim phantom did not end", awaited="the phantom CT", limit=f"{PHANTOM_TIMEOUT_S:g} s"
            ) from None
        if self._phantom.returncode != 0:
            raise CommandRefused("ronna-sim phantom", messages, self._phantom.returncode)

    def await_theatre(self) -> None:
        """Return when every device of the theatre is ready; raises PRO-013 with the command's words."""
        try:
            self._theatre.await_ready()
        except ChildNotReady as error:
            words = self._theatre.messages
            if not words:
                raise
            code = self._theatre.process.returncode
            raise CommandRefused("ronna-sim theatre", words[-1], code) from error

    @property
    def theatre_file(self) -> Path:
        """The theatre file that was written."""
        return Path(self._theatre.ready["file"])

    @property
    def control(self) -> str:
        """Endpoint of the control port."""
        return str(self._theatre.ready["endpoints"]["control"])

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._phantom.poll() is None:
            self._phantom.kill()
            self._phantom.wait()
        if self._phantom.stderr is not None:
            self._phantom.stderr.close()
        fallen = not self._theatre.alive
        self._theatre.stop()
        if fallen and error is not None and self._theatre.ready:
            # What the procedure met is only the consequence: a device of the theatre has ended.
            words = " / ".join(self._theatre.messages) or "nothing and ended"
            raise CommandRefused("ronna-sim theatre", words, EXIT_LINK_LOST) from error

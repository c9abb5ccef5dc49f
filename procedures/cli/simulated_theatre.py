"""A simulated theatre, started as the command that any client may start."""

from __future__ import annotations

from pathlib import Path

from procedures.engine.errors import CommandRefused
from ronna_hw.errors import EXIT_FAILED, EXIT_LINK_LOST
from ronna_hw.host.child_process import ChildNotReady, ChildProcess, command

NAME = "ronna-sim theatre"


class SimulatedTheatre:
    """`ronna-sim theatre`, begun but not waited for; `await_ready` and `stop` must follow."""

    def __init__(self, *arguments: str) -> None:
        self._child = ChildProcess(NAME, command("sim.cli", "theatre", *arguments), timeout_s=None)

    def await_ready(self) -> None:
        """Return when every device is ready; raises PRO-013 with the command's words, PRC-001 without any."""
        try:
            self._child.await_ready()
        except ChildNotReady as error:
            if not self._child.messages:
                raise
            code = self._child.process.returncode or EXIT_FAILED
            raise CommandRefused(NAME, self._child.messages[-1], code) from error

    @property
    def file(self) -> Path:
        """The theatre file that was written."""
        return Path(self._child.ready["file"])

    @property
    def control(self) -> str:
        """Endpoint of the control port."""
        return str(self._child.ready["endpoints"]["control"])

    def stop(self) -> CommandRefused | None:
        """End it. The error that says why, when it had been ready and has ended by itself."""
        fallen = bool(self._child.ready) and not self._child.alive
        self._child.stop()
        words = " / ".join(self._child.messages) or "nothing and ended"
        return CommandRefused(NAME, words, EXIT_LINK_LOST) if fallen else None

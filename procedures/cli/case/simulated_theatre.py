"""A simulated theatre, started as the command that any client may start; its errors are the command's."""

from __future__ import annotations

from procedures.engine.errors import CommandRefused
from ronna_hw.errors import EXIT_FAILED, EXIT_LINK_LOST
from ronna_hw.host.child_process import ChildNotReady
from ronna_hw.simulation import NAME, TheatreProcess


class SimulatedTheatre(TheatreProcess):
    """As its base class, and says with which exit code and words the command has ended."""

    def await_ready(self) -> None:
        """Return when every device is ready; raises PRO-013 with the command's words, PRC-001 without any."""
        try:
            super().await_ready()
        except ChildNotReady as error:
            if not self.child.messages:
                raise
            code = self.child.process.returncode or EXIT_FAILED
            raise CommandRefused(NAME, self.child.messages[-1], code) from error

    def stop(self) -> CommandRefused | None:
        """End it. The error that says why, when it had been ready and has ended by itself."""
        ended_by_itself = bool(self.child.ready) and not self.child.alive
        self.end()
        words = " / ".join(self.child.messages) or "no message"
        return CommandRefused(NAME, words, EXIT_LINK_LOST) if ended_by_itself else None

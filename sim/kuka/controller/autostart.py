"""Automatic start of the RSI program, so that a client without EKI finds a streaming controller."""

from __future__ import annotations

from sim.kuka.controller.controller import Controller
from sim.kuka.controller_parameters import AUTOSTART_PAUSE_S


class Autostart:
    """Starts the program, and restarts it a while after a run has ended or was stopped.

    A client that went away, asked for the end or commanded what the arm cannot do is followed by the next
    run, and so is an emergency stop that was released: without EKI nobody else could acknowledge the message.
    """

    def __init__(self, controller: Controller, *, wanted: bool) -> None:
        self._controller = controller
        self._wanted = wanted
        self._armed = wanted
        self._ended_s: float | None = None

    @property
    def wanted(self) -> bool:
        """True when automatic start was requested."""
        return self._wanted

    def begin(self) -> None:
        """Drives on and first run."""
        if self._wanted:
            self._controller.switch_drives(True)
            self._controller.start(counts_from_first_reply=True)

    def tick(self, now_s: float) -> None:
        """Start again when it is time; called while the program is stopped or over, and the arm rests."""
        controller = self._controller
        if not self._armed:
            return
        if self._ended_s is None:
            self._ended_s = now_s
        elif now_s - self._ended_s >= AUTOSTART_PAUSE_S:
            self._ended_s = None
            controller.acknowledge()
            controller.switch_drives(True)
            controller.start(counts_from_first_reply=True)

    def give_way(self) -> None:
        """A client starts the program explicitly: an automatic run ends."""
        run = self._controller.run
        if self._armed and run is not None and run.settings.counts_from_first_reply:
            self._controller.cancel()
        self.disarm()

    def disarm(self) -> None:
        """Turn automatic start off."""
        self._armed = False
        self._ended_s = None

    def arm(self) -> None:
        """Turn automatic start on again, if it was requested."""
        self._armed = self._wanted

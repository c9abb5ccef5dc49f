"""Automatic start of the RSI program, for clients that do not use EKI."""

from __future__ import annotations

from sim.kuka.controller import Controller
from sim.kuka.controller_parameters import AUTOSTART_PAUSE_S


class Autostart:
    """Starts the RSI program, and restarts it after a pause whenever a run ends or is stopped.

    It also acknowledges the message of a fault or a released emergency stop: the only other way is EKI.
    """

    def __init__(self, controller: Controller, *, is_requested: bool) -> None:
        self._controller = controller
        self._wanted = is_requested
        self._armed = is_requested
        self._ended_s: float | None = None

    def begin(self) -> None:
        """Switch on the drives and start the first run."""
        if self._wanted:
            self._controller.switch_drives(True)
            self._controller.start(counts_from_first_reply=True)

    def tick(self, now_s: float) -> None:
        """Restart the program when due; call only while no program is running and the arm is at rest."""
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

    def yield_to_client(self) -> None:
        """Disarm and end an automatic run, because a client is starting the program explicitly."""
        run = self._controller.run
        if self._armed and run is not None and run.settings.counts_from_first_reply:
            self._controller.cancel()
        self.disarm()

    def disarm(self) -> None:
        """Suspend automatic start."""
        self._armed = False
        self._ended_s = None

    def arm(self) -> None:
        """Resume automatic start if it was requested at launch."""
        self._armed = self._wanted

"""Keeps control of a camera by reading its control privilege regularly."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from drivers.basler_stereo.control.channel import ControlChannel
from drivers.basler_stereo.control.privilege import require_control
from drivers.basler_stereo.errors import CameraLost, NoReply
from ronna_hw.errors import RonnaError

BEATS_PER_TIMEOUT = 4
SLOWEST_BEAT_S = 1.0
SILENT_BEATS = 2  # consecutive failures, including retries, before the camera may count as lost
ASK_LIMIT_S = 1.0
JOIN_LIMIT_S = 1.5


class Heartbeat:
    """A thread that reads the control privilege; calls `on_lost` once with the reason when it gives up.

    A silent camera is lost only after its time-out: until then it keeps us as its controller. Any command
    would restart the camera's timer, but reading the privilege also shows whether the camera has restarted or
    dropped us, and every device counts it as a heartbeat.
    """

    def __init__(
        self,
        control: ControlChannel,
        timeout_ms: int,
        on_lost: Callable[[RonnaError], None],
        name: str,
        *,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._control = control
        self._monotonic = monotonic
        self._timeout_s = timeout_ms / 1000.0
        self._period_s = min(SLOWEST_BEAT_S, self._timeout_s / BEATS_PER_TIMEOUT)
        self._on_lost = on_lost
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"{name}-heartbeat", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread; takes at most as long as one command to a dead peer."""
        self._ending.set()
        if threading.current_thread() is not self._thread:
            self._thread.join(JOIN_LIMIT_S)

    def _run(self) -> None:
        silent, answered_s = 0, self._monotonic()
        while not self._ending.wait(self._period_s):
            try:
                require_control(self._control, self._monotonic() + ASK_LIMIT_S)
                silent, answered_s = 0, self._monotonic()
            except NoReply as error:
                silent += 1
                silent_s = self._monotonic() - answered_s
                if silent < SILENT_BEATS or silent_s < self._timeout_s or self._ending.is_set():
                    continue
                lost = CameraLost(
                    f"{self._control.address} does not reply to the heartbeat",
                    limit=f"{self._timeout_s:g} s",
                    got=f"silent for {silent_s:.1f} s",
                )
                lost.__cause__ = error
                self._on_lost(lost)
                return
            except (RonnaError, OSError) as error:
                if self._ending.is_set():
                    return
                if not isinstance(error, RonnaError):
                    error = CameraLost(f"the link to {self._control.address} broke", got=str(error))
                self._on_lost(error)
                return

"""While the tracker is in use it must see the reference frame on the arm."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

from ronna_hw.devices import OpticalTracker
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import Validity
from ronna_hw.errors import RonnaError

PATIENCE_S = 0.2  # theatre time: a hand that passes is no finding (12 frames of a 60 Hz tracker)


class LineOfSight:
    """Looks at the frames that a step reads, and reads further ones itself while the sight is lost."""

    name = "line of sight"

    def __init__(self, tracker: OpticalTracker, frame: str, now_s: Callable[[], float]) -> None:
        """`frame` is the tracker's name of the reference frame, `now_s` the theatre's time."""
        self._tracker = tracker
        self._frame = frame
        self._now_s = now_s
        self._lost_since_s: float | None = None

    def unmet(self) -> str | None:
        """Why the frame has no pose, once that has lasted."""
        if self._tracker.state is not Lifecycle.ACTIVE or self._validity() is Validity.OK:
            self._lost_since_s = None
            return None
        now_s = self._now_s()
        if self._lost_since_s is None:
            self._lost_since_s = now_s
        if now_s - self._lost_since_s < PATIENCE_S:
            return None
        with contextlib.suppress(RonnaError):  # a lost reply; what lasts is latched by the tracker
            self._tracker.read_frame()
        if self._validity() is Validity.OK:
            self._lost_since_s = None
            return None
        return (
            f"the tracker does not see the reference frame {self._frame} ({self._validity()}): clear "
            "the line of sight between tracker and arm"
        )

    def _validity(self) -> Validity:
        frame = self._tracker.observe().reading
        return Validity.OK if frame is None else frame.tool(self._frame).validity

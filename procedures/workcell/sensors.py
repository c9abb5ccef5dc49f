"""What the cameras of the stereo head read and for how long they expose."""

from __future__ import annotations

from collections.abc import Callable

from procedures.workcell.stereo_look import area_around_tool, whole_sensor
from ronna_hw.calibration import StereoHeadCalibration
from ronna_hw.devices import StereoPair


class Sensors:
    """Area and exposure of both cameras."""

    def __init__(self, stereo: Callable[[], StereoPair], head: StereoHeadCalibration) -> None:
        self._stereo = stereo
        self._head = head
        self._exposure_share = 1.0  # of the configured one

    def read_around_tool(self, size_px: tuple[int, int]) -> None:
        """Read the part of each sensor, columns and rows, where the tool centre appears: faster than all."""
        left, right = (area_around_tool(side, size_px) for side in (self._head.left, self._head.right))
        self._stereo().set_areas(left, right)

    def read_whole(self) -> None:
        """Read all of both sensors."""
        self._stereo().set_areas(whole_sensor(self._head.left), whole_sensor(self._head.right))

    def expose(self, share: float) -> None:
        """Expose both sensors by that share of the configured time."""
        if share != self._exposure_share:
            self._stereo().scale_exposure(share)
            self._exposure_share = share

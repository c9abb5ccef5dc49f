"""Foreign senders of telegrams: counted, never answered, and named if the controller's own do not arrive."""

from __future__ import annotations

from math import degrees

from ronna_hw.devices.readings import JointVector

AXES_AGREE_DEG = 0.1  # between RSI and EKI at the start: they are read at different moments of rest


class Strangers:
    """Counts since a stream was opened."""

    def __init__(self, expected_rad: JointVector | None = None) -> None:
        """`expected_rad` are the axes as reported by the controller; None if it was not asked."""
        self._expected_rad = expected_rad
        self.count = 0
        self.host = ""  # of the last one
        self.disagreeing = 0  # readable telegrams with other axes, before the controller's first
        self.sent_last = False  # someone else has, since the controller's last telegram

    def met(self, host: str) -> None:
        """A telegram from a sender other than the controller."""
        self.count += 1
        self.host = host
        self.sent_last = True

    def agrees(self, axes_deg: JointVector) -> bool:
        """Whether a possible first telegram of the controller reports the expected axes."""
        expected = self._expected_rad
        if expected is None or all(
            abs(axis - degrees(angle)) <= AXES_AGREE_DEG
            for axis, angle in zip(axes_deg, expected, strict=True)
        ):
            return True
        self.disagreeing += 1
        return False

"""Numbers the triggers since AcquisitionStart, so that a retaken image is the same image."""

from __future__ import annotations


class TriggerCount:
    """The counter behind an image's noise.

    A client that has lost an image restarts the acquisition and triggers again. As long as it has changed
    neither the settings nor the camera's position, that trigger gets the previous number: an image lost on
    its way to the client changes none of those that follow.
    """

    def __init__(self) -> None:
        self._number = 0
        self._sight: object = None
        self._started = False

    def start(self) -> None:
        """AcquisitionStart."""
        self._started = False

    def next(self, sight: object) -> int:
        """Number of a trigger. `sight` is what the image shows, for comparison; None if unknown."""
        if self._started:
            self._number += 1
        elif sight is None or sight != self._sight:
            self._number = 1
        self._started, self._sight = True, sight
        return self._number

"""Numbers the triggers since AcquisitionStart, so that a picture that is taken again is the same picture."""

from __future__ import annotations


class TriggerCount:
    """The counter of a picture's noise.

    A client that has lost a picture starts the acquisition again and triggers once more. As long as it has
    changed neither the settings nor where the camera is, that trigger gets the number of the last one: a
    picture lost on its way to the client changes none of those that follow.
    """

    def __init__(self) -> None:
        self._number = 0
        self._sight: object = None
        self._started = False

    def start(self) -> None:
        """AcquisitionStart."""
        self._started = False

    def next(self, sight: object) -> int:
        """Number of a trigger. `sight` is what the picture shows, to compare; None when that is unknown."""
        if self._started:
            self._number += 1
        elif sight is None or sight != self._sight:
            self._number = 1
        self._started, self._sight = True, sight
        return self._number

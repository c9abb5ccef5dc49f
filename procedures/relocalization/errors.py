"""What can go wrong between an image of a sphere and its position. All are data errors: also `ValueError`."""

from __future__ import annotations

from ronna_hw.errors import EXIT_REFUSED, DataError


class BadImage(DataError):
    """The input is not one grey image of 8 or 12 bits."""

    code = "STE-001"
    action = "Give a 2-D array of uint8, or of uint16 with 12-bit values, at least 48 pixels on each side."


class NoContrast(DataError):
    """The image is dark or even: nothing stands out of it."""

    code = "STE-002"
    action = "Bring a lit sphere into view; else check lens caps and lights, then lengthen the exposure."


class NoSphere(DataError):
    """There is structure in the image, but no bright disc with enough of its rim in view."""

    code = "STE-003"
    action = "Search around this pose; if that fails too, check that the sphere is there, clean and lit."


class BadMeasurement(DataError):
    """Numbers handed to a computation are not finite, or not of the right shape."""

    code = "STE-004"
    action = "Measure again; do not repair the numbers."


class RaysDoNotMeet(DataError):
    """The two lines of sight pass each other too far apart to belong to one sphere."""

    code = "STE-005"
    action = "Check that both cameras see the same sphere, then check the stereo calibration."


class WrongSize(DataError):
    """What both cameras see is at a distance that makes it too large or too small for the sphere."""

    code = "STE-006"
    action = "Check what is in view: a glare, another sphere, or a marker of another diameter."


class ServoDiverges(DataError):
    """The residual does not shrink from step to step."""

    code = "STE-007"
    action = "Stop here: check the stereo calibration and that the head stands still, then start again."


class ServoExhausted(DataError):
    """The residual is still above the end condition after the last allowed step."""

    code = "STE-008"
    action = "Mark this sphere as failed, or check lens, light and arm and start again."


class SphereNotInView(DataError):
    """The whole search pattern was looked at without finding the sphere."""

    code = "STE-009"
    action = "Check the global localization of this sphere; skip it when enough others remain."


class WrongCamera(DataError):
    """The calibration belongs to another camera than the one that took the image."""

    code = "STE-010"
    action = "Use the calibration of the mounted head, or calibrate it."
    exit_code = EXIT_REFUSED


class Saturated(DataError):
    """The image is as bright as it can be all over: nothing can be seen in it, wherever the head looks."""

    code = "STE-011"
    action = "Shorten the exposure or lower the gain; look for a lamp or window that shines into the lens."


class PairNotUsable(DataError):
    """Again and again the two images are not whole, not of one moment, or one of them does not come."""

    code = "STE-012"
    action = "Look at both cameras with ronna-procedure doctor; check cables, trigger and network load."


class NotTrusted(DataError):
    """A sphere is in view, but too little of it, or too poorly, for a centre that can be trusted."""

    code = "STE-013"
    action = "Remove what hides it, clean sphere and lens, check focus and light; or look from elsewhere."

"""Whether images from two cameras are complete and well exposed, as diagnostics. Nothing moves."""

from __future__ import annotations

from collections.abc import Iterator

from ronna_hw.devices.probing import Diagnostic, refusal
from ronna_hw.devices.readiness import TellsReadiness, fact_diagnostics
from ronna_hw.devices.readings import StereoReading, Validity
from ronna_hw.devices.stereo import StereoPair
from ronna_hw.errors import RonnaError

MOST_SATURATED = 0.02  # of an image: lamps rather than film
LEAST_MEAN_SHARE = 0.002  # of the largest value: below this, an image is dark, or the lens is covered
LARGEST_GREY = {1: 255.0, 2: 4095.0}  # by the bytes of a pixel: Mono8, Mono12


def picture_diagnostics(subject: str, stereo: StereoPair, pairs: int) -> Iterator[Diagnostic]:
    """Take this many pairs with configured cameras: how many are complete, and the exposure of the last."""
    whole = 0
    last: StereoReading | None = None
    told: tuple[Diagnostic, ...] = ()
    try:
        with stereo.active():
            for _ in range(pairs):
                last = stereo.grab_pair()
                whole += int(last.validity is Validity.OK)
            if isinstance(stereo, TellsReadiness):
                told = tuple(fact_diagnostics(subject, stereo))  # about these images
    except RonnaError as error:
        yield refusal(f"{subject}pictures", error)
    yield Diagnostic(
        f"{subject}pictures",
        whole == pairs,
        f"{whole} of {pairs} pairs arrived complete",
        "" if whole == pairs else "Packets are lost: jumbo frames, cable, switch, receive buffer.",
    )
    yield from told
    if last is not None:
        yield from _exposed(subject, last)


def _exposed(subject: str, pair: StereoReading) -> Iterator[Diagnostic]:
    for side, image in (("left", pair.left), ("right", pair.right)):
        if image is None:
            continue
        largest = LARGEST_GREY[image.pixels.dtype.itemsize]
        saturated = float((image.pixels >= largest).mean())
        mean = float(image.pixels.mean()) / largest
        too_bright = saturated > MOST_SATURATED
        advice = "Reduce exposure_us, or remove the lamp that shines into the lens." if too_bright else ""
        if mean < LEAST_MEAN_SHARE:
            advice = "Nothing bright is in view: is the lens covered, or the ring light off?"
        yield Diagnostic(
            f"{subject}exposure of the {side} camera",
            not too_bright,
            f"mean {100.0 * mean:.1f} % of the largest value, {100.0 * saturated:.2f} % saturated",
            advice,
        )

"""Exposure and focus diagnostics for a pair of camera images.

Sharpness, and an image that is too dark, show only on a sphere near the tool centre: a head that looks at
nothing has dark images too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from procedures.planning.line_of_sight import SPHERE_RADIUS_MM
from procedures.relocalization import measure_sphere
from procedures.relocalization.errors import BadImage, NoContrast, NoSphere, Saturated
from procedures.relocalization.outline import TOO_FAINT, SphereImage, SphereStatus
from ronna_hw.calibration import CameraCalibration, StereoHeadCalibration
from ronna_hw.devices.probing import Diagnostic
from ronna_hw.devices.readings import CameraImage, StereoReading
from ronna_hw.errors import RonnaError

MOST_SATURATED = 0.02  # of an image: lamps rather than film
LARGEST_GREY = {1: 255.0, 2: 4095.0}  # by the bytes of a pixel: Mono8, Mono12
NEAR_TOOL = 0.1  # of the radius at the tool centre: nearer or farther, a sphere is rightly out of focus
MOST_BLUR_PX = 10.0  # of a rim there: 1 to 2 px in focus, 7 px at the ends of that range
MOST_SIGMA_PX = 0.1  # of a centre
NOT_JUDGED = "exposure and focus were not judged: {}"
SHOW_A_SPHERE = "To have them judged, bring a sphere to the tool centre (ronna-stereo measure --find)."
DARK = "The other camera sees the sphere: check lens cap, ring light and exposure_us."
UNSHARP = "Focus the lens on the tool centre and clean it, then calibrate the head."


def pair_diagnostics(
    subject: str, pair: StereoReading, head: StereoHeadCalibration | None
) -> Iterator[Diagnostic]:
    """Yield exposure and focus diagnostics for both images, as far as the view allows."""
    records = (None, None) if head is None else (head.left, head.right)
    images = (pair.left, pair.right)
    found = [_sphere_near_tool(image, record) for image, record in zip(images, records, strict=True)]
    for number, (side, image) in enumerate(zip(("left", "right"), images, strict=True)):
        if image is not None:
            other_sees_sphere = _shows_central_sphere(images[1 - number], found[1 - number])
            yield _judge_camera(
                f"{subject}exposure of the {side} camera", image, found[number], other_sees_sphere
            )


def _sphere_near_tool(
    image: CameraImage | None, record: CameraCalibration | None
) -> SphereImage | RonnaError | None:
    """Find a sphere at about the tool centre's distance; return it, the error, or None if not searched."""
    if image is None or record is None:
        return None
    radius_px = SPHERE_RADIUS_MM * record.focal_px[0] / math.hypot(*record.camera_from_tool.translation_mm)
    try:
        return measure_sphere(
            image.pixels, radius_range_px=((1.0 - NEAR_TOOL) * radius_px, (1.0 + NEAR_TOOL) * radius_px)
        )
    except (NoContrast, NoSphere, Saturated, BadImage) as error:
        return error


def _shows_central_sphere(image: CameraImage | None, finding: SphereImage | RonnaError | None) -> bool:
    """Return whether this camera sees a sphere so central that the other must see at least part of it."""
    if image is None or not isinstance(finding, SphereImage):
        return False
    rows, columns = image.pixels.shape
    x, y = finding.centre_px
    return bool(0.25 < x / columns < 0.75 and 0.25 < y / rows < 0.75)


def _judge_camera(
    subject: str, image: CameraImage, finding: SphereImage | RonnaError | None, other_sees_sphere: bool
) -> Diagnostic:
    largest = LARGEST_GREY[image.pixels.dtype.itemsize]
    saturated = float((image.pixels >= largest).mean())
    mean = float(image.pixels.mean()) / largest
    figures = f"mean {100.0 * mean:.1f} % of the largest value, {100.0 * saturated:.2f} % saturated"
    if saturated > MOST_SATURATED:
        advice = "Reduce exposure_us, or remove the lamp that shines into the lens."
        return Diagnostic(subject, False, f"too bright: {figures}", advice)
    if isinstance(finding, NoContrast) and other_sees_sphere:
        return Diagnostic(subject, False, f"too dark: {figures}", DARK)
    if not isinstance(finding, SphereImage):
        why = "without a calibration record" if finding is None else "no sphere near the tool centre"
        return Diagnostic(subject, True, f"{figures}; {NOT_JUDGED.format(why)}", SHOW_A_SPHERE)
    sigma_px = math.sqrt(max(finding.covariance_px2[0][0], finding.covariance_px2[1][1]))
    figures += f"; a sphere to {sigma_px:.2f} px, its rim {finding.blur_px:.1f} px soft"
    if finding.blur_px > MOST_BLUR_PX:
        return Diagnostic(subject, False, f"not sharp: {figures}", UNSHARP)
    if finding.doubt == TOO_FAINT or (finding.status is SphereStatus.OK and sigma_px > MOST_SIGMA_PX):
        advice = "Lengthen exposure_us, check the ring light, clean lens and sphere."
        return Diagnostic(subject, False, f"too dark: {figures}", advice)
    if finding.doubt:
        return Diagnostic(subject, True, f"{figures}; {NOT_JUDGED.format(finding.doubt)}", SHOW_A_SPHERE)
    return Diagnostic(subject, True, figures)

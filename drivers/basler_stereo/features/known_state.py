"""Known, verified camera settings: trigger, exposure, gain, pixel format, area."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from drivers.basler_stereo.errors import BAD_DESCRIPTION, MISSING_FEATURE, OUT_OF_RANGE
from drivers.basler_stereo.features.description import Number
from drivers.basler_stereo.features.feature_map import Limits
from drivers.basler_stereo.options import BaslerOptions
from ronna_hw.devices.readings import AreaOfInterest
from ronna_hw.wire import gige_vision as gev

# this family uses the first name, later standards the others
EXPOSURE_NAMES = ("ExposureTimeAbs", "ExposureTime", "ExposureTimeRaw")
GAIN_NAMES = ("GainRaw", "Gain")
TEMPERATURE_NAMES = ("TemperatureAbs", "DeviceTemperature")  # whether this model has one is unconfirmed
SENSOR_WIDTH_NAMES = ("SensorWidth", "WidthMax")
SENSOR_HEIGHT_NAMES = ("SensorHeight", "HeightMax")

FRAME_TRIGGER = "FrameStart"
SOFTWARE, ACTION, LINE = "Software", "Action1", "Line1"
TRIGGER_SOURCES = {"software": SOFTWARE, "action": ACTION, "line1": LINE}
ACTION_GROUP_MASK = 1
# features that would alter images without our knowledge, if a camera has them
_FIXED_CHOICES = (
    ("ExposureMode", "Timed"),
    ("ExposureAuto", "Off"),
    ("GainAuto", "Off"),
    ("GainSelector", "All"),
    ("TestImageSelector", "Off"),
)


class Features(Protocol):
    """Camera features by name; unknown names and values raise GEV-010."""

    def has(self, name: str) -> bool: ...

    def number(self, name: str) -> Number: ...

    def entries(self, name: str) -> Iterable[str]: ...

    def choice(self, name: str) -> str: ...

    def limits(self, name: str) -> Limits: ...

    def set_number(self, name: str, value: Number) -> None: ...

    def choose(self, name: str, entry: str) -> None: ...

    def execute(self, name: str) -> None: ...


def read_temperature_C(features: Features) -> float | None:
    """Read the internal temperature, or None if the camera does not report it."""
    name = next(filter(features.has, TEMPERATURE_NAMES), None)
    return None if name is None else float(features.number(name))


def apply_known_state(features: Features, options: BaslerOptions, camera: str) -> None:
    """Apply all settings except the area; `camera` is the name used in messages.

    Raises GEV-010 for missing features, GEV-011 for impossible values.
    """
    if features.has("AcquisitionStop"):  # a library may hide it while nothing is running
        features.execute("AcquisitionStop")
    lock_transport(features, False)  # an earlier client may have left it locked
    if options.load_default_user_set and features.has("UserSetLoad"):
        features.choose("UserSetSelector", "Default")
        features.execute("UserSetLoad")
    features.choose("AcquisitionMode", "Continuous")
    for name, entry in _FIXED_CHOICES:
        if features.has(name) and entry in features.entries(name):
            features.choose(name, entry)
    arm_trigger(features, options)
    features.choose("PixelFormat", options.pixel_format)
    set_exposure(features, options.exposure_us, options.gain_raw, camera)


def lock_transport(features: Features, locked: bool) -> None:
    """Lock or unlock the image geometry and pixel format in the camera."""
    if features.has("TLParamsLocked"):
        features.set_number("TLParamsLocked", int(locked))


def arm_trigger(features: Features, options: BaslerOptions) -> None:
    """Arm the selected source for one frame per trigger and disable all other triggers; raises GEV-010.

    Old firmware may lack the action trigger: then its name is not among the entries.
    """
    source = TRIGGER_SOURCES[options.trigger]
    if source == SOFTWARE and not features.has("TriggerSoftware"):
        raise MISSING_FEATURE("the camera has no software trigger")
    for kind in features.entries("TriggerSelector"):
        features.choose("TriggerSelector", kind)
        features.choose("TriggerMode", "Off")
    features.choose("TriggerSelector", FRAME_TRIGGER)
    features.choose("TriggerSource", source)
    if source == ACTION:
        features.set_number("ActionDeviceKey", options.action_device_key)
        if features.has("ActionSelector"):
            features.set_number("ActionSelector", 1)
        features.set_number("ActionGroupKey", options.action_group_key)
        features.set_number("ActionGroupMask", ACTION_GROUP_MASK)
    features.choose("TriggerMode", "On")


def set_exposure(features: Features, exposure_us: float, gain_raw: int | None, camera: str) -> None:
    """Set exposure in microseconds and raw gain (None: the minimum); raises GEV-011 with the limits.

    `camera` is the name used in messages, for example `left camera`.
    """
    exposure, gain = _find_feature(features, EXPOSURE_NAMES), _find_feature(features, GAIN_NAMES)
    _require_within(features, exposure, exposure_us, f"exposure_us of the {camera}")
    wanted_gain = features.limits(gain).minimum or 0 if gain_raw is None else gain_raw
    _require_within(features, gain, wanted_gain, f"gain_raw of the {camera}")
    features.set_number(exposure, round(exposure_us) if exposure.endswith("Raw") else exposure_us)
    features.set_number(gain, wanted_gain)


def full_area(features: Features) -> AreaOfInterest:
    """Return the full sensor area."""
    size = (_find_feature(features, names) for names in (SENSOR_WIDTH_NAMES, SENSOR_HEIGHT_NAMES))
    return AreaOfInterest(0, 0, *(int(features.number(name)) for name in size))


def set_area(features: Features, area: AreaOfInterest) -> None:
    """Set the sensor area to read out; raises GEV-011 with the limits.

    The offsets go to zero first: the camera rejects a size that does not fit at its current offset.
    """
    sensor = full_area(features)
    if area == read_area(features):
        return
    _require_area(features, area, sensor)
    features.set_number("OffsetX", 0)
    features.set_number("OffsetY", 0)
    features.set_number("Width", area.width)
    features.set_number("Height", area.height)
    features.set_number("OffsetX", area.offset_x)
    features.set_number("OffsetY", area.offset_y)
    if (found := read_area(features)) != area:
        raise OUT_OF_RANGE(
            "the camera set a different area", expected=_format_area(area), got=_format_area(found)
        )


def read_area(features: Features) -> AreaOfInterest:
    """Read the current readout area."""
    names = ("OffsetX", "OffsetY", "Width", "Height")
    return AreaOfInterest(*(int(features.number(name)) for name in names))


def payload_bytes(features: Features, area: AreaOfInterest, pixel_format: int) -> int:
    """Return the image size in bytes; raises GEV-009 if the camera reports another payload size."""
    expected = image_bytes(area, pixel_format)
    if features.has("PayloadSize") and (reported_bytes := int(features.number("PayloadSize"))) != expected:
        raise BAD_DESCRIPTION(
            "payload size does not match the area", expected=str(expected), got=str(reported_bytes)
        )
    return expected


def image_bytes(area: AreaOfInterest, pixel_format: int) -> int:
    """Return the image size in bytes, without padding."""
    bits = pixel_format >> gev.PIXEL_FORMAT_BITS_SHIFT & gev.PIXEL_FORMAT_BITS_MASK
    return -(-area.width * area.height * bits // 8)


def _require_area(features: Features, area: AreaOfInterest, sensor: AreaOfInterest) -> None:
    fits_across = 0 <= area.offset_x < area.offset_x + area.width <= sensor.width
    fits_down = 0 <= area.offset_y < area.offset_y + area.height <= sensor.height
    if not (fits_across and fits_down):
        raise OUT_OF_RANGE("the area exceeds the sensor", limit=_format_area(sensor), got=_format_area(area))
    for name, value in (
        ("Width", area.width),
        ("Height", area.height),
        ("OffsetX", area.offset_x),
        ("OffsetY", area.offset_y),
    ):
        limits = features.limits(name)
        start, step = int(limits.minimum or 0), int(limits.step or 1)
        if value < start or (value - start) % step:
            raise OUT_OF_RANGE(
                f"{name} {value}", limit=f"from {start} in steps of {step}", got=_format_area(area)
            )


def _require_within(features: Features, name: str, value: Number, what: str) -> None:
    limits = features.limits(name)
    low, high = limits.minimum, limits.maximum
    if (low is not None and value < low) or (high is not None and value > high):
        raise OUT_OF_RANGE(f"{what} is {value:g}", limit=f"{low} to {high} ({name})")


def _find_feature(features: Features, names: tuple[str, ...]) -> str:
    for name in names:
        if features.has(name):
            return name
    raise MISSING_FEATURE(f"the camera has none of {', '.join(names)}")


def _format_area(area: AreaOfInterest) -> str:
    return f"{area.width}x{area.height}+{area.offset_x}+{area.offset_y}"

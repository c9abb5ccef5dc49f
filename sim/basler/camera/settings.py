"""Settings of a camera: the values behind its features, and those used by one frame."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from enum import IntEnum

from ronna_hw.wire.gige_vision import (
    GAIN_RAW_MINIMUM,
    PIXEL_FORMAT_BITS_MASK,
    PIXEL_FORMAT_BITS_SHIFT,
    SENSOR_HEIGHT_PX,
    SENSOR_WIDTH_PX,
    PixelFormat,
)
from sim.basler.message.events import EventKind
from sim.basler.optics.canvas import Area

DEFAULT_EXPOSURE_US = 4000
DEFAULT_BLACK_LEVEL_RAW = 32
DEFAULT_FRAME_RATE_HZ = 50.0


class AcquisitionMode(IntEnum):
    """How many frames an AcquisitionStart yields."""

    SINGLE_FRAME = 0
    CONTINUOUS = 1


class Trigger(IntEnum):
    """Entries of TriggerSelector."""

    ACQUISITION_START = 0
    FRAME_START = 1


class TriggerSource(IntEnum):
    """Entries of TriggerSource. Pulses on Line1 come from the fault script only."""

    SOFTWARE = 0
    LINE_1 = 1
    ACTION_1 = 2


class RampImage(IntEnum):
    """Entries of TestImageSelector: none, a fixed ramp, a ramp that moves with every frame."""

    OFF = 0
    FIXED = 1
    MOVING = 2


class UserSet(IntEnum):
    """Entries of UserSetSelector."""

    DEFAULT = 0
    FIRST = 1
    SECOND = 2
    THIRD = 3


@dataclass
class TriggerSettings:
    """Settings of one trigger."""

    mode: int = 0
    source: int = TriggerSource.SOFTWARE
    activation: int = 0
    delay_us: float = 0.0


@dataclass(frozen=True)
class FrameSettings:
    """The settings of one frame."""

    area: Area
    pixel_format: PixelFormat
    exposure_us: int
    gain_raw: int
    black_level_raw: int
    test_image: RampImage

    @property
    def payload_bytes(self) -> int:
        """Size of the image on the wire."""
        return self.area.width * self.area.height * bits_per_pixel(self.pixel_format) // 8


@dataclass
class Settings:
    """Power-on values of everything in a user set, and the selectors."""

    width: int = SENSOR_WIDTH_PX
    height: int = SENSOR_HEIGHT_PX
    offset_x: int = 0
    offset_y: int = 0
    pixel_format: int = PixelFormat.MONO8
    test_image: int = RampImage.OFF
    acquisition_mode: int = AcquisitionMode.CONTINUOUS
    acquisition_frame_count: int = 1
    frame_rate_enabled: int = 0
    frame_rate_hz: float = DEFAULT_FRAME_RATE_HZ
    exposure_us: int = DEFAULT_EXPOSURE_US
    gain_raw: int = GAIN_RAW_MINIMUM
    black_level_raw: int = DEFAULT_BLACK_LEVEL_RAW
    trigger_selector: int = Trigger.FRAME_START
    triggers: tuple[TriggerSettings, TriggerSettings] = field(
        default_factory=lambda: (TriggerSettings(), TriggerSettings())
    )
    status_selector: int = 0
    action_device_key: int = 0
    action_selector: int = 1
    action_group_key: int = 0
    action_group_mask: int = 0
    event_selector: int = EventKind.EXPOSURE_END
    events_notified: frozenset[int] = frozenset()
    user_set_selector: int = UserSet.DEFAULT
    parameters_locked: int = 0

    @property
    def selected_trigger(self) -> TriggerSettings:
        """The trigger selected by TriggerSelector."""
        return self.triggers[self.trigger_selector]

    def frame(self) -> FrameSettings:
        """The settings of a frame that starts now."""
        return FrameSettings(
            Area(self.offset_x, self.offset_y, self.width, self.height),
            PixelFormat(self.pixel_format),
            self.exposure_us,
            self.gain_raw,
            self.black_level_raw,
            RampImage(self.test_image),
        )

    def copy(self) -> Settings:
        """An independent copy."""
        return copy.deepcopy(self)


def bits_per_pixel(pixel_format: PixelFormat) -> int:
    """Bits per pixel on the wire."""
    return pixel_format >> PIXEL_FORMAT_BITS_SHIFT & PIXEL_FORMAT_BITS_MASK

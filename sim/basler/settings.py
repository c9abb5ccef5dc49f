"""Camera and frame settings, and the timing derived from them."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from enum import IntEnum

from ronna_hw.clock import SharedClock
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import PixelFormat
from sim.basler.faults import NO_FAULTS, CameraFaults
from sim.basler.optics.canvas import Area

DEFAULT_EXPOSURE_US = 4000
DEFAULT_BLACK_LEVEL_RAW = 32
DEFAULT_FRAME_RATE_HZ = 50.0

FULL_FRAME_RATE_HZ = 50.0
ROW_US = 1e6 / FULL_FRAME_RATE_HZ / gev.SENSOR_HEIGHT_PX  # read-out of one row
LINK_BYTES_PER_S = 115e6  # image data on 1 Gbit/s: 50 frames/s of 8 bits, 26 of 12, 34 of 12 packed
NS_PER_TICK = 1_000_000_000 // gev.TICK_FREQUENCY_HZ
# In lock-step two triggers within this host time belong together, and the theatre time between them is at
# most that between two software triggers on a real network.
SAME_PAIR_HOST_NS = 500_000_000
SOFTWARE_TRIGGER_SKEW_NS = 1_000_000


class EventKind(IntEnum):
    """Entries of EventSelector, with their wire ids as values.

    A vendor's ids begin at 0x9000; their assignment in real firmware is unconfirmed. A client reads them
    from the description.
    """

    EXPOSURE_END = 0x9001
    FRAME_START_OVERTRIGGER = 0x9002
    ACQUISITION_START_OVERTRIGGER = 0x9003
    FRAME_START = 0x9004
    ACQUISITION_START = 0x9005
    EVENT_OVERRUN = 0x9006

    @property
    def feature_name(self) -> str:
        """Entry name, spelled as in the camera family."""
        return "".join(word.capitalize() for word in self.name.split("_"))


class AcquisitionMode(IntEnum):
    """Entries of AcquisitionMode."""

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


class Line(IntEnum):
    """Entries of LineSelector: the opto-isolated input and output of this camera family."""

    LINE_1 = 0
    OUT_1 = 1


class LineSource(IntEnum):
    """Entries of LineSource for the output; flash window and timer are not simulated."""

    EXPOSURE_ACTIVE = 0
    FRAME_TRIGGER_WAIT = 1
    ACQUISITION_TRIGGER_WAIT = 2
    USER_OUTPUT = 3


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
    """Trigger settings."""

    mode: int = 0
    source: int = TriggerSource.SOFTWARE
    activation: int = 0
    delay_us: float = 0.0


@dataclass(frozen=True)
class FrameSettings:
    """Settings that apply to a single frame.

    `line_lit` says whether the left camera's output line lights the projector during its exposure.
    """

    area: Area
    pixel_format: PixelFormat
    exposure_us: int
    gain_raw: int
    black_level_raw: int
    test_image: RampImage
    line_lit: bool = False

    @property
    def payload_bytes(self) -> int:
        """Image size on the wire, in bytes."""
        return self.area.width * self.area.height * bits_per_pixel(self.pixel_format) // 8


@dataclass
class CameraSettings:
    """User set contents and selectors, with the power-on values as defaults."""

    width: int = gev.SENSOR_WIDTH_PX
    height: int = gev.SENSOR_HEIGHT_PX
    offset_x: int = 0
    offset_y: int = 0
    pixel_format: int = PixelFormat.MONO8
    test_image: int = RampImage.OFF
    acquisition_mode: int = AcquisitionMode.CONTINUOUS
    acquisition_frame_count: int = 1
    frame_rate_enabled: int = 0
    frame_rate_hz: float = DEFAULT_FRAME_RATE_HZ
    exposure_us: int = DEFAULT_EXPOSURE_US
    gain_raw: int = gev.GAIN_RAW_MINIMUM
    black_level_raw: int = DEFAULT_BLACK_LEVEL_RAW
    trigger_selector: int = Trigger.FRAME_START
    triggers: tuple[TriggerSettings, TriggerSettings] = field(
        default_factory=lambda: (TriggerSettings(), TriggerSettings())
    )
    status_selector: int = 0
    line_selector: int = Line.LINE_1
    lines_inverted: tuple[int, int] = (0, 0)  # by line
    line_source: int = LineSource.EXPOSURE_ACTIVE  # as the manual of the family has it at power-on
    user_output_selector: int = 1
    user_output_value: int = 0
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
        """Settings of the trigger selected by TriggerSelector."""
        return self.triggers[self.trigger_selector]

    def frame(self) -> FrameSettings:
        """Return the settings for a frame that starts now."""
        return FrameSettings(
            Area(self.offset_x, self.offset_y, self.width, self.height),
            PixelFormat(self.pixel_format),
            self.exposure_us,
            self.gain_raw,
            self.black_level_raw,
            RampImage(self.test_image),
        )


def bits_per_pixel(pixel_format: PixelFormat) -> int:
    """Return the number of bits per pixel on the wire."""
    return pixel_format >> gev.PIXEL_FORMAT_BITS_SHIFT & gev.PIXEL_FORMAT_BITS_MASK


def readout_us(frame: FrameSettings) -> float:
    """Return the read-out time, from the end of exposure."""
    return frame.area.height * ROW_US


def shortest_period_us(frame: FrameSettings) -> float:
    """Return the shortest frame period, set by the slowest of exposure, read-out and transfer."""
    return max(float(frame.exposure_us), readout_us(frame), frame.payload_bytes / LINK_BYTES_PER_S * 1e6)


def free_running_period_us(settings: CameraSettings) -> float:
    """Return the frame period when no frame trigger is used."""
    shortest = max(shortest_period_us(settings.frame()), 1e6 / FULL_FRAME_RATE_HZ)
    return max(shortest, 1e6 / settings.frame_rate_hz) if settings.frame_rate_enabled else shortest


class TriggerMoments:
    """Trigger times in theatre time, shared by both cameras.

    In real time a trigger acts when it arrives. In lock-step the first camera's frame may have advanced the
    theatre before the second trigger arrives: that one is then backdated to the first, so that a pair
    triggered sequentially stays a pair and does not take twice the time.
    """

    def __init__(self, clock: SharedClock) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        # Camera, host time and theatre time of the first trigger of a pair.
        self._first: tuple[str, int, int] | None = None

    def stamp_trigger(self, camera: str) -> int:
        """Return the theatre time in ns of the trigger now reaching this camera."""
        now = self._clock.now_ns()
        if self._clock.paced:
            return now
        host = time.monotonic_ns()
        with self._lock:
            first = self._first
            if first is None or first[0] == camera or host - first[1] > SAME_PAIR_HOST_NS:
                self._first = (camera, host, now)
                return now
            self._first = None
            return min(now, first[2] + SOFTWARE_TRIGGER_SKEW_NS)


class Ticks:
    """Camera time stamp counter, driven by the theatre clock."""

    def __init__(self, clock: SharedClock, faults: CameraFaults = NO_FAULTS) -> None:
        self._clock = clock
        self._faults = faults
        self._zero_ns = 0
        self._last_stamp = 0
        self._gained_ns = 0.0  # by drift
        self._drifted_until_ns = 0
        self.latched = 0

    def stamp(self, moment_ns: int) -> int:
        """Return a frame's time stamp in ticks, unique even among frames at the same theatre time."""
        self._last_stamp = max(self.count(moment_ns), self._last_stamp + 1)
        return self._last_stamp

    def latch(self) -> None:
        """Latch the present count for reading."""
        self.latched = self.count(self._clock.now_ns())

    def reset(self) -> None:
        """Reset the counter to zero."""
        self._zero_ns = self._clock.now_ns()
        self._last_stamp = 0

    def count(self, moment_ns: int) -> int:
        """Return the tick count at a theatre time; for frame time stamps, use `stamp` instead."""
        if self._faults.happened("reset_clock"):
            self.reset()
        drift_ppm = self._faults.drift_ppm()
        if drift_ppm:
            self._gained_ns += max(0, moment_ns - self._drifted_until_ns) * drift_ppm * 1e-6
        self._drifted_until_ns = moment_ns
        return max(0, moment_ns - self._zero_ns + round(self._gained_ns)) // NS_PER_TICK

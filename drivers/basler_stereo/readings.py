"""Camera pair readings: validated read-only images, matched by the cameras' clocks. No I/O."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.basler_stereo.features.known_state import image_bytes
from drivers.basler_stereo.stream.frame_assembler import ReceivedImage
from ronna_hw.devices.readings import AreaOfInterest, CameraImage, Stamp, StereoReading, Validity
from ronna_hw.wire.gige_vision import PixelFormat

DRIFT = 2e-4  # of one camera's clock relative to another: 100 ppm each
_WORST_FIRST = (
    Validity.MISSING,
    Validity.CORRUPT,
    Validity.UNPAIRED,
    Validity.STALE,
    Validity.PARTIAL,
    Validity.OK,
)


def camera_image(
    frame: ReceivedImage,
    serial: str,
    area: AreaOfInterest,
    pixel_format: PixelFormat,
    sequence: int,
    theatre_time_s: float,
    measured_s: float | None = None,
) -> CameraImage | None:
    """Build the image of one side, or return None without a leader, which carries time and shape.

    CORRUPT: area or pixel format in the leader differ from the settings. PARTIAL: packets are missing,
    and their pixels are 0.
    """
    if frame.leader is None:
        return None
    matches_settings = (
        frame.leader.area == area
        and frame.leader.pixel_format == pixel_format
        and frame.leader.padding_x == 0
        and len(frame.data) == image_bytes(area, pixel_format)
    )
    validity = Validity.PARTIAL if frame.missing_packets else Validity.OK
    return CameraImage(
        stamp=Stamp(sequence, frame.leader.ticks, theatre_time_s, measured_s),
        validity=validity if matches_settings else Validity.CORRUPT,
        serial=serial,
        pixels=decode_pixels(frame.data, area, pixel_format),
        area=area,
        missing_packets=frame.missing_packets,
    )


def stereo_reading(
    left: CameraImage | None,
    right: CameraImage | None,
    sequence: int,
    theatre_time_s: float,
    match: Validity = Validity.OK,
) -> StereoReading:
    """Combine both images of a trigger; the validity is the worst of left, right and `match`.

    Its device clock is the left camera's.
    """
    stamped = left or right
    ticks = stamped.stamp.device_clock if stamped else 0
    validities = [side.validity if side else Validity.MISSING for side in (left, right)]
    worst = next(validity for validity in _WORST_FIRST if validity in (*validities, match))
    measured_s = stamped.stamp.measured_s if stamped else None
    return StereoReading(Stamp(sequence, ticks, theatre_time_s, measured_s), worst, left, right)


def decode_pixels(
    data: bytearray | memoryview, area: AreaOfInterest, pixel_format: PixelFormat
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Decode 8-bit or 12-bit grey values, shape (height, width), read-only."""
    pixels: NDArray[np.uint8] | NDArray[np.uint16]
    if pixel_format is PixelFormat.MONO8:
        pixels = np.frombuffer(data, dtype=np.uint8)
    elif pixel_format is PixelFormat.MONO12:
        pixels = np.frombuffer(data, dtype="<u2").astype(np.uint16, copy=False)
    else:
        pixels = unpack_12_bits(np.frombuffer(data, dtype=np.uint8), area.width * area.height)
    pixels = pixels.reshape(area.height, area.width)
    pixels.flags.writeable = False
    return pixels


def unpack_12_bits(packed: NDArray[np.uint8], count: int) -> NDArray[np.uint16]:
    """Unpack Mono12Packed: two values in three bytes, with their low four bits in the middle byte."""
    padded = np.zeros(-(-count // 2) * 3, dtype=np.uint16)
    padded[: len(packed)] = packed
    first, shared, second = padded[0::3], padded[1::3], padded[2::3]
    values = np.empty(2 * len(first), dtype=np.uint16)
    values[0::2] = first << 4 | shared & 0x0F
    values[1::2] = second << 4 | shared >> 4
    return values[:count]


@dataclass(frozen=True)
class Tie:
    """Camera tick count at a theatre time known to within `uncertainty_s`."""

    ticks: int
    frequency_hz: int
    theatre_s: float
    uncertainty_s: float

    def moment_s(self, ticks: int) -> float:
        """Convert a tick count to theatre time."""
        return self.theatre_s + (ticks - self.ticks) / self.frequency_hz

    def error_s(self, now_s: float) -> float:
        """Return an upper bound on the error of `moment_s` at theatre time `now_s`."""
        return self.uncertainty_s + DRIFT * max(0.0, now_s - self.theatre_s)


class PairClock:
    """Checks by camera clock whether two images come from the same trigger.

    Each camera counts ticks from its own zero. Latching the counter at the start of the stream ties it to
    theatre time; every correctly paired image renews the tie, so that clock drift does not accumulate.
    `skew_s` is the largest difference between the exposure starts of one trigger.
    """

    def __init__(self, ties: tuple[Tie | None, Tie | None], skew_s: float) -> None:
        self._ties = ties
        self._skew_s = skew_s

    @property
    def is_tied(self) -> bool:
        """Whether both tick counters are tied to theatre time."""
        return None not in self._ties

    def moments_s(self, ticks: tuple[int, int]) -> tuple[float | None, float | None]:
        """Return the theatre time at which each exposure began, if known."""
        left, right = (
            tie.moment_s(count) if tie else None for tie, count in zip(self._ties, ticks, strict=True)
        )
        return left, right

    def judge_pair(
        self, ticks: tuple[int, int], frequencies_hz: tuple[int, int], triggered_s: float, now_s: float
    ) -> Validity:
        """Return UNPAIRED for images from different triggers, STALE for outdated ones, otherwise OK.

        `triggered_s` and `now_s` are theatre times before the trigger and after both images arrived. Without
        ties the first pair cannot be judged. A valid pair ties both clocks to a time between its trigger and
        now.
        """
        left, right = self.moments_s(ticks)
        error_s = sum(tie.error_s(now_s) for tie in self._ties if tie)
        if left is not None and right is not None:
            if abs(left - right) > self._skew_s + error_s:
                return Validity.UNPAIRED
            if max(left, right) < triggered_s - self._skew_s - error_s:
                return Validity.STALE
        known = [moment_s for moment_s in (left, right) if moment_s is not None]
        moment_s = min(max(triggered_s, sum(known) / len(known) if known else triggered_s), now_s)
        first, second = (
            Tie(count, frequency, moment_s, tie.uncertainty_s if tie else self._skew_s) if frequency else None
            for count, frequency, tie in zip(ticks, frequencies_hz, self._ties, strict=True)
        )
        self._ties = (first, second)
        return Validity.OK

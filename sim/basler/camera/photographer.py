"""Takes images: one per trigger, or from a ring of prepared ones when free-running."""

from __future__ import annotations

import threading
import time
from typing import Protocol

import numpy as np

from ronna_hw.wire.gige_vision import PixelFormat
from sim.basler.camera.settings import FrameSettings, RampImage, bits_per_pixel
from sim.basler.camera.view import Disturbances, Pose, View
from sim.basler.faults import NO_FAULTS, CameraFaults
from sim.basler.optics.picture import Optics
from sim.basler.optics.sensor import Pixels, Sensor
from sim.world.noise import noise
from sim.world.scene.model import CameraTruth
from sim.world.world import World


def to_wire(pixels: Pixels, pixel_format: PixelFormat) -> bytes:
    """Bytes of an image (rows, columns); its width is even."""
    if pixel_format is PixelFormat.MONO12:
        return pixels.astype("<u2").tobytes()
    if pixel_format is PixelFormat.MONO12_PACKED:
        first, second = pixels[:, 0::2].astype(np.uint16), pixels[:, 1::2].astype(np.uint16)
        packed = np.empty((*first.shape, 3), np.uint8)
        packed[..., 0] = first >> 4
        packed[..., 1] = (second & 0xF) << 4 | first & 0xF
        packed[..., 2] = second >> 4
        return packed.tobytes()
    return pixels.tobytes()


def depth_bits(pixel_format: PixelFormat) -> int:
    """Bits per pixel value."""
    return 8 if bits_per_pixel(pixel_format) == 8 else 12


def ramp_image(frame: FrameSettings, number: int) -> Pixels:
    """A diagonal ramp that repeats every 256 (or 4096) pixels; the moving one shifts by one each frame."""
    shift = number if frame.test_image is RampImage.MOVING else 0
    rows = np.arange(frame.area.y, frame.area.y + frame.area.height)[:, None]
    columns = np.arange(frame.area.x, frame.area.x + frame.area.width)[None, :]
    if depth_bits(frame.pixel_format) == 8:
        return (rows + columns + shift).astype(np.uint8)
    return ((rows + columns + shift) & 0xFFF).astype(np.uint16)


RING_SIZE = 6  # enough that consecutive frames never have the same noise
REFRESH_PAUSE_S = 0.05  # between two images for the ring, so that drawing leaves time for the stream
TRIGGERED_LANE, RING_LANE = 0, 1  # of the noise


class FrameSource(Protocol):
    """Source of an acquisition's images."""

    def place(self) -> bytes | None:
        """Camera position, for comparison; None if unknown. May be called from any thread."""
        ...

    def triggered(self, frame: FrameSettings, number: int) -> bytes:
        """The image of trigger `number` since AcquisitionStart."""
        ...

    def running(self, frame: FrameSettings, number: int) -> tuple[FrameSettings, bytes]:
        """A frame without a trigger, possibly taken with slightly older settings."""
        ...


class Photographer:
    """The images of one camera of the theatre.

    The same trigger number, settings and head pose yield the same bytes.
    """

    def __init__(self, world: World, camera: CameraTruth, faults: CameraFaults = NO_FAULTS) -> None:
        self._faults = faults
        self._seed = world.scene.seed
        self._serial = camera.serial
        self._view = View(world, camera)
        self._disturbances = Disturbances.of(world, camera)
        self._optics = Optics(camera, world.scene.seed)
        self._sensor = Sensor(camera.read_noise_electrons, camera.full_well_electrons)
        self._drawing = threading.Lock()
        self._ring = Ring(self)

    def place(self) -> bytes | None:
        pose = self._view.pose()
        return None if pose is None else pose.tobytes()

    def triggered(self, frame: FrameSettings, number: int) -> bytes:
        return self.draw(frame, self._view.pose(), number, TRIGGERED_LANE)

    def running(self, frame: FrameSettings, number: int) -> tuple[FrameSettings, bytes]:
        if frame.test_image is not RampImage.OFF:
            return frame, self.draw(frame, None, number, RING_LANE)
        return self._ring.picture(frame, number)

    def draw(self, frame: FrameSettings, pose: Pose | None, number: int, lane: int) -> bytes:
        """Draw and read out one image."""
        if frame.test_image is not RampImage.OFF:
            return to_wire(ramp_image(frame, number), frame.pixel_format)
        with self._drawing:
            disturbance = self._disturbances.now()
            spheres = self._view.spheres(pose, disturbance.twist_rad, disturbance.room)
            light = self._optics.light_on(frame.area, spheres, disturbance)
        light = self._faults.spoil(light, frame.area.x, frame.area.y)
        pixels = self._sensor.read(
            light,
            exposure_us=frame.exposure_us,
            gain_raw=frame.gain_raw,
            black_level_raw=frame.black_level_raw,
            bits=depth_bits(frame.pixel_format),
            noise=noise(self._seed, f"camera {self._serial}", number, lane),
        )
        return to_wire(pixels, frame.pixel_format)

    def sight(self, frame: FrameSettings) -> tuple[object, Pose | None]:
        """What an image depends on, for comparison, and the head pose in it."""
        pose = self._view.pose()
        place = None if pose is None else pose.tobytes()
        on_lens = self._faults.on_lens()
        in_view = (self._view.head_mounted, self._view.stand_has_ball)
        return (frame, place, in_view, self._disturbances.now(), on_lens), pose


class Ring:
    """Prepared images for a free-running camera, renewed in the background when the view has changed.

    Until then the stream continues with the old ones: it never waits for drawing.
    """

    def __init__(self, photographer: Photographer) -> None:
        self._photographer = photographer
        self._pictures: tuple[tuple[FrameSettings, bytes], ...] = ()
        self._sight: object = None
        self._painter: threading.Thread | None = None

    def picture(self, frame: FrameSettings, number: int) -> tuple[FrameSettings, bytes]:
        """The image for frame `number`; the first of a new format is drawn at once."""
        geometry = (frame.area.width, frame.area.height, frame.pixel_format)
        shown = self._pictures[0][0] if self._pictures else None
        if shown is None or (shown.area.width, shown.area.height, shown.pixel_format) != geometry:
            self._renew(frame)
        elif (self._painter is None or not self._painter.is_alive()) and self._behind(frame):
            self._painter = threading.Thread(target=self._paint, args=(frame,), daemon=True)
            self._painter.start()
        pictures = self._pictures
        return pictures[number % len(pictures)]

    def _behind(self, frame: FrameSettings) -> bool:
        return len(self._pictures) < RING_SIZE or self._photographer.sight(frame)[0] != self._sight

    def _paint(self, frame: FrameSettings) -> None:
        if self._photographer.sight(frame)[0] != self._sight:
            self._renew(frame)
        else:
            self._add(frame)
        time.sleep(REFRESH_PAUSE_S)

    def _renew(self, frame: FrameSettings) -> None:
        sight, pose = self._photographer.sight(frame)
        image = self._photographer.draw(frame, pose, 0, RING_LANE)
        self._pictures, self._sight = ((frame, image),), sight

    def _add(self, frame: FrameSettings) -> None:
        _, pose = self._photographer.sight(frame)
        image = self._photographer.draw(frame, pose, len(self._pictures), RING_LANE)
        self._pictures = (*self._pictures, (frame, image))

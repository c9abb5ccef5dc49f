"""Image source of one camera: one image per trigger, or a ring of prepared images when free-running."""

from __future__ import annotations

import os
import signal
import threading
import time
import zlib
from multiprocessing import Pipe
from multiprocessing.connection import Connection

import numpy as np

from ronna_hw.host.forked_process import fork_worker
from ronna_hw.wire.gige_vision import PixelFormat
from sim.basler.camera.view import Pose, View, ViewDisturbances
from sim.basler.faults import NO_FAULTS, CameraFaults
from sim.basler.optics.picture import LensOptics
from sim.basler.optics.sensor import Pixels, Sensor
from sim.basler.settings import FrameSettings, RampImage, bits_per_pixel
from sim.world.noise import noise
from sim.world.scene.model import CameraTruth
from sim.world.world import World

RING_SIZE = 6  # so that consecutive frames never have the same noise
REFRESH_PAUSE_S = 0.05  # between two images for the ring, so that drawing leaves time for the stream
DRAWING_LIMIT_S = 2.0  # for one image (20 ms) on a busy computer, then the process counts as lost
TRIGGERED_LANE, RING_LANE = 0, 1  # streams of noise


class Photographer:
    """Takes the images of one simulated camera.

    The same trigger number, settings and pose of the head yield the same bytes.
    """

    def __init__(self, world: World, camera: CameraTruth, faults: CameraFaults = NO_FAULTS) -> None:
        self._faults = faults
        self._seed = world.scene.seed
        self._serial = camera.serial
        self._view = View(world, camera)
        self._disturbances = ViewDisturbances(world, camera)
        self._optics = LensOptics(camera, world.scene.seed)
        self._sensor = Sensor(camera.read_noise_electrons, camera.full_well_electrons)
        self._drawing = threading.Lock()
        self._ring = ImageRing(self)

    def place(self) -> bytes | None:
        """Return the camera's position for comparison, or None if unknown; thread-safe."""
        pose = self._view.pose()
        return None if pose is None else pose.tobytes()

    def triggered(self, frame: FrameSettings, number: int) -> bytes:
        """Take the image of trigger `number` since AcquisitionStart."""
        return self.draw(frame, self._view.pose(), number, TRIGGERED_LANE)

    def running(self, frame: FrameSettings, number: int) -> tuple[FrameSettings, bytes]:
        """Return a free-running frame, possibly taken with slightly older settings."""
        if frame.test_image is not RampImage.OFF:
            return frame, self.draw(frame, None, number, RING_LANE)
        return self._ring.image(frame, number)

    def draw(self, frame: FrameSettings, pose: Pose | None, number: int, lane: int) -> bytes:
        """Render and read out one image."""
        if frame.test_image is not RampImage.OFF:
            return to_wire(ramp_image(frame, number), frame.pixel_format)
        with self._drawing:
            disturbance = self._disturbances.now()
            spheres = self._view.spheres(pose, disturbance.twist_rad, disturbance.room)
            line = self._view.line(frame.area, pose, disturbance) if frame.line_lit else ()
            light = self._optics.light_on(frame.area, spheres, disturbance, line, _moment(pose))
        light = self._faults.disturb(light, frame.area.x, frame.area.y)
        pixels = self._sensor.read(
            light,
            exposure_us=frame.exposure_us,
            gain_raw=frame.gain_raw,
            black_level_raw=frame.black_level_raw,
            bits=depth_bits(frame.pixel_format),
            noise=noise(self._seed, f"camera {self._serial}", number, lane),
        )
        return to_wire(pixels, frame.pixel_format)

    def dependencies(self, frame: FrameSettings) -> tuple[object, Pose | None]:
        """Return everything the image depends on, in comparable form, and the pose of the head."""
        pose, flanges = self._view.pose(), self._view.holder_flanges().values()
        places = (None if pose is None else pose.tobytes(), *(one.tobytes() for one in flanges))
        in_view = (self._view.head_mounted, self._view.stand_has_ball)
        return (frame, places, in_view, self._disturbances.now(), self._faults.light_faults()), pose


def _moment(pose: Pose | None) -> int:
    """Return a number that changes with the head's place, by which speckle is drawn."""
    return 0 if pose is None else zlib.crc32(pose.tobytes())


class PhotographerApart(Photographer):
    """Takes the triggered images of one camera in a process of its own, beside those of another camera.

    Drawing is hundreds of short array operations. Two threads that hand over the interpreter at each of them
    take as long as one after the other. The process is forked: create this before any thread and any socket.
    """

    def __init__(self, world: World, camera: CameraTruth, faults: CameraFaults = NO_FAULTS) -> None:
        super().__init__(world, camera, faults)
        self._ordering = threading.Lock()
        self._ended = False
        self._drawer, orders = Pipe()
        self._process_id = fork_worker(lambda: self._draw_as_ordered(orders))
        orders.close()

    def triggered(self, frame: FrameSettings, number: int) -> bytes:
        """Take the image of trigger `number`, here if the process has ended or is halted."""
        pose = self._view.pose()
        with self._ordering:
            if not self._ended:
                try:
                    self._drawer.send((frame, pose, number))
                    if self._drawer.poll(DRAWING_LIMIT_S):
                        return self._drawer.recv_bytes()
                except (EOFError, OSError):
                    pass
                self._ended = True  # a late image must not be taken for that of a later trigger
                os.kill(self._process_id, signal.SIGKILL)
        return self.draw(frame, pose, number, TRIGGERED_LANE)

    def close(self) -> None:
        """End the process once its current image is drawn."""
        with self._ordering:
            self._drawer.close()
        os.waitpid(self._process_id, 0)

    def _draw_as_ordered(self, orders: Connection) -> None:
        self._drawer.close()
        while True:
            frame, pose, number = orders.recv()
            orders.send_bytes(self.draw(frame, pose, number, TRIGGERED_LANE))


class ImageRing:
    """Ring of prepared images for free-running mode, refreshed in the background when the view changes.

    Meanwhile the stream continues with the old ones: it never waits for drawing.
    """

    def __init__(self, photographer: Photographer) -> None:
        self._photographer = photographer
        self._images: tuple[tuple[FrameSettings, bytes], ...] = ()
        self._drawn_for: object = None
        self._refresher: threading.Thread | None = None

    def image(self, frame: FrameSettings, number: int) -> tuple[FrameSettings, bytes]:
        """Return the image for frame `number`, drawing it immediately if the format is new."""
        geometry = (frame.area.width, frame.area.height, frame.pixel_format)
        shown = self._images[0][0] if self._images else None
        if shown is None or (shown.area.width, shown.area.height, shown.pixel_format) != geometry:
            self._draw_next(frame)
        elif (self._refresher is None or not self._refresher.is_alive()) and self._is_stale(frame):
            self._refresher = threading.Thread(target=self._refresh, args=(frame,), daemon=True)
            self._refresher.start()
        images = self._images
        return images[number % len(images)]

    def _is_stale(self, frame: FrameSettings) -> bool:
        return len(self._images) < RING_SIZE or self._photographer.dependencies(frame)[0] != self._drawn_for

    def _refresh(self, frame: FrameSettings) -> None:
        self._draw_next(frame)
        time.sleep(REFRESH_PAUSE_S)

    def _draw_next(self, frame: FrameSettings) -> None:
        """Draw another image, discarding all earlier ones if the view has changed."""
        dependencies, pose = self._photographer.dependencies(frame)
        kept = self._images if dependencies == self._drawn_for else ()
        image = self._photographer.draw(frame, pose, len(kept), RING_LANE)
        self._images, self._drawn_for = (*kept, (frame, image)), dependencies


def to_wire(pixels: Pixels, pixel_format: PixelFormat) -> bytes:
    """Encode an image (rows, columns) of even width in the wire's pixel format."""
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
    """Return the bit depth of a pixel format."""
    return 8 if bits_per_pixel(pixel_format) == 8 else 12


def ramp_image(frame: FrameSettings, number: int) -> Pixels:
    """Draw a diagonal ramp with a period of 256 (or 4096) pixels, shifted by 1 per frame if it moves."""
    shift = number if frame.test_image is RampImage.MOVING else 0
    rows = np.arange(frame.area.y, frame.area.y + frame.area.height)[:, None]
    columns = np.arange(frame.area.x, frame.area.x + frame.area.width)[None, :]
    if depth_bits(frame.pixel_format) == 8:
        return (rows + columns + shift).astype(np.uint8)
    return ((rows + columns + shift) & 0xFFF).astype(np.uint16)

"""Effects of the fault script on a camera's packets, messages, clock and light."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from sim.basler.optics.canvas import blur
from sim.world.faults import Fault, FaultBoard
from sim.world.faults.camera import BOTH
from sim.world.noise import noise
from sim.world.scene.model import CameraTruth
from sim.world.world import World

FLOOD = np.float32(1e6)  # times the light: beyond every exposure and gain
SPOT_RADIUS_PX = 6.0
WHOLE = 100.0
LOSS_LANE, ORDER_LANE, DOUBLE_LANE, ANSWER_LANE, MESSAGE_LANE = 0, 1, 2, 3, 4  # streams of noise

Light = NDArray[np.float32]


class EmptyBoard:
    """Stand-in for a fault board that never has a fault."""

    empty = True

    def active(self, _kind: str) -> tuple[Fault, ...]:
        return ()

    def happened(self, _kind: str) -> tuple[Fault, ...]:
        return ()


class CameraFaults:
    """Faults of one camera, with a separate instance (and fault board) for each thread."""

    def __init__(self, world: World, camera: CameraTruth, side: str) -> None:
        self._world = world
        self._side = side
        self._camera = camera
        self._board: FaultBoard | EmptyBoard = FaultBoard(world, "camera")
        self._sent: Counter[int] = Counter()  # by lane

    @property
    def scripted(self) -> bool:
        """Whether the script contains any camera fault."""
        return not self._board.empty

    def draw_lost_packets(self, block_id: int, packets: int) -> Collection[int]:
        """Draw the ids of the packets to drop."""
        if self._board.empty:
            return ()
        lost_ids: set[int] = set()
        if self.active("omit_frames"):
            lost_ids.update(range(packets))
        if self.active("omit_leader"):
            lost_ids.add(0)
        if self.active("omit_trailer"):
            lost_ids.add(packets - 1)
        shares = [float(fault.argument) for fault in self._board.active("camera_drop")]
        share = max([*shares, self.amount("lose")])
        if share:
            drawn = self._noise(block_id, LOSS_LANE).uniform(0.0, WHOLE, packets)
            lost_ids.update(np.flatnonzero(drawn < share).tolist())
        return lost_ids

    def draw_packet_order(self, block_id: int, packets: int) -> Sequence[int]:
        """Draw the arrival order of the packet ids, possibly with duplicates."""
        if self._board.empty:
            return range(packets)
        ids = np.arange(packets)
        if self.active("shuffle"):
            ids = self._noise(block_id, ORDER_LANE).permutation(ids)
        if share := self.amount("duplicate"):
            drawn = self._noise(block_id, DOUBLE_LANE).uniform(0.0, WHOLE, packets)
            ids = np.repeat(ids, 1 + (drawn < share))
        return [int(number) for number in ids]

    def passes(self, packet_bytes: int) -> bool:
        """Return whether the network passes packets of `packet_bytes`."""
        if self._board.empty:
            return True
        if self.active("unplug"):
            return False
        limits = [float(fault.arguments[1]) for fault in self._own_faults("path")]
        return packet_bytes <= min(limits, default=packet_bytes)

    def active(self, kind: str) -> bool:
        """Return whether a fault of this kind is active on this camera."""
        return bool(self._own_faults(kind))

    def happened(self, kind: str) -> bool:
        """Return whether a momentary fault of this kind has occurred since the last call."""
        happened = self._board.happened(f"camera_{kind}")
        return any(fault.argument in ("", self._side, BOTH) for fault in happened)

    def amount(self, kind: str) -> float:
        """Return the largest amount among the active faults of this kind, or 0 if none is active."""
        return max((float(fault.arguments[1]) for fault in self._own_faults(kind)), default=0.0)

    def drift_ppm(self) -> float:
        """Return the rate error of the time stamp counter in ppm, positive if fast."""
        return sum(float(fault.arguments[1]) for fault in self._own_faults("drift"))

    def draw_answer_loss(self) -> bool:
        """Draw whether the next answer to a command is lost."""
        return self._draw_loss("lose_answers", ANSWER_LANE)

    def draw_message_loss(self) -> bool:
        """Draw whether the next event message is lost."""
        return self._draw_loss("lose_events", MESSAGE_LANE)

    def _draw_loss(self, kind: str, lane: int) -> bool:
        share = self.amount(kind)
        if not share:
            return False
        self._sent[lane] += 1
        return bool(self._noise(self._sent[lane], lane).uniform(0.0, WHOLE) < share)

    def light_faults(self) -> tuple[tuple[str, float], ...]:
        """Return the active light faults, by name and amount."""
        if self._board.empty:
            return ()
        found = [(kind, self.amount(kind)) for kind in ("defocus", "dust") if self.active(kind)]
        return (*found, *((kind, 1.0) for kind in ("darken", "saturate") if self.active(kind)))

    def disturb(self, light: Light, left_px: int, top_px: int) -> Light:
        """Apply the optical faults to an area (height, width) of the sensor."""
        for kind, amount in self.light_faults():
            match kind:
                case "defocus":
                    light = np.asarray(blur(light, amount), dtype=np.float32)
                case "dust":
                    light = self._apply_dust(light, int(amount), left_px, top_px)
                case "darken":
                    light = np.zeros_like(light)
                case "saturate":
                    light = (light + np.float32(1.0)) * FLOOD
        return light

    def _apply_dust(self, light: Light, spots: int, left_px: int, top_px: int) -> Light:
        columns, rows = self._camera.sensor_px
        places = noise(self._world.scene.seed, f"dust of camera {self._camera.serial}", 0).uniform(
            (0.0, 0.0), (columns, rows), (spots, 2)
        )
        y, x = np.ogrid[: light.shape[0], : light.shape[1]]
        dusted = light.copy()
        for place_x, place_y in places - (left_px, top_px):
            dusted[(x - place_x) ** 2 + (y - place_y) ** 2 < SPOT_RADIUS_PX**2] = 0.0
        return dusted

    def _own_faults(self, kind: str) -> list[Fault]:
        active = self._board.active(f"camera_{kind}")
        return [fault for fault in active if fault.argument in (self._side, BOTH)]

    def _noise(self, counter: int, lane: int) -> np.random.Generator:
        return noise(self._world.scene.seed, f"stream of camera {self._camera.serial}", counter, lane)


class NoFaults(CameraFaults):
    """A camera without faults."""

    def __init__(self) -> None:
        self._board = EmptyBoard()


NO_FAULTS = NoFaults()

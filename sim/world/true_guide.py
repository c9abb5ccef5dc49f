"""The guide as it is really mounted: pushed, badly seated, bent; and the instrument in its bore."""

from __future__ import annotations

from math import radians

import numpy as np
from numpy.typing import NDArray

from sim.world.faults import Fault, FaultBoard
from sim.world.faults.room import BAD_SEAT, BENT_TIP, DEVICE, WRONG_LOAD, WRONG_MANDREL
from sim.world.noise import noise
from sim.world.rigid import Matrix, matrix_from, matrix_of, rotation_from_vector
from sim.world.room_shift import ShiftedRoom, yielded
from sim.world.world import World

Vector = NDArray[np.float64]
SEAT, PLAY = "changer", "bore"  # keys of the noise


class TrueGuide:
    """Queries the world and the room's faults. Poses are (4, 4), of the tip frame in the robot frame."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._scene = world.scene
        self._board = FaultBoard(world, DEVICE)
        self._room = ShiftedRoom(world)

    def tip_frame(self, flange: Matrix | None = None) -> Matrix:
        """Of the mandrel's end, as if the mandrel were the calibrated one.

        `flange` as the arm alone would hold it, by default its present pose.
        """
        return self.bore_frame(flange) @ self._bent()

    def bore_frame(self, flange: Matrix | None = None) -> Matrix:
        """The same for an unbent guide: for what is above the bore."""
        flange = self._world.arm().robot_from_flange if flange is None else flange
        mount = self._scene.mount
        marker = matrix_of(mount.flange_from_tool_true) @ matrix_of(mount.tool_from_marker_true)
        pose = yielded(flange, marker, self._room.now()).copy()
        pose[2, 3] -= self._scene.arm.sag_mm_kg * sum(float(one.argument) for one in self._acting(WRONG_LOAD))
        return pose @ calibrated_tip(self._world) @ self._seated()

    def mandrel(self) -> Matrix:
        """Of the end of the mandrel in use."""
        longer_mm = sum(float(one.argument) for one in self._acting(WRONG_MANDREL))
        return self.tip_frame() @ matrix_from((0.0, 0.0, longer_mm), np.eye(3))

    def instrument_tip_mm(self, stop_mm: float, target: str, draw: int) -> Vector:
        """The tip (3,) of an instrument inserted up to its depth stop, anywhere within the bore's play."""
        guide = self._scene.mount.guide
        beyond_mm = stop_mm - guide.bore_mm
        upper, lower = _in_disc(noise(self._scene.seed, f"{PLAY} {target}", draw), guide.play_mm / 2.0)
        aside = lower + (lower - upper) * beyond_mm / guide.bore_mm
        point = np.array([*aside, beyond_mm - guide.reach_mm, 1.0])
        return np.asarray((self.tip_frame() @ point)[:3])

    def _seated(self) -> Matrix:
        mount = self._scene.mount
        again = max(0, self._world.mountings() - 1)
        off = noise(self._scene.seed, SEAT, again).normal(0.0, mount.guide.seat_mm, 3)
        tilt_rad = 0.0
        for fault in self._acting(BAD_SEAT):
            off[2] -= float(fault.argument)
            tilt_rad += radians(float(fault.arguments[1]))
        return matrix_from(off, rotation_from_vector((tilt_rad, 0.0, 0.0)))

    def _bent(self) -> Matrix:
        """Bent about the upper end of the bore."""
        guide = self._scene.mount.guide
        away = np.array(guide.bent_mm)
        for fault in self._acting(BENT_TIP):
            away += [float(number) for number in fault.arguments]
        height_mm = guide.bore_mm + guide.reach_mm
        tilt = (-away[1] / height_mm, away[0] / height_mm, 0.0)
        whole = rotation_from_vector(np.add(tilt, (*np.radians(guide.tilt_deg), 0.0)))
        pivot, back = (matrix_from((0.0, 0.0, z), np.eye(3)) for z in (-height_mm, height_mm))
        bent: Matrix = pivot @ matrix_from((0.0, 0.0, away[2]), whole) @ back
        return bent

    def _acting(self, kind: object) -> tuple[Fault, ...]:
        return () if self._board.empty else self._board.active(getattr(kind, "name", ""))


def calibrated_tip(world: World) -> Matrix:
    """FLANGE <- tip, (4, 4), the truth when the records were made."""
    mount = world.scene.mount
    pose: Matrix = matrix_of(mount.flange_from_tool_true) @ matrix_of(mount.tool_from_tip_true)
    return pose


def _in_disc(generator: np.random.Generator, radius_mm: float) -> tuple[Vector, Vector]:
    """Two random points (2,) in a disc."""
    radii = radius_mm * np.sqrt(generator.uniform(size=2))
    angles = generator.uniform(0.0, 2.0 * np.pi, 2)
    one, other = (
        radius * np.array([np.cos(angle), np.sin(angle)]) for radius, angle in zip(radii, angles, strict=True)
    )
    return one, other

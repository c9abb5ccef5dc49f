"""Optical disturbances of one camera from the active faults."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import pi, radians

from sim.basler.optics.film import drawn_stains
from sim.basler.optics.foreground import CLEAR, Disturbance, Glare, Occluder
from sim.world.displacements import NOTHING_MOVED, ShiftedRoom, spheres_in_theatre
from sim.world.faults import Fault, FaultBoard
from sim.world.noise import noise
from sim.world.scene.model import CameraTruth
from sim.world.world import World

PERCENT = 0.01
SECONDS_PER_MINUTE = 60.0


@dataclass(frozen=True)
class Disturbances:
    """Queries the cameras' fault board on behalf of one camera."""

    world: World
    board: FaultBoard
    camera: CameraTruth
    room: ShiftedRoom

    @classmethod
    def of(cls, world: World, camera: CameraTruth) -> Disturbances:
        """The disturbances of one camera."""
        return cls(world, FaultBoard(world, "camera"), camera, ShiftedRoom(world))

    @property
    def side(self) -> str:
        """The camera's name in a fault script."""
        return "left" if self.camera.serial == self.world.scene.left.serial else "right"

    @cached_property
    def worn(self) -> Disturbance:
        """Permanent defects: spots of worn film, dark like a stain."""
        scene = self.world.scene
        spots = tuple(
            (one.number, drawn_stains(scene.seed, one.number, one.worn_percent * PERCENT))
            for one in spheres_in_theatre(scene)
            if one.worn_percent
        )
        return Disturbance(stains=spots) if spots else CLEAR

    def now(self) -> Disturbance:
        """The currently active disturbances; costs one query when there are no faults."""
        room = self.room.now()
        if self.board.empty:
            return self.worn if room is NOTHING_MOVED else replace(self.worn, room=room)
        seed = self.world.scene.seed
        return Disturbance(
            stains=self.worn.stains
            + tuple(
                (number, drawn_stains(seed, number, float(share) * PERCENT))
                for number, share in (
                    (int(fault.arguments[0]), fault.arguments[1]) for fault in self.board.active("stain")
                )
            ),
            occluders=tuple(self._occluder(float(fault.arguments[1])) for fault in self._mine("occluder")),
            glares=tuple(self._glare(float(fault.arguments[1])) for fault in self._mine("glare")),
            twist_rad=sum(radians(float(fault.arguments[1])) for fault in self._mine("twist"))
            + sum(self._crept_rad(fault) for fault in self._mine("creep")),
            room=room,
        )

    def _mine(self, kind: str) -> list[Fault]:
        return [fault for fault in self.board.active(kind) if fault.argument == self.side]

    def _crept_rad(self, fault: Fault) -> float:
        """How far a drift fault has progressed, since it began or since its step was entered."""
        begun_s = self.world.step()[1] / 1e9 if fault.at_s is None else fault.at_s
        acting_s = self.world.clock.now_s() - begun_s
        return radians(float(fault.arguments[1])) * acting_s / SECONDS_PER_MINUTE

    def _occluder(self, share_percent: float) -> Occluder:
        direction = noise(self.world.scene.seed, f"occluder of camera {self.camera.serial}", 0)
        return Occluder(share_percent * PERCENT, float(direction.uniform(0.0, 2.0 * pi)))

    def _glare(self, radius_px: float) -> Glare:
        place = noise(self.world.scene.seed, f"glare of camera {self.camera.serial}", 0)
        columns, rows = self.camera.sensor_px
        return Glare((float(place.uniform(0, columns)), float(place.uniform(0, rows))), radius_px)

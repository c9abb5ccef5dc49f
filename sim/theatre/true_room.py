"""Truth of a theatre for a study: places of all markers, what is a phantom, and why a sphere is not seen.

A theatre tells it only if it was started so. Runs never are: no step, driver or procedure can ask for it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sim.polaris.measurement.line_of_sight import Flags, visible
from sim.polaris.measurement.optics import (
    EYES_MM,
    crossings,
    extra_strays,
    is_in_field,
    reflecting_places,
)
from sim.polaris.measurement.true_scene import Disturbance, Disturbances, TrueScene, TrueTool
from sim.polaris.unit.model import UNIT_MODELS
from sim.world.displacements import ShiftedRoom
from sim.world.faults import FaultBoard
from sim.world.options import OTHER_ARMS, ArmRole
from sim.world.rigid import Vectors, inverse
from sim.world.world import World

TRACKER = "tracker"
SENSORS = ("left", "right")
IN_VIEW = "in view"
SPHERE, STRAY, EXTRA = "sphere", "stray sphere", "extra sphere"  # on the head, of a fault or scene, placed


class TrueRoom:
    """Places in a world, in the tracker's frame, now."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._scene = TrueScene(world)
        self._disturbances = Disturbances(FaultBoard(world, TRACKER), ShiftedRoom(world))
        # The one that a unit selects by itself: what a driver has selected is the unit's own state.
        self._volume = UNIT_MODELS[world.scene.tracker.model].volumes[0]

    def tell(self) -> dict[str, Any]:
        """Return joints by arm, each sphere on the head, all other markers, phantoms and reflections."""
        disturbance = self._disturbances.now()
        arm = self._scene.arm()
        names, places, past_mount = self._list_markers(disturbance)
        bodies = self._scene.bodies(arm, self._scene.mounted_tool(), disturbance.room)
        seen = visible(EYES_MM, places, bodies, past_mount)
        inside = is_in_field(places)
        covered = self._find_covered(names, disturbance)
        on_head = len(self._scene.fiducial_numbers)
        told = []
        for row, (x, y, z) in enumerate(places.tolist()):
            in_volume = self._volume.holds(x, y, z)
            told.append(
                {
                    "tracker_mm": [x, y, z],
                    "seen": bool(seen[:, row].all() and inside[row] and not covered[row]),
                    "in_volume": in_volume,
                    "because": self._why(
                        in_volume, bool(covered[row]), bool(inside[row]), seen[:, row].tolist()
                    ),
                }
            )
        separation_mm = max(self._world.scene.tracker.line_separation_mm, disturbance.line_separation_mm)
        pairs, phantoms_mm = crossings(EYES_MM, places, seen & inside & ~covered, separation_mm)
        tracker = self._world.scene.tracker
        glints = reflecting_places(
            self._world.scene.seed, disturbance.count_reflections(tracker.reflections), self._volume
        )
        present = {
            "sunlight": disturbance.sunlight,
            "infrared interference": bool(disturbance.interfered),
            "reflections": bool(disturbance.reflections),
            "strays": bool(disturbance.strays),
        }
        return {
            "joints_rad": {
                role.value: list(self._world.arm(role).joints_rad)
                for role in (ArmRole.MASTER, *OTHER_ARMS)
                if self._world.has_arm(role)
            },
            "robot_from_tracker": inverse(self._scene.tracker_from_robot(disturbance.room)).tolist(),
            "spheres": [
                {"number": number, **one}
                for number, one in zip(self._scene.fiducial_numbers, told[:on_head], strict=True)
            ],
            "others": [
                {"name": name, **one} for name, one in zip(names[on_head:], told[on_head:], strict=True)
            ],
            "phantoms": [
                {"of": [names[left], names[right]], "tracker_mm": place}
                for (left, right), place in zip(pairs.tolist(), phantoms_mm.tolist(), strict=True)
            ],
            "reflections_mm": glints.tolist(),
            "disturbances": [name for name, is_there in present.items() if is_there],
        }

    def _list_markers(self, disturbance: Disturbance) -> tuple[list[str], Vectors, Flags]:
        """List names and places of all markers, those on the head first, and which the mount never hides."""
        scene = self._scene
        frames = scene.frames(scene.arm(), disturbance)
        drawn = extra_strays(self._world.scene.seed, disturbance.strays, self._volume)
        loose = np.vstack([scene.strays_mm, drawn])
        extra = scene.extra_spheres_at(disturbance.room)
        names = [f"{SPHERE} {number}" for number in scene.fiducial_numbers]
        names += [f"{STRAY} {number}" for number in range(1, 1 + len(loose))]
        names += [f"{EXTRA} {number}" for number in range(1, 1 + len(extra))]
        names += [name for frame in frames for name in _name_markers(frame)]
        rest = np.vstack([scene.fiducials_at(disturbance.room), loose, extra])
        places = np.vstack([rest, *(frame.markers_mm for frame in frames)])
        past_mount = [False] * len(rest)
        for frame in frames:
            past_mount += [scene.is_on_mount(frame)] * len(frame.markers_mm)
        return names, places, np.array(past_mount)

    def _find_covered(self, names: list[str], disturbance: Disturbance) -> Flags:
        """Flag the markers (n,) that a fault covers."""
        covered = {f"{SPHERE} {number}" for number in disturbance.hidden_fiducials}
        for frame in self._scene.frames(self._scene.arm(), disturbance):
            listed = _name_markers(frame)
            covered |= {listed[row] for row in frame.covered}
        return np.array([name in covered for name in names])

    @staticmethod
    def _why(in_volume: bool, covered: bool, inside: bool, seen: list[bool]) -> str:
        """Say why the tracker does not see a place, or that it does."""
        if covered:
            return "covered by a fault"
        if not inside:
            return "outside the field of view of the sensors"
        blind = [name for name, sees in zip(SENSORS, seen, strict=True) if not sees]
        if blind:
            return f"the head or an arm is in the way of the {' and the '.join(blind)} sensor"
        return IN_VIEW if in_volume else f"{IN_VIEW}, but outside the unit's first measuring volume"


def _name_markers(frame: TrueTool) -> list[str]:
    """Name the markers of a frame, counted from 1, by its name in the theatre, not by its part number."""
    name = max(frame.names, key=lambda one: (one.islower(), one))
    return [f"marker {number} of {name}" for number in range(1, 1 + len(frame.markers_mm))]

"""Truth of a theatre for a study: places of spheres, joints, and why a sphere is not seen.

A theatre tells it only if it was started so. Runs never are: no step, driver or procedure can ask for it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sim.polaris.measurement.line_of_sight import visible
from sim.polaris.measurement.optics import EYES_MM, is_in_field, phantoms
from sim.polaris.measurement.true_scene import Disturbances, TrueScene
from sim.polaris.unit.model import UNIT_MODELS
from sim.world.displacements import ShiftedRoom
from sim.world.faults import FaultBoard
from sim.world.options import OTHER_ARMS, ArmRole
from sim.world.world import World

TRACKER = "tracker"
SENSORS = ("left", "right")
IN_VIEW = "in view"


class TrueRoom:
    """Places in a world, in the tracker's frame, now."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._scene = TrueScene(world)
        self._disturbances = Disturbances(FaultBoard(world, TRACKER), ShiftedRoom(world))
        self._volume = UNIT_MODELS[world.scene.tracker.model].volumes[0]

    def tell(self) -> dict[str, Any]:
        """Return time, joints by arm, each sphere on the head with what hides it, and phantom points."""
        disturbance = self._disturbances.now()
        arm, mounted = self._scene.arm(), self._scene.mounted_tool()
        places = self._scene.fiducials_at(disturbance.room)
        bodies = self._scene.bodies(arm, mounted, disturbance.room)
        seen = visible(EYES_MM, places, bodies)
        inside = is_in_field(places)
        covered = disturbance.hidden_fiducials
        spheres = []
        for row, number in enumerate(self._scene.fiducial_numbers):
            because = self._why(
                places[row].tolist(), number in covered, bool(inside[row]), seen[:, row].tolist()
            )
            spheres.append(
                {
                    "number": number,
                    "tracker_mm": places[row].tolist(),
                    "seen": because == IN_VIEW,
                    "because": because,
                }
            )
        shown = seen & inside
        shown[:, [row for row, number in enumerate(self._scene.fiducial_numbers) if number in covered]] = (
            False
        )
        separation_mm = max(self._world.scene.tracker.line_separation_mm, disturbance.line_separation_mm)
        ghosts = phantoms(EYES_MM, places, shown, separation_mm)
        joints = {
            role.value: list(self._world.arm(role).joints_rad)
            for role in (ArmRole.MASTER, *OTHER_ARMS)
            if self._world.has_arm(role)
        }
        present = {
            "sunlight": disturbance.sunlight,
            "infrared interference": bool(disturbance.interfered),
            "reflections": bool(disturbance.reflections),
            "strays": bool(disturbance.strays),
        }
        return {
            "joints_rad": joints,
            "spheres": spheres,
            "phantoms_mm": np.asarray(ghosts).tolist(),
            "disturbances": [name for name, is_there in present.items() if is_there],
        }

    def _why(self, place_mm: list[float], covered: bool, inside: bool, seen: list[bool]) -> str:
        """Say why the tracker does not see a place, or that it does."""
        if covered:
            return "covered by a fault"
        if not inside:
            return "outside the field of view of the sensors"
        blind = [name for name, sees in zip(SENSORS, seen, strict=True) if not sees]
        if blind:
            return f"the head or an arm is in the way of the {' and the '.join(blind)} sensor"
        x, y, z = place_mm
        return IN_VIEW if self._volume.holds(x, y, z) else "in view, but outside the measuring volume"

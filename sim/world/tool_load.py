"""What weighs on the flange of an arm of the theatre: its mounted tool, and a hand on it."""

from __future__ import annotations

from sim.world.displacements import STILL, ShiftedRoom
from sim.world.faults import FaultBoard
from sim.world.faults.room import DEVICE, PUSH, WRONG_LOAD
from sim.world.options import ArmRole
from sim.world.rigid import Point, as_point, matrix_of
from sim.world.scene.parts import STEREO_HEAD_KG
from sim.world.world import World


class SimulatedLoad:
    """Load on the flange: the mounted tool with its weight, and a hand on it."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._board = FaultBoard(world, DEVICE)
        self._room = ShiftedRoom(world)
        mount = world.scene.mount
        self._masses_kg = {
            mount.tool_number_stereo: STEREO_HEAD_KG,
            mount.tool_number_guide: mount.guide.mass_kg,
        }
        tip = matrix_of(mount.flange_from_tool_true) @ matrix_of(mount.tool_from_tip_true)
        self.point_mm = as_point(tip[:3, 3])  # where a hand pushes, flange frame
        self._has_tool = world.role is ArmRole.MASTER  # all that is mounted, and pushed, is on the master

    def mass_kg(self) -> float:
        """Return the mass on the flange; its centre is at `CENTRE_OF_GRAVITY_MM`."""
        if not self._has_tool:
            return 0.0
        mass_kg = self._masses_kg.get(self._world.mounted_tool(), 0.0)
        return mass_kg + sum(float(fault.argument) for fault in self._board.active(WRONG_LOAD.name))

    def push_N(self) -> Point:
        """Return the force of a hand on the tool in the base, the object `STILL` without one."""
        if not self._has_tool or not self._board.active(PUSH.name):
            return STILL
        return self._room.now().push_N

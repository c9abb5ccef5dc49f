"""Drill in the holder of an arm, and the skull under it: the thrust, and how deep the opening is.

Drill, arm and holder yield elastically; what the edge removes in a time follows from the thrust. So a drill
that stalls, or is pressed into undrilled bone, meets a force that grows with its way. A force that presses
it aside in its guide adds friction, at rest as well; of the way out, where it would pull, no limit is kept.
"""

from __future__ import annotations

from math import hypot

import numpy as np

from sim.world.displacements import ShiftedRoom, rigid_move
from sim.world.faults import FaultBoard
from sim.world.faults.room import DEVICE, DRILL_ASIDE, DRILL_STALLS, OTHER_BONE
from sim.world.noise import noise
from sim.world.options import ArmRole
from sim.world.rigid import as_point, inverse, matrix_of
from sim.world.skull import SkullTables, depth_below_skin_mm
from sim.world.world import World

DIAMETER_MM = 3.2  # of a twist drill for stereotactic openings
CONE_MM = 1.0  # of its point
TURNS_PER_S = 20.0  # 1200 rpm (U)
STIFFNESS_N_MM = 40.0  # of drill, holder and arm along the axis (U)
FRICTION_N = 0.3  # in the opening, behind the bone (U)
HARDER_SHARE = 0.15  # of one site against another, one standard deviation (U)
LONGEST_CYCLE_S = 0.1
LIPS_FEED_MM = 0.025  # per revolution of the lips, once nothing holds the tip (U)
# Share of the thrust by height above the tip: the chisel edge, then the lips by their radius.
EDGE = ((0.0, 0.4), (0.2, 0.04), (0.4, 0.08), (0.6, 0.12), (0.8, 0.16), (1.0, 0.2))
SITE = "skull"  # noise key
NANOSECONDS = 1e9
NO_SIDE = (0.0, 0.0)


class ThrustModel:
    """Thrust on a drill, and the bottom of its opening; `harder` is the bone of a site against another."""

    def __init__(self, harder: float = 1.0, bottom_mm: float = 0.0) -> None:
        self._harder = harder
        self.bottom_mm = bottom_mm  # below the skin

    def advance(self, tables: SkullTables, depth_mm: float, cycle_s: float) -> float:
        """Press the drill to a depth, let it cut for that time, and return the thrust."""
        if depth_mm <= max(self.bottom_mm, tables.outside_mm):
            return FRICTION_N if depth_mm > tables.inside_mm else 0.0
        self.bottom_mm = max(self.bottom_mm, tables.outside_mm)
        bones = [(tables.bone_at(self.bottom_mm - height * CONE_MM), share) for height, share in EDGE]
        edge_N = self._harder * sum(share * bone.edge_N for bone, share in bones)
        per_feed_N = self._harder * sum(share * bone.pressure_N_mm2 for bone, share in bones)
        per_feed_N *= DIAMETER_MM / 2.0
        thrust_N = STIFFNESS_N_MM * (depth_mm - self.bottom_mm)
        if tables.bone_at(self.bottom_mm).pressure_N_mm2 == 0.0:  # the tip is through: its lips still cut
            self.bottom_mm = depth_mm
            return max(edge_N + per_feed_N * LIPS_FEED_MM, FRICTION_N)
        if cycle_s:
            feed_mm = max(thrust_N - edge_N, 0.0) / per_feed_N
            self.bottom_mm = min(self.bottom_mm + feed_mm * TURNS_PER_S * cycle_s, depth_mm)
        return thrust_N


class DrilledSkull:
    """Thrust on the drill of one arm, cycle by cycle."""

    def __init__(self, world: World, role: ArmRole) -> None:
        """Follow the arm of a role; one without a holder meets nothing."""
        self._world, self._role = world, role
        self._room, self._board = ShiftedRoom(world), FaultBoard(world, DEVICE)
        holder = world.scene.holders.get(role)
        self._flange_from_clamp = None if holder is None else matrix_of(holder.flange_from_clamp)
        self._friction = 0.0 if holder is None else holder.drill_friction
        self._site, self._thrust = "", ThrustModel()
        self._before_ns = 0
        self.side_N = NO_SIDE  # across the drill, along x and y of the clamp

    def thrust_N(self) -> float:
        """Return the force of this moment against the drill, with friction; `side_N` is that across it."""
        self.side_N = NO_SIDE
        held = self._world.held_drill() if self._flange_from_clamp is not None else None
        if held is None:
            return 0.0
        now_ns = self._world.clock.now_ns()
        cycle_s = min((now_ns - self._before_ns) / NANOSECONDS, LONGEST_CYCLE_S)
        self._before_ns = now_ns
        if held.trajectory != self._site:
            self._begin(held.trajectory)
        tables = SkullTables.of(sum(float(one.argument) for one in self._board.active(OTHER_BONE.name)))
        depth_mm = self._depth_mm(held.tip_mm)
        turns = held.turns and not self._board.active(DRILL_STALLS.name)
        thrust_N = self._thrust.advance(tables, depth_mm, cycle_s if turns else 0.0)
        if depth_mm > tables.outside_mm:
            for one in self._board.active(DRILL_ASIDE.name):
                self.side_N = (
                    self.side_N[0] + float(one.arguments[0]),
                    self.side_N[1] + float(one.arguments[1]),
                )
            self._world.note_opening(self._site, self._thrust.bottom_mm, depth_mm - tables.inside_mm)
        return thrust_N + self._friction * hypot(*self.side_N)

    def _begin(self, site: str) -> None:
        """Begin at a site, where the opening may be begun already."""
        opening = self._world.opening()
        drawn = noise(self._world.scene.seed, f"{SITE} {site}", 0).standard_normal()
        harder = 1.0 + HARDER_SHARE * min(max(float(drawn), -2.0), 2.0)
        begun_mm = opening.bottom_mm if opening.trajectory == site else 0.0
        self._site, self._thrust = site, ThrustModel(harder, begun_mm)

    def _depth_mm(self, tip_mm: float) -> float:
        """Return the true depth of the drill's tip below the skin of the head."""
        world, room, head = self._world, self._room.now(), self._world.scene.head
        assert self._flange_from_clamp is not None
        base = self._room.robot_from_base(self._role, room)
        clamp = base @ world.arm(self._role).robot_from_flange @ self._flange_from_clamp
        moved_head = rigid_move(room.head_rad, room.head_mm) @ matrix_of(head.robot_from_ct)
        place = inverse(moved_head) @ clamp @ np.array([0.0, 0.0, tip_mm, 1.0])
        return depth_below_skin_mm(as_point(place[:3]), head.centre_ct_mm, head.semi_axes_mm)

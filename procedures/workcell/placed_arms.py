"""Bases and surroundings of the arms of a theatre, and the distances kept between them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, product
from typing import NamedTuple

from procedures.workcell.errors import OtherArmUnknown
from ronna_hw.arm.clearance import arm_pair
from ronna_hw.arm.clearance.bodies import Bodies, Obstacle, Surroundings
from ronna_hw.arm.clearance.live_pair import LivePair
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.pose import Pose
from ronna_hw.vectors import JointVector


class RolePair(NamedTuple):
    """Roles of two arms, in the order of the theatre's."""

    first: str
    second: str


class PlacedArms:
    """Arms by role: bases, declared surroundings, and the distances between them.

    Bases are ROBOT <- base of the arm; the first arm's is the robot frame.
    """

    def __init__(self, roles: Sequence[str], kinematics: Callable[[str], Kinematics]) -> None:
        """Know the base of the first role only; `kinematics` returns those of an arm."""
        self.roles = tuple(roles)
        self.pairs = [RolePair(*pair) for pair in combinations(roles, 2)]
        self._kinematics = kinematics
        self._bases = {roles[0]: Pose()}
        self._uncertain_mm = dict.fromkeys(roles, 0.0)  # of the bases, at their arms
        self.around = dict.fromkeys(roles, Surroundings())  # as declared, without the other arms
        self._closeness = dict.fromkeys(self.pairs, arm_pair.NO_CLOSENESS)

    def place(self, role: str, base: Pose, uncertain_mm: float) -> None:
        """Take a base as known; by `uncertain_mm` the arm may be elsewhere."""
        self._bases[role], self._uncertain_mm[role] = base, uncertain_mm

    def is_placed(self, role: str) -> bool:
        return role in self._bases

    def base(self, role: str) -> Pose:
        """Return ROBOT <- base of an arm that is placed."""
        return self._bases[role]

    @property
    def are_all_placed(self) -> bool:
        return all(map(self.is_placed, self.roles))

    def require_all_placed(self) -> None:
        """Raise DUAL-003 unless the bases of all arms are known."""
        for role in self.roles:
            if not self.is_placed(role):
                raise OtherArmUnknown(
                    f"where the {role} stands is not known",
                    action="Run base_to_base first: nothing has moved.",
                )

    def others(self, role: str) -> list[str]:
        return [one for one in self.roles if one != role]

    def allow_contact(
        self, role: str, with_role: str, of_own: Collection[str], of_other: Collection[str]
    ) -> None:
        """Let these parts of one arm's tool touch these of a later role's, and no others any more.

        The rest of the other may come as close to these parts of the one as to a guide.
        """
        touching = frozenset(product(of_own, of_other))
        self._closeness[RolePair(role, with_role)] = arm_pair.Closeness(touching, frozenset(of_own))

    def contacts(self, pair: RolePair) -> frozenset[tuple[str, str]]:
        """Return the bodies of two arms that may touch, by name."""
        return self._closeness[pair].contacts

    def surroundings_among(self, role: str, others_rad: Mapping[str, JointVector]) -> Surroundings:
        """Return the surroundings of an arm with others as obstacles, at rest at these joints."""
        around, obstacles, contacts = self.around[role], list[Obstacle](), list[tuple[str, str]]()
        for other, joints_rad in others_rad.items():
            pair = next(pair for pair in self.pairs if set(pair) == {role, other})
            closeness, grown_mm = self._closeness[pair], self._grown_mm(role, pair)
            near = closeness.near if role == pair.second else ()
            obstacles += self.arm(other).as_obstacles(joints_rad, self._bases[role], grown_mm, near)
            touching = (one if role == pair.first else one[::-1] for one in closeness.contacts)
            contacts += [(own, arm_pair.name_of(part, other)) for own, part in touching]
        around = around.thickened(self._uncertain_mm[role])
        return replace(
            around, owner=role, obstacles=(*around.obstacles, *obstacles), contacts=tuple(contacts)
        )

    def are_apart(self, at_rad: Mapping[str, JointVector]) -> bool:
        """Return whether all arms, at these joints, keep the distance that is planned between them."""
        return all(
            self._distance_mm(pair, at_rad) >= arm_pair.PLANNED_APART_MM + self.doubt_mm(pair)
            for pair in self.pairs
        )

    def _distance_mm(self, pair: RolePair, at_rad: Mapping[str, JointVector]) -> float:
        from ronna_hw.arm.clearance.arm_pair_world import (
            ArmPairWorld,
        )  # on demand: a single arm needs no coal

        world = ArmPairWorld(self.arm(pair.first), self.arm(pair.second), self._closeness[pair])
        return world.distance(at_rad[pair.first], at_rad[pair.second]).distance_mm

    def doubt_mm(self, pair: RolePair) -> float:
        """Return by how much two arms may be elsewhere to each other."""
        return self._uncertain_mm[pair.first] + self._uncertain_mm[pair.second]

    def arm(self, role: str) -> arm_pair.PlacedArm:
        """Return the bodies of an arm where it stands."""
        return arm_pair.PlacedArm(role, Bodies(self._kinematics(role), self.around[role]), self._bases[role])

    def live(self) -> dict[RolePair, LivePair]:
        """Return the watched distances between the arms."""
        return {
            pair: LivePair(self.arm(pair.first), self.arm(pair.second), self._closeness[pair])
            for pair in self.pairs
        }

    def _grown_mm(self, role: str, pair: RolePair) -> float:
        """Return the thickening of the other arm that turns obstacle margins into those between two arms."""
        around = self.around[role]
        grown_mm = max(
            arm_pair.APART_MM - around.live_margin_mm, arm_pair.PLANNED_APART_MM - around.margin_mm
        )
        return grown_mm + self.doubt_mm(pair)

"""One arm in the 3-D scene: its capsules, what stands around it, and its closest checked pair."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from console.scene.bodies import Call, Closest, DrawnCapsule, DrawnRod, axis_ends, closest_pair
from procedures.engine.case_view import ReportedPose
from procedures.engine.events import Bodies, Body, Pose

TOOL, ROOM, OLD, NEAR = "#cfd8dc", "#8296a3", "#8a8f94", "#ffffff"
OLD_S = 0.5  # theatre time after which a pose is greyed out


class DrawnArm:
    """Bodies of one arm in a scene. Sends only changes."""

    def __init__(self, scene: Any, colour: str) -> None:
        self._scene, self._colour = scene, colour
        self._near = DrawnRod(scene, 2.0, NEAR)
        self.bodies: Bodies | None = None
        self._moving: list[DrawnCapsule] = []
        self._fixed: list[DrawnCapsule] = []
        self.pose: Pose | None = None
        self._is_grey: bool | None = None
        self.closest: Closest | None = None

    def show(
        self, bodies: Bodies, reported: ReportedPose | None, now_s: float, drawn: Collection[Body]
    ) -> None:
        """Show the arm at one moment; what is `drawn` already, around another arm, is not drawn again."""
        if bodies is not self.bodies:
            self._build(bodies, drawn)
        if reported is None:
            self.pose = None
            self._show_closest(None)
        elif reported.pose is not self.pose:
            self._place(bodies, reported.pose)
        self._grey_if_old(bodies, is_old=reported is None or reported.age_s(now_s) > OLD_S)

    def _build(self, bodies: Bodies, drawn: Collection[Body]) -> None:
        for item in (*self._moving, *self._fixed):
            item.delete()
        self.bodies, self._moving, self.pose, self._is_grey = bodies, [], None, None
        self._fixed, calls = [], list[Call]()
        for body in bodies.fixed:
            if not body.is_head and body not in drawn:
                ends = axis_ends(body.ends_mm)
                self._fixed.append(DrawnCapsule(self._scene, body, *ends, ROOM, 1.0))
                calls += self._fixed[-1].place(*ends)
        self._scene.run_method("run_methods", calls)

    def _place(self, bodies: Bodies, pose: Pose) -> None:
        self.pose = pose
        if len(pose.bodies_mm) != len(bodies.moving):
            self._show_closest(None)
            return
        if not self._moving:
            self._moving = [
                DrawnCapsule(self._scene, body, *axis_ends(place), self._colour_of(number, bodies), 1.0)
                for number, (body, place) in enumerate(zip(bodies.moving, pose.bodies_mm, strict=True))
            ]
        calls: list[Call] = []
        for capsule, place in zip(self._moving, pose.bodies_mm, strict=True):
            calls += capsule.place(*axis_ends(place))
        self._scene.run_method("run_methods", calls + self._show_closest(closest_pair(bodies, pose)))

    def _show_closest(self, closest: Closest | None) -> list[Call]:
        self.closest = closest
        if closest is None:
            self._near.group.visible(False)
            return []
        return self._near.place(closest.from_mm, closest.to_mm)

    def _grey_if_old(self, bodies: Bodies, *, is_old: bool) -> None:
        if is_old == self._is_grey or not self._moving:
            return
        self._is_grey = is_old
        for number, capsule in enumerate(self._moving):
            for child in capsule.group.children:
                child.material(OLD if is_old else self._colour_of(number, bodies), 1.0)

    def _colour_of(self, number: int, bodies: Bodies) -> str:
        return self._colour if number < bodies.links else TOOL

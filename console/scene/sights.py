"""Tracker and stereo head in the scene: measuring volume, lines of sight, camera frusta."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Sequence
from typing import Any

from console.scene.bodies import METRES, Call, DrawnRod, Point, axis_ends, placing_calls
from procedures.engine.case_view import CaseView
from procedures.engine.events import Bodies, MeasuringVolume, Pose
from procedures.reporting.case_figures import CaseFigures
from ronna_hw.arm.clearance.bodies import segment_distance_mm
from ronna_hw.devices.crossed_sight import SENSORS_MM
from ronna_hw.frames import Transform

SIGHT, HIDDEN, VOLUME, FRUSTUM = "#ffb020", "#ff5a4f", "#6f8798", "#42d392"
SIGHT_OPACITY, VOLUME_OPACITY, FRUSTUM_OPACITY = 0.5, 0.6, 0.9
HOUSING_RADIUS_MM = 40.0
RECHECK_S = 0.5  # host time between checks which lines of sight are blocked
CORNERS = ((-1, -1), (1, -1), (1, 1), (-1, 1))


class Sights:
    """Lines of sight and measuring volumes in a scene. Sends only changes."""

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self._marks: list[Any] = []
        self._lines: list[tuple[Any, Point, Point]] = []
        self._hidden: list[bool] = []
        self._checked_s = -math.inf
        self._frusta: dict[str, list[Any]] = {}  # by arm
        self._bodies: dict[str, Bodies] = {}  # for which those were built
        self._shown: object = ()

    def show(self, view: CaseView, figures: CaseFigures | None) -> None:
        """Show lines of sight and volumes at one moment of the case."""
        tracker = None if figures is None else figures.robot_from_tracker
        key = tracker, view.volume, None if figures is None else figures.spheres
        if key != self._shown:
            self._shown = key
            self._build_tracker(tracker, view.volume, figures)
        placed = [(bodies, view.poses[arm].pose) for arm, bodies in view.bodies.items() if arm in view.poses]
        for bodies, pose in placed:
            if bodies is not self._bodies.get(bodies.arm):
                self._build_frusta(bodies)
            self._place_frusta(pose)
        if placed and time.monotonic() - self._checked_s > RECHECK_S:
            self._checked_s = time.monotonic()
            self._colour_lines(placed)

    @property
    def hidden(self) -> int:
        """Number of spheres that an arm hides from at least one tracker sensor."""
        return len({line[2] for line, hidden in zip(self._lines, self._hidden, strict=True) if hidden})

    def _build_tracker(
        self, tracker: Transform | None, volume: MeasuringVolume | None, figures: CaseFigures | None
    ) -> None:
        for mark in self._marks:
            mark.delete()
        self._marks, self._lines, self._hidden = [], [], []
        if tracker is None or figures is None:
            return
        eyes = [_to_point(eye) for eye in tracker.apply(SENSORS_MM).tolist()]
        housing = DrawnRod(self._scene, HOUSING_RADIUS_MM, SIGHT)
        self._scene.run_method("run_methods", housing.place(eyes[0], eyes[1]))
        self._marks.append(housing.group)
        sphere_places = [sphere.tracker_mm for sphere in figures.spheres if sphere.tracker_mm is not None]
        for place in sphere_places:
            for eye in eyes:
                line = self._add_line(eye, place, SIGHT, SIGHT_OPACITY)
                self._lines.append((line, eye, place))
                self._marks.append(line)
        self._hidden = [False] * len(self._lines)
        self._checked_s = -math.inf
        for start, end in volume_edges(volume):
            places = [_to_point(place) for place in tracker.apply([start, end]).tolist()]
            self._marks.append(self._add_line(places[0], places[1], VOLUME, VOLUME_OPACITY))

    def _colour_lines(self, placed: Sequence[tuple[Bodies, Pose]]) -> None:
        hidden = [
            any(is_hidden(eye, place, bodies, pose) for bodies, pose in placed)
            for _, eye, place in self._lines
        ]
        for (line, _, _), now, before in zip(self._lines, hidden, self._hidden, strict=True):
            if now != before:
                line.material(HIDDEN if now else SIGHT, SIGHT_OPACITY)
        self._hidden = hidden

    def _build_frusta(self, bodies: Bodies) -> None:
        for mark in self._frusta.get(bodies.arm, ()):
            mark.delete()
        self._bodies[bodies.arm], self._frusta[bodies.arm] = bodies, []
        for camera in bodies.cameras:
            values = camera.points_mm
            centre, *corners = (_to_point(values[k : k + 3]) for k in range(0, len(values), 3))
            with self._scene.group() as group:
                for number, corner in enumerate(corners):
                    self._add_line(centre, corner, FRUSTUM, FRUSTUM_OPACITY)
                    self._add_line(corner, corners[(number + 1) % len(corners)], FRUSTUM, FRUSTUM_OPACITY)
            self._frusta[bodies.arm].append(group.with_name(f"{camera.name} camera").visible(False))

    def _place_frusta(self, pose: Pose) -> None:
        frusta = self._frusta[pose.arm]
        if not frusta or not pose.tool_mm:
            return
        rows = [list(pose.tool_rows[k : k + 3]) for k in (0, 3, 6)]
        calls: list[Call] = []
        for group in frusta:
            group.visible_ = True
            calls += [*placing_calls(group, _to_point(pose.tool_mm), rows), ["visible", group.id, True]]
        self._scene.run_method("run_methods", calls)

    def _add_line(self, start: Point, end: Point, colour: str, opacity: float) -> Any:
        metres = [[value * METRES for value in point] for point in (start, end)]
        return self._scene.line(*metres).material(colour, opacity)


def volume_edges(volume: MeasuringVolume | None) -> list[tuple[Point, Point]]:
    """Return the edges of a measuring volume in the tracker frame, mm."""
    if volume is None:
        return []
    rings = [[(x * sx, y * sy, z) for sx, sy in CORNERS] for z, x, y in volume.sections_mm]
    around = [(ring[k], ring[(k + 1) % len(ring)]) for ring in rings for k in range(len(ring))]
    along = [pair for near, far in itertools.pairwise(rings) for pair in zip(near, far, strict=True)]
    return around + along


def is_hidden(eye: Point, place: Point, bodies: Bodies, pose: Pose) -> bool:
    """Return whether a moving body blocks a line of sight."""
    if len(pose.bodies_mm) != len(bodies.moving):
        return False
    capsules = zip(bodies.moving, pose.bodies_mm, strict=True)
    return any(segment_distance_mm(eye, place, *axis_ends(axis)) < body.radius_mm for body, axis in capsules)


def _to_point(values: Any) -> Point:
    x, y, z = values
    return (x, y, z)

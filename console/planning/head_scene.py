"""The head in three dimensions, with markers, trajectories and the crosshair."""

from __future__ import annotations

from typing import Any

import numpy as np
from nicegui import ui

from console.planning.plan_editor import PlanEditor
from console.planning.slice_panel import AVOIDED, CHOSEN, CROSS, OTHER, SPHERE
from console.planning.slices import PageView
from console.scene.bodies import METRES, Call, Rod
from console.scene.theatre_scene import (
    BACKGROUND,
    FRAMES_PER_S,
    HEAD_OPACITY,
    LOW_FRAMES_PER_S,
    LOW_OPACITY,
    SKIN,
)
from procedures.planning.line_of_sight import SPHERE_RADIUS_MM
from procedures.strategies.trajectory import Point

OUTSIDE_MM = 40.0  # length of a trajectory drawn outside the entry
ARM_OF_CROSS_MM = 130.0
POINT_MM = 2.0  # of a structure
VIEWS: dict[str, Point] = {"front": (0.0, -1.0, 0.25), "left": (1.0, -0.1, 0.25), "above": (0.0, -0.05, 1.0)}
AWAY_MM = 480.0


class HeadScene:
    """The head's scene of a page, in CT coordinates, metres."""

    def __init__(self, editor: PlanEditor, look: PageView, *, low: bool) -> None:
        self._editor, self._look, self._low = editor, look, low
        self._head: Any = None
        self._marks: list[Any] = []
        self._key: object = None
        self._avoided: list[Any] = []
        self._avoided_key: object = None
        self._placed: object = None
        with ui.element("section").classes("card scenebox").props('aria-label="The head"'):
            self._views = ui.element("div").classes("views").props('role=group aria-label="Views"')
            self._scene = ui.scene(
                width=420,
                height=300,
                grid=False,
                background_color=BACKGROUND,
                fps=LOW_FRAMES_PER_S if low else FRAMES_PER_S,
                camera=ui.scene.perspective_camera(fov=35, near=0.02, far=20),
            ).classes("stage")
            self._scene.props('role=img aria-label="The head in three dimensions"')
            with self._scene:
                self._cross = [Rod(self._scene, 0.5, CROSS) for _ in range(3)]
        with self._views:
            for name in (*VIEWS, "along"):
                ui.button(name, on_click=lambda name=name: self._view(name), color=None).classes(
                    "plain small"
                ).props("no-caps unelevated")
        self._view("front")

    def show(self) -> None:
        """Show the current draft."""
        editor, draft = self._editor, self._editor.draft
        with self._scene:
            if self._head is None and editor.head:
                self._head = self._scene.stl("/picture/head.stl").with_name("head")
                self._head.material(SKIN, LOW_OPACITY if self._low else HEAD_OPACITY)
            key = (tuple(map(id, draft.markers)), draft.ways, self._look.way)
            if key != self._key:
                self._key = key
                self._build_marks()
            if draft.structures != self._avoided_key:
                self._avoided_key = draft.structures
                self._build_avoided()
            if self._look.place_mm != self._placed:
                self._placed = self._look.place_mm
                self._place_cross(self._look.place_mm)

    def _build_marks(self) -> None:
        for one in self._marks:
            one.delete()
        self._marks = []
        for marker in self._editor.draft.markers:
            self._ball(list(marker.centre_mm), SPHERE_RADIUS_MM, SPHERE)
        for way in self._editor.draft.ways:
            colour = CHOSEN if way.identifier == self._look.way else OTHER
            for place, radius_mm in ((way.entry_mm, 2.0), (way.target_mm, 2.8)):
                if place is not None:
                    self._ball(place, radius_mm, colour)
            if way.ends is not None and way.depth_mm:
                share = OUTSIDE_MM / way.depth_mm
                out = tuple(e + share * (e - t) for e, t in zip(*way.ends, strict=True))
                rod = Rod(self._scene, 0.9, colour)
                self._scene.run_method("run_methods", rod.place((out[0], out[1], out[2]), way.ends[1]))
                self._marks.append(rod.group)

    def _build_avoided(self) -> None:
        for one in self._avoided:
            one.delete()
        self._avoided = []
        for structure in self._editor.draft.structures:
            points = (np.array(structure.points_mm) * METRES).tolist()
            cloud = self._scene.point_cloud(points, point_size=POINT_MM * METRES)
            self._avoided.append(cloud.material(AVOIDED))

    def _ball(self, place_mm: Any, radius_mm: float, colour: str) -> None:
        ball = self._scene.sphere(radius_mm * METRES, 20, 14).material(colour)
        self._marks.append(ball.move(*(value * METRES for value in place_mm)))

    def _place_cross(self, place_mm: Point) -> None:
        calls: list[Call] = []
        for axis, rod in enumerate(self._cross):
            ends = [list(place_mm), list(place_mm)]
            ends[0][axis] -= ARM_OF_CROSS_MM
            ends[1][axis] += ARM_OF_CROSS_MM
            (a, b, c), (d, e, f) = ends
            calls += rod.place((a, b, c), (d, e, f))
        self._scene.run_method("run_methods", calls)

    def _view(self, name: str) -> None:
        middle = self._look.focus_mm
        direction = VIEWS.get(name, VIEWS["front"])
        if name == "along":
            way = next((one for one in self._editor.draft.ways if one.identifier == self._look.way), None)
            if way is None or way.ends is None or not way.depth_mm:
                return
            entry, middle = way.ends
            x, y, z = ((e - t) / way.depth_mm for e, t in zip(entry, middle, strict=True))
            direction = (x, y, z)
        x, y, z = ((m + AWAY_MM * d) * METRES for m, d in zip(middle, direction, strict=True))
        a, b, c = (value * METRES for value in middle)
        self._scene.move_camera(x, y, z, a, b, c, duration=0.0)

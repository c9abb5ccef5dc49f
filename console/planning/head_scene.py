"""3-D view of the head, with markers, trajectories and the crosshair."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from nicegui import ui

from console.panels.elements import card, group, html, small_button
from console.planning.plan_editor import PlanEditor
from console.planning.slice_panel import AVOIDED, CHOSEN, CROSS, OTHER, SPHERE
from console.planning.slices import SIZE_PX, PageView
from console.planning.views import PlanView
from console.scene.bodies import METRES, Call, DrawnRod
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
    """3-D scene of the head on one page, in CT coordinates, metres."""

    def __init__(
        self, editor: PlanEditor, page_view: PageView, enlarge: Callable[[PlanView], None], *, low: bool
    ) -> None:
        self._editor, self._page_view, self._low = editor, page_view, low
        self._scene: Any = None
        self._head: Any = None
        self._marks: list[Any] = []
        self._key: object = None
        self._structure_clouds: list[Any] = []
        self._structures_key: object = None
        self._placed: object = None
        self.section = card("slice scenebox", "The head", heading=False)
        with self.section:
            with ui.element("div").classes("slicehead"):
                html("<h2>3-D head</h2>")
                self._views = group("views", "Views")
            stage = ui.element("div").classes("stagebox")
            stage.on(
                "click", lambda: enlarge(PlanView.HEAD) if page_view.large is not PlanView.HEAD else None
            )
        self._stage = stage

    def build_scene(self) -> None:
        """Create the scene, whose script is larger than all others: after the CT's pictures are shown."""
        with self._stage:
            self._scene = ui.scene(
                width=SIZE_PX,
                height=SIZE_PX,
                grid=False,
                background_color=BACKGROUND,
                fps=LOW_FRAMES_PER_S if self._low else FRAMES_PER_S,
                camera=ui.scene.perspective_camera(fov=35, near=0.02, far=20),
            ).classes("stage")
            self._scene.props('role=img aria-label="The head in three dimensions"')
            with self._scene:
                self._cross = [DrawnRod(self._scene, 0.5, CROSS) for _ in range(3)]
        with self._views:
            for name in (*VIEWS, "along"):
                small_button(name, partial(self._move_camera, name))
        self.show()
        self._move_camera("front")

    def show(self) -> None:
        if self._scene is None:
            return
        editor, draft = self._editor, self._editor.draft
        with self._scene:
            if self._head is None and editor.head:
                self._head = self._scene.stl("/picture/head.stl").with_name("head")
                self._head.material(SKIN, LOW_OPACITY if self._low else HEAD_OPACITY)
            key = (tuple(map(id, draft.markers)), draft.ways, self._page_view.way)
            if key != self._key:
                self._key = key
                self._build_marks()
            if draft.structures != self._structures_key:
                self._structures_key = draft.structures
                self._build_structures()
            if self._page_view.place_mm != self._placed:
                self._placed = self._page_view.place_mm
                self._place_cross(self._page_view.place_mm)

    def _build_marks(self) -> None:
        for mark in self._marks:
            mark.delete()
        self._marks = []
        for marker in self._editor.draft.markers:
            self._ball(list(marker.centre_mm), SPHERE_RADIUS_MM, SPHERE)
        for way in self._editor.draft.ways:
            colour = CHOSEN if way.identifier == self._page_view.way else OTHER
            for place, radius_mm in ((way.entry_mm, 2.0), (way.target_mm, 2.8)):
                if place is not None:
                    self._ball(place, radius_mm, colour)
            if way.ends is not None and way.depth_mm:
                share = OUTSIDE_MM / way.depth_mm
                outer_end_mm = tuple(e + share * (e - t) for e, t in zip(*way.ends, strict=True))
                rod = DrawnRod(self._scene, 0.9, colour)
                self._scene.run_method(
                    "run_methods", rod.place((outer_end_mm[0], outer_end_mm[1], outer_end_mm[2]), way.ends[1])
                )
                self._marks.append(rod.group)

    def _build_structures(self) -> None:
        for mark in self._structure_clouds:
            mark.delete()
        self._structure_clouds = []
        for structure in self._editor.draft.structures:
            points = (np.array(structure.points_mm) * METRES).tolist()
            cloud = self._scene.point_cloud(points, point_size=POINT_MM * METRES)
            self._structure_clouds.append(cloud.material(AVOIDED))

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

    def _move_camera(self, name: str) -> None:
        middle = self._page_view.focus_mm
        direction = VIEWS.get(name, VIEWS["front"])
        if name == "along":
            way = self._editor.draft.find_way(self._page_view.way)
            if way is None or way.ends is None or not way.depth_mm:
                return
            entry, middle = way.ends
            x, y, z = ((e - t) / way.depth_mm for e, t in zip(entry, middle, strict=True))
            direction = (x, y, z)
        x, y, z = ((m + AWAY_MM * d) * METRES for m, d in zip(middle, direction, strict=True))
        a, b, c = (value * METRES for value in middle)
        self._scene.move_camera(x, y, z, a, b, c, duration=0.0)

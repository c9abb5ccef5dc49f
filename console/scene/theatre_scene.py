"""3-D scene of the theatre: arm, head, spheres, trajectories, lines of sight, clearance, and controls."""

from __future__ import annotations

from functools import partial
from typing import Any

from nicegui import ui

from console.panels.elements import card, group, html, small_button
from console.panels.html import tag, text
from console.scene.bodies import (
    METRES,
    Call,
    Closest,
    DrawnCapsule,
    DrawnRod,
    Point,
    axis_ends,
    closest_pair,
    guide_end,
    placing_calls,
)
from console.scene.sights import HIDDEN, VOLUME, Sights
from procedures.engine.case_view import CaseView
from procedures.engine.events import Bodies, Pose
from procedures.planning.line_of_sight import SPHERE_RADIUS_MM
from procedures.reporting.case_figures import CaseFigures, SphereFigure
from ronna_hw.frames import Transform

BACKGROUND = "#26333e"  # dark in both themes, so that bodies of every colour stand out
ARM, TOOL, ROOM, OLD = "#f08a24", "#cfd8dc", "#8296a3", "#8a8f94"
CT, TRACKER, STEREO = "#58a6ff", "#ffb020", "#42d392"
SKIN, PATH, NEAR = "#d9b9a3", "#ff5fa2", "#ffffff"
INSTRUMENT, CAPTION = "#e7f04c", "instrument, as planned"  # nothing measures it
LINKS = 4  # the first of the moving bodies are the arm's own: drawn in its colour
OUTSIDE = 2.5  # length of a trajectory drawn outside the entry, as a share of its depth
AT_TARGET = "at_target"  # topic of the question that stands while the instrument is at depth
OLD_S = 0.5  # theatre time after which a pose is greyed out
BEHIND_TRACKER_MM, AHEAD_MM = (500.0, 0.0, 900.0), (0.0, 0.0, -1600.0)  # in the tracker frame
FRAMES_PER_S, LOW_FRAMES_PER_S = 20, 4
HEAD_OPACITY, LOW_OPACITY = 0.55, 1.0  # translucency is expensive without graphics hardware
LABEL = "color:#fff;background:rgba(0,0,0,.55);padding:0 4px;border-radius:3px;font:12px sans-serif"
MAGNIFICATIONS = {1: "as measured", 10: "differences × 10", 30: "differences × 30"}
KEY = (
    ("arm (as checked)", ARM),
    ("spheres from the CT", CT),
    ("tracker", TRACKER),
    ("stereo head", STEREO),
    ("plan", PATH),
    (CAPTION, INSTRUMENT),
    ("hidden from the tracker", HIDDEN),
    ("measuring volume", VOLUME),
)


class ScenePanel:
    """Panel of the arm and its surroundings."""

    def __init__(self, *, low: bool) -> None:
        self._figures: CaseFigures | None = None
        with card("scenebox", "The theatre", heading=False):
            with ui.element("div").classes("sceneline"):
                self._views = group("views", "Views")
                self._size = ui.select(MAGNIFICATIONS, value=1, on_change=self._magnify)
                self._size.props('dense outlined options-dense aria-label="Differences between instruments"')
            self._age = html()
            self._scene = TheatreScene(low=low)
            key = "".join(tag("span", f'<i style="background:{colour}"></i>{words}') for words, colour in KEY)
            html(tag("div", key, class_="key"))
        self._names: list[str] | None = None
        self._scene.look_at("robot", None)

    def show(self, view: CaseView, figures: CaseFigures | None, heads: int) -> None:
        self._figures = figures
        names = [path.name for path in figures.trajectories] if figures else []
        if names != self._names:
            self._names = names
            self._build_views(names)
        self._scene.show(view, figures, heads)
        self._age.set_content(_age(view) + self._clearance_html() + self._sight_html())

    def _build_views(self, names: list[str]) -> None:
        self._views.clear()
        with self._views:
            places = ("robot", "head", "tracker")
            for name, words in (*zip(places, places, strict=True), *((one, f"along {one}") for one in names)):
                small_button(words, partial(self._look_at, name))

    def _look_at(self, name: str) -> None:
        self._scene.look_at(name, self._figures)

    def _clearance_html(self) -> str:
        closest = self._scene.closest
        if closest is None:
            return ""
        words = f"closest: {closest.first} and {closest.second}, {closest.distance_mm:.0f} mm"
        return tag("div", text(words), class_="num")

    def _sight_html(self) -> str:
        hidden = self._scene.hidden
        if not hidden:
            return ""
        words = f"the arm blocks the tracker's view of {hidden} of the spheres (red lines)"
        return tag("div", words, class_="warn")

    def _magnify(self) -> None:
        self._scene.magnified = int(self._size.value or 1)


def _age(view: CaseView) -> str:
    reported_pose = view.pose
    if reported_pose is None:
        return tag("div", "No arm position yet: it comes with the connected devices.", class_="dim")
    age_s = view.theatre_time_s - reported_pose.reported_s + reported_pose.pose.age_s
    if age_s > OLD_S:
        return tag("div", f"POSE IS {age_s:.1f} s OLD, shown grey", class_="warn num")
    return tag("div", f"pose is {age_s:.2f} s old", class_="num")


class TheatreScene:
    """3-D scene of the theatre on one page. `show` sends only changes."""

    def __init__(self, *, low: bool) -> None:
        self._low = low
        self.magnified = 1  # magnification of the instruments' differences from the CT
        self.scene = ui.scene(
            width=600,
            height=430,
            grid=False,
            background_color=BACKGROUND,
            fps=LOW_FRAMES_PER_S if low else FRAMES_PER_S,
            camera=ui.scene.perspective_camera(fov=40, near=0.02, far=20),
        ).classes("stage")
        self.scene.props('role=img aria-label="The theatre in three dimensions"')
        self._bodies: Bodies | None = None
        self._moving: list[DrawnCapsule] = []
        self._fixed: list[DrawnCapsule] = []
        self._pose: Pose | None = None
        self._is_grey: bool | None = None
        self._figures: object = None
        self._marks: list[Any] = []
        self._instrument_ends: tuple[Point, Point] | None = None
        self._instrument: list[Any] = []
        self._head: Any = None
        self._head_count = 0
        with self.scene:
            self._near = DrawnRod(self.scene, 2.0, NEAR)
            self._sights = Sights(self.scene)
        self.closest: Closest | None = None

    def show(self, view: CaseView, figures: CaseFigures | None, heads: int) -> None:
        """Show the case at one moment. `heads` counts rebuilds of the head's surface."""
        with self.scene:
            if view.bodies is not self._bodies and view.bodies is not None:
                self._build_bodies(view.bodies, view.pose.pose if view.pose else None)
            key = (figures, heads, self.magnified)
            if key != self._figures:
                self._figures = key
                self._build_marks(figures, heads)
            self._show_instrument(_instrument_ends(view, figures))
            self._sights.show(view, figures)
            if view.pose is None:
                self._pose = None
                self._show_closest(None)
            elif view.pose.pose is not self._pose:
                self._place_bodies(view.pose.pose)
        self._grey_if_old(view)

    # The bodies

    def _build_bodies(self, bodies: Bodies, pose: Pose | None) -> None:
        for item in (*self._moving, *self._fixed):
            item.delete()
        self._bodies, self._moving, self._pose, self._is_grey = bodies, [], None, None
        self._fixed = [
            DrawnCapsule(self.scene, body, *axis_ends(body.ends_mm), ROOM, 1.0)
            for body in bodies.fixed
            if not body.is_head
        ]
        if pose is not None and len(pose.bodies_mm) == len(bodies.moving):
            self._build_moving(bodies, pose)

    def _build_moving(self, bodies: Bodies, pose: Pose) -> None:
        self._moving = [
            DrawnCapsule(self.scene, body, *axis_ends(place), ARM if number < LINKS else TOOL, 1.0)
            for number, (body, place) in enumerate(zip(bodies.moving, pose.bodies_mm, strict=True))
        ]

    def _place_bodies(self, pose: Pose) -> None:
        self._pose, bodies = pose, self._bodies
        if bodies is None or len(pose.bodies_mm) != len(bodies.moving):
            self._show_closest(None)
            return
        if not self._moving:
            self._build_moving(bodies, pose)
        calls: list[Call] = []
        for capsule, place in zip(self._moving, pose.bodies_mm, strict=True):
            calls += capsule.place(*axis_ends(place))
        self.scene.run_method("run_methods", calls + self._show_closest(closest_pair(bodies, pose)))

    def _show_closest(self, closest: Closest | None) -> list[Call]:
        self.closest = closest
        if closest is None:
            self._near.group.visible(False)
            return []
        return self._near.place(closest.from_mm, closest.to_mm)

    def _grey_if_old(self, view: CaseView) -> None:
        reported_pose = view.pose
        is_old = (
            reported_pose is None
            or view.theatre_time_s - reported_pose.reported_s + reported_pose.pose.age_s > OLD_S
        )
        if is_old == self._is_grey or not self._moving:
            return
        self._is_grey = is_old
        for number, capsule in enumerate(self._moving):
            colour = OLD if is_old else ARM if number < LINKS else TOOL
            for child in capsule.group.children:
                child.material(colour, 1.0)

    # Measurements and plan

    def _build_marks(self, figures: CaseFigures | None, heads: int) -> None:
        for item in self._marks:
            item.delete()
        self._marks = []
        self._show_head(None if figures is None else figures.robot_from_ct, heads)
        if figures is None:
            return
        for sphere in figures.spheres:
            self._add_sphere(sphere)
        for path in figures.trajectories:
            self._add_path(path.name, path.entry_mm, path.target_mm)

    def _show_head(self, pose: Transform | None, heads: int) -> None:
        if pose is None or not heads:
            if self._head is not None:
                self._head.visible(False)
            return
        if heads != self._head_count:
            if self._head is not None:
                self._head.delete()
            self._head = self.scene.stl("/picture/head.stl").with_name("head")
            self._head.material(SKIN, LOW_OPACITY if self._low else HEAD_OPACITY)
            self._head_count = heads
        self._head.visible()
        rotation = pose.rotation_matrix.tolist()
        x, y, z = pose.translation_mm.tolist()
        self.scene.run_method("run_methods", placing_calls(self._head, (x, y, z), rotation))

    def _add_sphere(self, sphere: SphereFigure) -> None:
        ct = sphere.ct_mm
        if ct is not None:
            self._add_ball(ct, CT)
            self._add_label(f"{sphere.number}", ct)
        for place, colour in ((sphere.tracker_mm, TRACKER), (sphere.stereo_mm, STEREO)):
            if place is None:
                continue
            if ct is None:
                self._add_ball(place, colour)
                continue
            x, y, z = (c + self.magnified * (p - c) for c, p in zip(ct, place, strict=True))
            self._add_ball((x, y, z), colour, share=0.8)

    def _add_ball(self, place: Point, colour: str, share: float = 1.0) -> None:
        radius = SPHERE_RADIUS_MM * share * METRES
        ball = (
            self.scene.sphere(radius, 20, 14).move(*(value * METRES for value in place)).material(colour, 0.8)
        )
        self._marks.append(ball)

    def _add_label(self, words: str, place: Point) -> None:
        self._marks.append(self.scene.text(words, LABEL).move(*(value * METRES for value in place)))

    def _add_path(self, name: str, entry: Point, target: Point) -> None:
        out = tuple(e + OUTSIDE * (e - t) for e, t in zip(entry, target, strict=True))
        self._marks.append(self._add_rod(1.2, PATH, (out[0], out[1], out[2]), target))
        self._add_ball(target, PATH, share=0.4)
        self._add_label(name, (out[0], out[1], out[2]))

    def _add_rod(self, radius_mm: float, colour: str, start: Point, end: Point) -> Any:
        rod = DrawnRod(self.scene, radius_mm, colour)
        self.scene.run_method("run_methods", rod.place(start, end))
        return rod.group

    def _show_instrument(self, inserted: tuple[Point, Point] | None) -> None:
        if inserted == self._instrument_ends:
            return
        for item in self._instrument:
            item.delete()
        self._instrument_ends, self._instrument = inserted, []
        if inserted is not None:
            caption = self.scene.text(CAPTION, LABEL).move(*(value * METRES for value in inserted[0]))
            self._instrument = [self._add_rod(2.0, INSTRUMENT, *inserted), caption]

    # Views

    @property
    def hidden(self) -> int:
        """Number of spheres that the arm hides from the tracker."""
        return self._sights.hidden

    def look_at(self, view_name: str, figures: CaseFigures | None) -> None:
        """Point the camera at the `robot` or `head`, along the `tracker`'s view, or along a trajectory."""
        path = (
            next((item for item in figures.trajectories if item.name == view_name), None) if figures else None
        )
        if path is not None:
            out = [e + 8.0 * (e - t) for e, t in zip(path.entry_mm, path.target_mm, strict=True)]
            self._camera(out, path.entry_mm)
        elif view_name == "head" and figures and figures.trajectories:
            x, y, z = figures.trajectories[0].target_mm
            self._camera((x + 350.0, y - 600.0, z + 450.0), (x, y, z))
        elif view_name == "tracker" and figures and figures.robot_from_tracker is not None:
            behind, ahead = figures.robot_from_tracker.apply([BEHIND_TRACKER_MM, AHEAD_MM]).tolist()
            self._camera(behind, ahead)
        else:
            self._camera((2000.0, -2300.0, 1500.0), (450.0, 0.0, 350.0))

    def _camera(self, place: Any, aim: Any) -> None:
        x, y, z = (value * METRES for value in place)
        a, b, c = (value * METRES for value in aim)
        self.scene.move_camera(x, y, z, a, b, c, duration=0.0)


def _instrument_ends(view: CaseView, figures: CaseFigures | None) -> tuple[Point, Point] | None:
    """Return the planned endpoints of the instrument at its target, or None without an instrument."""
    topic, _, name = (view.question.topic if view.question else "").partition(":")
    path = next((item for item in figures.trajectories if item.name == name), None) if figures else None
    if topic != AT_TARGET or path is None or view.pose is None:
        return None
    end = guide_end(view.pose.pose.bodies_mm[LINKS:], path.entry_mm, path.target_mm)
    return None if end is None else (end, path.target_mm)

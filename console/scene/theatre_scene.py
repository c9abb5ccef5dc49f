"""3-D scene of the theatre: arms, head, spheres, trajectories, lines of sight, clearance, and controls."""

from __future__ import annotations

from functools import partial
from typing import Any

from nicegui import ui

from console.panels.elements import card, group, html, small_button
from console.panels.html import tag, text
from console.scene.bodies import METRES, Closest, DrawnRod, Point, guide_end, placing_calls
from console.scene.drawn_arm import OLD_S, DrawnArm
from console.scene.scanned_skin import COVERED, MISSING, ScannedSkin, shown_scan
from console.scene.sights import HIDDEN, VOLUME, Sights
from procedures.engine.case_view import CaseView, ReportedPose
from procedures.engine.events import ArmsApart, Body
from procedures.planning.line_of_sight import SPHERE_RADIUS_MM
from procedures.reporting.case_figures import CaseFigures, SphereFigure
from procedures.reporting.sections.surface import MISSING_SKIN, SCANNED_SKIN
from ronna_hw.arrays import Array
from ronna_hw.frames import Transform

BACKGROUND = "#26333e"  # dark in both themes, so that bodies of every colour stand out
ARMS = ("#f08a24", "#b392f0")  # the arm with the guide, then others; further ones have the last
CT, TRACKER, STEREO = "#58a6ff", "#ffb020", "#42d392"
SKIN, PATH = "#d9b9a3", "#ff5fa2"
INSTRUMENT, CAPTION = "#e7f04c", "instrument, as planned"  # nothing measures it
POINT_MM = 2.0  # size of a scanned point
OUTSIDE = 2.5  # length of a trajectory drawn outside the entry, as a share of its depth
AT_TARGET = "at_target"  # topic of the question that stands while the instrument is at depth
BEHIND_TRACKER_MM, AHEAD_MM = (500.0, 0.0, 900.0), (0.0, 0.0, -1600.0)  # in the tracker frame
SKIN_VIEW = "skin"
PLACES = ("robot", "head", SKIN_VIEW, "tracker")
FRAMES_PER_S, LOW_FRAMES_PER_S = 20, 4
HEAD_OPACITY, LOW_OPACITY = 0.55, 1.0  # translucency is expensive without graphics hardware
LABEL = "color:#fff;background:rgba(0,0,0,.55);padding:0 4px;border-radius:3px;font:12px sans-serif"
MAGNIFICATIONS = {1: "as measured", 10: "differences × 10", 30: "differences × 30"}
SPHERES = ("spheres from the CT", CT)
KEY = (
    ("tracker", TRACKER),
    ("stereo head", STEREO),
    ("plan", PATH),
    (CAPTION, INSTRUMENT),
    ("hidden from the tracker", HIDDEN),
    ("measuring volume", VOLUME),
)


class ScenePanel:
    """Panel of the arms and their surroundings."""

    def __init__(self, *, low: bool) -> None:
        self._figures: CaseFigures | None = None
        with card("scenebox", "The theatre", heading=False):
            with ui.element("div").classes("sceneline"):
                self._views = group("views", "Views")
                self._size = ui.select(MAGNIFICATIONS, value=1, on_change=self._magnify)
                self._size.props('dense outlined options-dense aria-label="Differences between instruments"')
            self._age = html()
            self._scene = TheatreScene(low=low)
            self._key = html()
        self._names: tuple[str, ...] = ()
        self._scene.look_at("robot", None)

    def show(self, view: CaseView, figures: CaseFigures | None, heads: int) -> None:
        self._figures = figures
        self._scene.show(view, figures, heads)
        has_skin = self._scene.skin.camera is not None
        names = ("robot", "head", *((SKIN_VIEW,) if has_skin else ()), "tracker")
        names += tuple(path.name for path in figures.trajectories) if figures else ()
        if names != self._names:
            self._names = names
            self._build_views(names)
        has_spheres = figures is not None and any(one.ct_mm is not None for one in figures.spheres)
        self._key.set_content(_key_html(tuple(view.bodies), has_skin=has_skin, has_spheres=has_spheres))
        self._age.set_content(_ages_html(view) + self._clearance_html(view) + self._sight_html())

    def _build_views(self, names: tuple[str, ...]) -> None:
        self._views.clear()
        with self._views:
            for name in names:
                small_button(name if name in PLACES else f"along {name}", partial(self._look_at, name))

    def _look_at(self, name: str) -> None:
        self._scene.look_at(name, self._figures)

    def _clearance_html(self, view: CaseView) -> str:
        """Tell the closest pair of each arm, and the distance of each two arms."""
        lines = [
            (
                f"closest to {arm}" if len(view.bodies) > 1 else "closest",
                one.first,
                one.second,
                one.distance_mm,
            )
            for arm, one in self._scene.closest.items()
        ]
        lines += [("between the arms", *one.bodies, one.distance_mm) for one in _current_distances(view)]
        return "".join(
            tag("div", text(f"{what}: {distance_mm:.0f} mm, {first} and {second}"), class_="clearance")
            for what, first, second, distance_mm in lines
        )

    def _sight_html(self) -> str:
        hidden = self._scene.hidden
        if not hidden:
            return ""
        words = f"hidden from the tracker by an arm: {hidden} of the spheres (red lines)"
        return tag("div", words, class_="warn")

    def _magnify(self) -> None:
        self._scene.magnified = int(self._size.value or 1)


def _key_html(arms: tuple[str, ...], *, has_skin: bool, has_spheres: bool) -> str:
    names = [f"{arm} (as checked)" for arm in arms] or ["arm (as checked)"]
    shown_spheres = (SPHERES,) if has_spheres else ()
    entries = (*((name, _colour_of(number)) for number, name in enumerate(names)), *shown_spheres, *KEY)
    if has_skin:
        entries = ((f"skin: {SCANNED_SKIN}", COVERED), (f"skin: {MISSING_SKIN}", MISSING), *entries)
    shown = (tag("span", f'<i style="background:{colour}"></i>{text(words)}') for words, colour in entries)
    return tag("div", "".join(shown), class_="key")


def _ages_html(view: CaseView) -> str:
    if not view.poses:
        return tag("div", "No arm position yet: it comes with the connected devices.", class_="dim")
    return "".join(_age_html(arm, reported, view) for arm, reported in view.poses.items())


def _age_html(arm: str, reported: ReportedPose, view: CaseView) -> str:
    age_s, several = reported.age_s(view.theatre_time_s), len(view.poses) > 1
    whose = f"pose of {text(arm)}" if several else "pose"
    if arm not in view.bodies and several:
        return tag("div", f"{text(arm)} is not drawn: where it stands is not known yet", class_="dim")
    if view.outcome:  # nothing will make it newer, and its age would stand still
        return tag("div", f"{whose} as last read before the case was closed", class_="dim")
    if age_s > OLD_S:
        return tag("div", f"{whose.upper()} IS {age_s:.1f} s OLD, shown grey", class_="age warn num")
    return tag("div", f"{whose} is {age_s:.2f} s old", class_="age num")


def _current_distances(view: CaseView) -> list[ArmsApart]:
    """Return the distances between arms that are drawn, of which one has moved since they were placed."""
    return [one for one in view.apart.values() if all(arm in view.bodies for arm in one.arms)]


def _colour_of(number: int) -> str:
    """Return the colour of an arm, by its number in the theatre."""
    return ARMS[min(number, len(ARMS) - 1)]


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
        self._arms: dict[str, DrawnArm] = {}
        self._figures: object = None
        self._marks: list[Any] = []
        self._instrument_ends: tuple[Point, Point] | None = None
        self._instrument: list[Any] = []
        self._head: Any = None
        self._head_count = 0
        with self.scene:
            self._sights, self.skin = Sights(self.scene), ScannedSkin(self.scene)

    def show(self, view: CaseView, figures: CaseFigures | None, heads: int) -> None:
        """Show the case at one moment. `heads` counts rebuilds of the head's surface."""
        with self.scene:
            drawn: list[Body] = []
            for number, (arm, bodies) in enumerate(view.bodies.items()):
                if arm not in self._arms:
                    self._arms[arm] = DrawnArm(self.scene, _colour_of(number))
                self._arms[arm].show(bodies, view.poses.get(arm), view.theatre_time_s, drawn)
                drawn += bodies.fixed
            key = (figures, heads, self.magnified)
            if key != self._figures:
                self._figures = key
                self._build_marks(figures, heads)
            self._show_instrument(_instrument_ends(view, figures))
            self._sights.show(view, figures)
            self.skin.show(shown_scan(view, figures), None if figures is None else figures.robot_from_ct)

    @property
    def closest(self) -> dict[str, Closest]:
        """Closest checked pair of each arm that has one near."""
        return {arm: drawn.closest for arm, drawn in self._arms.items() if drawn.closest is not None}

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
        if figures.surface is not None and figures.surface.scan is not None:
            self._add_points(figures.surface.scan.scan.points_mm, STEREO)
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

    def _add_points(self, points_mm: Array, colour: str) -> None:
        rgb = [int(colour[place : place + 2], 16) / 255.0 for place in (1, 3, 5)]
        places = (points_mm * METRES).tolist()
        self._marks.append(self.scene.point_cloud(places, [rgb] * len(places), POINT_MM * METRES))

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
        """Point the camera at the `robot`, `head` or `skin`, along the `tracker`'s view, or a trajectory."""
        path = (
            next((item for item in figures.trajectories if item.name == view_name), None) if figures else None
        )
        if path is not None:
            out = [e + 8.0 * (e - t) for e, t in zip(path.entry_mm, path.target_mm, strict=True)]
            self._camera(out, path.entry_mm)
        elif view_name == SKIN_VIEW and self.skin.camera is not None:
            self._camera(*self.skin.camera)
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
    if topic != AT_TARGET or path is None:
        return None
    end = guide_end(view.tool_with_guide_mm, path.entry_mm, path.target_mm)
    return None if end is None else (end, path.target_mm)

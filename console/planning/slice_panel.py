"""Scrollable, clickable panel of a CT slice, with an overlay and draggable trajectory endpoints."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Sequence
from math import dist, hypot, sqrt
from typing import Any
from urllib.parse import urlencode

import numpy as np
from nicegui import ui
from numpy.typing import NDArray

from console.panels.elements import card, html
from console.panels.html import tag, text
from console.planning.draft import LANDMARKS, Draft, DraftTrajectory
from console.planning.fused_series import ShownSeries
from console.planning.slices import SIZE_PX, Cut, PageView, Plane
from console.planning.views import PlanView
from procedures.planning.line_of_sight import SPHERE_RADIUS_MM
from procedures.strategies.trajectory import Point

CROSS, SPHERE, CHOSEN, OTHER = "#35c8ff", "#ffa64d", "#ff5fa2", "#d8a6ff"
AVOIDED, MEASURED, LANDMARK = "#ff4d4d", "#ffe14d", "#7dffa0"
POINT_WITHIN_MM = 1.5  # from the image: points of a structure that are drawn in it
NEAR_MM = 3.0  # from the image: a closer end is drawn opaque, one farther off faint
GAP_PX = 12.0  # left free by the crosshair around its centre
HANDLE_PX = 12.0  # within which an end can be grasped
LEAST_SHARE = 0.35  # of a direction along an image's edge, to be labelled there
LETTERS = (("R", "L"), ("A", "P"), ("I", "S"))
WHEEL_S = 0.02  # host time between two steps of the wheel that are sent
KEYS = {"PageUp": -1, "PageDown": 1}
ARROWS = {"ArrowLeft": (-1, 0), "ArrowRight": (1, 0), "ArrowUp": (0, -1), "ArrowDown": (0, 1)}
FAST = 10  # pixels, with Shift
# Mouse moves are sent only while a button is held, keys only if they have a meaning here.
MOUSE_JS = "(e) => { if (e.mouse_event_type !== 'mousemove' || e.buttons) emit(e); }"
KEYS_JS = (
    "(e) => { if (/^(Page(Up|Down)|Arrow(Left|Right|Up|Down)|Enter|[-+=et])$/.test(e.key) && !e.ctrlKey)"
    " { e.preventDefault(); emit({key: e.key, shift: e.shiftKey}); } }"
)
# Name, and from where it is seen.
TITLES = {
    Plane.AXIAL: ("Axial", ", seen from the feet"),
    Plane.CORONAL: ("Coronal", ", from the front"),
    Plane.SAGITTAL: ("Sagittal", ", from the left"),
    Plane.ALONG: ("Along", " the trajectory"),
}
KEYBOARD_HELP = (
    "Arrow keys move the crosshair, Page Up and Page Down the slice, plus and minus magnify,"
    " Enter does what a click at the crosshair does, or enlarges a small picture,"
    " e and t set entry and target."
)
Place = Callable[[Point], Awaitable[None]]
Drag = Callable[[str, Point, bool], None]
STROKE = "stroke"  # what is dragged while a structure is drawn


class SlicePanel:
    """Panel of one slice.

    `act` gets the position of a click; `drag` the dragged end, its position, and whether the drag just began.
    """

    def __init__(
        self,
        plane: Plane,
        page_view: PageView,
        *,
        act: Place,
        drag: Drag,
        is_drawing: Callable[[], bool],
        key: Callable[[str], None],
        enlarge: Callable[[PlanView], None],
        on_view_change: Callable[[], None],
    ) -> None:
        self._plane, self._page_view = plane, page_view
        self._act, self._drag, self._is_drawing, self._key = act, drag, is_drawing, key
        self._enlarge, self._on_view_change = enlarge, on_view_change
        self._cut: Cut | None = None
        self._draft: Draft | None = None
        self._dragged_end = ""
        self._has_begun = False
        self._shown: tuple[str, str] = ("", "")
        title, aside = TITLES[plane]
        self.section = card("slice", f"{title}{aside}", heading=False)
        with self.section:
            with ui.element("div").classes("slicehead"):
                html(f"<h2>{title}{tag('span', aside, class_='aside')}</h2>")
                self._where = ui.label("").classes("num dim")
            self._image = (
                ui.interactive_image(
                    events=["mousedown", "mousemove", "mouseup", "mouseleave"], sanitize=False, size=(1, 1)
                )
                .classes("cut")
                .props(f'tabindex=0 role=img aria-label="{title}{aside}. {KEYBOARD_HELP}"')
                .props(f"data-plane={plane.value}")
            )
        self._image.on("mouse", self._on_mouse, js_handler=MOUSE_JS)
        self._image.on("wheel.prevent", self._on_wheel, args=["deltaY", "ctrlKey"], throttle=WHEEL_S)
        self._image.on("keydown", self._on_key, js_handler=KEYS_JS)

    def show(self, draft: Draft) -> None:
        page_view = self._page_view
        self._draft = draft
        way = draft.find_way(page_view.way)
        self._cut = cut = page_view.cut(self._plane, way)
        if cut is None:
            shown = "", ""
            self._where.set_text("set entry and target")
        else:
            shown = (
                _image_address(cut, page_view.window, page_view.series),
                draw_overlay(cut, draft, page_view.way, page_view.place_mm, page_view.measured_mm),
            )
            self._where.set_text(self._words(cut))
        if shown[0] != self._shown[0]:
            self._image.set_source(shown[0])
        if shown[1] != self._shown[1]:
            self._image.set_content(shown[1])
        self._shown = shown

    @property
    def _is_large(self) -> bool:
        return self._page_view.large == self._plane.value

    def _words(self, cut: Cut) -> str:
        page_view = self._page_view
        series = f"{page_view.series_words} · " if page_view.series_words else ""
        if self._plane is Plane.ALONG:
            return f"{series}turned {page_view.turn_deg:.0f}°"
        axis = int(abs(cut.normal).argmax())
        return f"{series}{'LPS'[axis]} {page_view.place_mm[axis]:.1f} mm"

    def _on_wheel(self, event: Any) -> None:
        delta = event.args.get("deltaY") or 0.0
        steps = (delta > 0) - (delta < 0)
        if event.args.get("ctrlKey"):
            self._page_view.magnify(-steps)
        else:
            self._page_view.scroll(self._plane, steps)
        self._on_view_change()

    async def _on_key(self, event: Any) -> None:
        key, shift = str(event.args.get("key")), bool(event.args.get("shift"))
        if key in KEYS:
            self._page_view.scroll(self._plane, KEYS[key] * (FAST if shift else 1))
        elif key in ARROWS:
            right, down = ARROWS[key]
            by = FAST if shift else 1
            if self._plane is Plane.ALONG:
                self._page_view.scroll(self._plane, right * by)
            self._page_view.move(self._plane, right * by, down * by)
        elif key in "+=-":
            self._page_view.magnify(-1 if key == "-" else 1)
        elif key == "Enter" and not self._is_large:
            self._enlarge(PlanView(self._plane.value))
        elif key == "Enter" and self._is_drawing():
            self._drag(STROKE, self._page_view.place_mm, True)
        elif key == "Enter":
            await self._act(self._page_view.place_mm)
        else:
            self._key(key)
        self._on_view_change()

    async def _on_mouse(self, event: Any) -> None:
        cut, draft, args = self._cut, self._draft, event.args
        if cut is None or draft is None:
            return
        kind, x, y = args.get("mouse_event_type"), float(args["image_x"]), float(args["image_y"])
        if kind == "mousedown" and not self._is_large:
            self._enlarge(PlanView(self._plane.value))
        elif kind == "mousedown" and args.get("button") == 0 and self._is_drawing():
            self._dragged_end = STROKE
            self._drag(STROKE, cut.to_patient_mm(x, y), True)
            self._has_begun = True
        elif kind == "mousedown" and args.get("button") == 0:
            way = draft.find_way(self._page_view.way)
            self._dragged_end = find_grasped_end(cut, way, x, y) if way is not None else ""
            self._has_begun = False
            if not self._dragged_end:
                await self._act(cut.to_patient_mm(x, y))
        elif kind == "mousemove" and self._dragged_end:
            self._drag(self._dragged_end, self._dragged_position_mm(cut, x, y), not self._has_begun)
            self._has_begun = True
        elif kind in ("mouseup", "mouseleave"):
            self._dragged_end = ""

    def _dragged_position_mm(self, cut: Cut, x: float, y: float) -> Point:
        """Return the new position of a dragged endpoint, keeping its depth behind the image."""
        if self._dragged_end == STROKE:
            return cut.to_patient_mm(x, y)
        assert self._draft is not None
        way = self._draft.way(self._page_view.way)
        place = way.entry_mm if self._dragged_end == "entry" else way.target_mm
        if place is None or self._plane is Plane.ALONG:
            return cut.to_patient_mm(x, y)
        _, _, off_mm = cut.to_picture(place)
        a, b, c = (p + off_mm * n for p, n in zip(cut.to_patient_mm(x, y), cut.normal.tolist(), strict=True))
        return a, b, c


def _image_address(cut: Cut, window: str, series: ShownSeries) -> str:
    def as_text(values: Any) -> str:
        return ",".join(f"{value:.5g}" for value in values)

    numbers = {
        "m": ",".join(f"{value:.3f}" for value in cut.middle_mm),
        "r": as_text(cut.right),
        "d": as_text(cut.down),
        "s": f"{cut.step_mm:.5f}",
        "w": window,
        "o": series.value,
    }
    return f"/cut.png?{urlencode(numbers)}"


def draw_overlay(
    cut: Cut, draft: Draft, chosen: str, place_mm: Point, measured_mm: Sequence[Point] = ()
) -> str:
    """Draw the overlay as SVG in the image's pixels."""
    parts = [*_draw_sides(cut), *_draw_cross(cut, place_mm)]
    parts += [_structure_path(cut, np.array(item.points_mm)) for item in draft.structures]
    for number, marker in enumerate(draft.markers, start=1):
        parts += _draw_sphere(cut, marker.centre_mm, f"{number}")
    for way in draft.ways:
        parts += _draw_trajectory(cut, way, CHOSEN if way.identifier == chosen else OTHER)
    for name, landmark in zip(LANDMARKS, draft.landmarks, strict=False):
        parts += _draw_point(cut, landmark, LANDMARK, name)
    parts += _draw_measured(cut, measured_mm)
    return "".join(parts)


def find_grasped_end(cut: Cut, way: DraftTrajectory, x_px: float, y_px: float) -> str:
    """Return which endpoint is at an image position: `entry`, `target`, or an empty string for neither."""
    best, name = HANDLE_PX, ""
    for end, place in (("target", way.target_mm), ("entry", way.entry_mm)):
        if place is not None:
            x, y, _ = cut.to_picture(place)
            if hypot(x - x_px, y - y_px) < best:
                best, name = hypot(x - x_px, y - y_px), end
    return name


def _draw_cross(cut: Cut, place_mm: Point) -> Iterable[str]:
    x, y, off_mm = cut.to_picture(place_mm)
    shade = 0.9 if abs(off_mm) < NEAR_MM else 0.35
    for x1, y1, x2, y2 in (
        (0.0, y, x - GAP_PX, y),
        (x + GAP_PX, y, SIZE_PX, y),
        (x, 0.0, x, y - GAP_PX),
        (x, y + GAP_PX, x, SIZE_PX),
    ):
        yield _draw_line(x1, y1, x2, y2, CROSS, 1.0, shade)


def _draw_sphere(cut: Cut, centre_mm: Sequence[float], name: str) -> Iterable[str]:
    x, y, off_mm = cut.to_picture(centre_mm)
    if abs(off_mm) >= SPHERE_RADIUS_MM:
        return
    radius = sqrt(SPHERE_RADIUS_MM**2 - off_mm**2) / cut.step_mm
    yield _draw_circle(x, y, radius, SPHERE, 1.6)
    yield _words(x + radius + 3, y + 4, name, SPHERE)


def _structure_path(cut: Cut, points_mm: NDArray[np.float64]) -> str:
    """Draw the points near the image as a single SVG path; a thousand elements would scroll too slowly."""
    away = points_mm - cut.middle_mm
    near = away[np.abs(away @ cut.normal) < POINT_WITHIN_MM]
    places = SIZE_PX / 2.0 + np.stack([near @ cut.right, near @ cut.down], axis=1) / cut.step_mm
    dots = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in places)
    return tag("path", "", d=dots, fill="none", stroke=AVOIDED, stroke_width="4", stroke_linecap="round")


def _draw_trajectory(cut: Cut, way: DraftTrajectory, colour: str) -> Iterable[str]:
    if way.ends is not None:
        (x1, y1, _), (x2, y2, _) = (cut.to_picture(end) for end in way.ends)
        yield _draw_line(x1, y1, x2, y2, colour, 1.6, 0.85)
    if way.entry_mm is not None:
        x, y, off_mm = cut.to_picture(way.entry_mm)
        shade = 1.0 if abs(off_mm) < NEAR_MM else 0.45
        yield (
            f'<rect x="{x - 5:.1f}" y="{y - 5:.1f}" width="10" height="10" fill="none" stroke="{colour}"'
            f' stroke-width="2" opacity="{shade}"/>'
        )
        yield _words(x + 8, y - 6, way.identifier, colour)
    if way.target_mm is not None:
        x, y, off_mm = cut.to_picture(way.target_mm)
        yield _draw_circle(x, y, 6.0, colour, 2.0, 1.0 if abs(off_mm) < NEAR_MM else 0.45)
        yield _draw_circle(x, y, 1.2, colour, 1.5)


def _draw_point(cut: Cut, place_mm: Point, colour: str, name: str = "") -> Iterable[str]:
    """Draw an upright cross at a point, faint if it is away from the image."""
    x, y, off_mm = cut.to_picture(place_mm)
    shade = 1.0 if abs(off_mm) < NEAR_MM else 0.35
    yield _draw_line(x - 6, y, x + 6, y, colour, 2.0, shade)
    yield _draw_line(x, y - 6, x, y + 6, colour, 2.0, shade)
    if name and shade == 1.0:
        yield _words(x + 9, y + 18, name, colour)


def _draw_measured(cut: Cut, ends_mm: Sequence[Point]) -> Iterable[str]:
    """Draw the ends of the measured distance, and the line between them with its length."""
    for end in ends_mm:
        yield from _draw_point(cut, end, MEASURED)
    if len(ends_mm) == 2:
        (x1, y1, _), (x2, y2, _) = (cut.to_picture(end) for end in ends_mm)
        yield _draw_line(x1, y1, x2, y2, MEASURED, 1.6, 0.9)
        yield _words((x1 + x2) / 2 + 8, (y1 + y2) / 2 - 8, f"{dist(*ends_mm):.1f} mm", MEASURED)


def _draw_sides(cut: Cut) -> Iterable[str]:
    half = SIZE_PX / 2.0
    for direction, x, y in (
        (cut.right, SIZE_PX - 8, half),
        (-cut.right, 8, half),
        (cut.down, half, SIZE_PX - 8),
        (-cut.down, half, 8),
    ):
        yield _words(x, y, side_letters(direction), "#f2f2f2", _side_class(x, y))


def _side_class(x: float, y: float) -> str:
    """Return the class of a side's letters, by which they stay inside the image at any size."""
    half = SIZE_PX / 2.0
    return "side " + ("atright" if x > half else "atleft" if x < half else "below" if y > half else "above")


def side_letters(direction: NDArray[np.float64]) -> str:
    """Return the anatomical letters for a direction, dominant side first."""
    order = sorted(range(3), key=lambda axis: -abs(direction[axis]))
    return "".join(
        LETTERS[axis][int(direction[axis] > 0)] for axis in order if abs(direction[axis]) > LEAST_SHARE
    )


def _draw_line(x1: float, y1: float, x2: float, y2: float, colour: str, width: float, shade: float) -> str:
    return (
        f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{colour}"'
        f' stroke-width="{width}" opacity="{shade}"/>'
    )


def _draw_circle(x: float, y: float, radius: float, colour: str, width: float, shade: float = 1.0) -> str:
    return (
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}" fill="none" stroke="{colour}"'
        f' stroke-width="{width}" opacity="{shade}"/>'
    )


def _words(x: float, y: float, words: str, colour: str, css: str = "name") -> str:
    return tag("text", text(words), x=f"{x:.1f}", y=f"{y:.1f}", fill=colour, class_=css)

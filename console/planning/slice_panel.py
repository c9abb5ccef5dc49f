"""One image through the CT: scrolled, clicked, with draggable trajectory ends."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any
from urllib.parse import urlencode

from nicegui import ui

from console.pictures.cuts import Cut, Plane
from console.planning.draft import Draft
from console.planning.look import Look
from console.planning.overlay import grasped, overlay
from procedures.strategies.trajectory import Point

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
TITLES = {
    Plane.AXIAL: "Axial, seen from the feet",
    Plane.CORONAL: "Coronal, from the front",
    Plane.SAGITTAL: "Sagittal, from the left",
    Plane.ALONG: "Along the trajectory",
}
HOW = (
    "Arrow keys move the crosshair, Page Up and Page Down the slice, plus and minus magnify,"
    " Enter does what a click at the crosshair does, e and t set entry and target."
)

Place = Callable[[Point], Awaitable[None]]
Drag = Callable[[str, Point, bool], None]
STROKE = "stroke"  # what is dragged while a structure is drawn


class SlicePanel:
    """`act` gets the position of a click; `drag` which end is dragged where, and whether it just began."""

    def __init__(
        self,
        plane: Plane,
        look: Look,
        *,
        act: Place,
        drag: Drag,
        draws: Callable[[], bool],
        key: Callable[[str], None],
        looked: Callable[[], None],
    ) -> None:
        self._plane, self._look = plane, look
        self._act, self._drag, self._draws, self._key, self._looked = act, drag, draws, key, looked
        self._cut: Cut | None = None
        self._draft: Draft | None = None
        self._dragged = ""
        self._begun = False
        self._shown: tuple[str, str] = ("", "")
        with ui.element("section").classes("card slice").props(f'aria-label="{TITLES[plane]}"'):
            with ui.element("div").classes("slicehead"):
                ui.html(f"<h2>{TITLES[plane]}</h2>", sanitize=False)
                self._where = ui.label("").classes("num dim")
            self._image = (
                ui.interactive_image(
                    events=["mousedown", "mousemove", "mouseup", "mouseleave"], sanitize=False, size=(1, 1)
                )
                .classes("cut")
                .props(f'tabindex=0 role=img aria-label="{TITLES[plane]}. {HOW}"')
                .props(f"data-plane={plane.value}")
            )
        self._image.on("mouse", self._mouse, js_handler=MOUSE_JS)
        self._image.on("wheel.prevent", self._wheel, args=["deltaY", "ctrlKey"], throttle=WHEEL_S)
        self._image.on("keydown", self._keyed, js_handler=KEYS_JS)

    def show(self, draft: Draft) -> None:
        """Show where the page looks."""
        look = self._look
        self._draft = draft
        way = next((one for one in draft.ways if one.identifier == look.way), None)
        self._cut = cut = look.cut(self._plane, way)
        if cut is None:
            shown = "", ""
            self._where.set_text("set entry and target")
        else:
            shown = _address(cut, look.window), overlay(cut, draft, look.way, look.place_mm)
            self._where.set_text(self._words(cut))
        if shown[0] != self._shown[0]:
            self._image.set_source(shown[0])
        if shown[1] != self._shown[1]:
            self._image.set_content(shown[1])
        self._shown = shown

    def _words(self, cut: Cut) -> str:
        if self._plane is Plane.ALONG:
            return f"turned {self._look.turn_deg:.0f}°"
        axis = int(abs(cut.normal).argmax())
        return f"{'LPS'[axis]} {self._look.place_mm[axis]:.1f} mm"

    def _wheel(self, event: Any) -> None:
        delta = event.args.get("deltaY") or 0.0
        steps = (delta > 0) - (delta < 0)
        if event.args.get("ctrlKey"):
            self._look.magnify(-steps)
        else:
            self._look.scroll(self._plane, steps)
        self._looked()

    async def _keyed(self, event: Any) -> None:
        key, shift = str(event.args.get("key")), bool(event.args.get("shift"))
        if key in KEYS:
            self._look.scroll(self._plane, KEYS[key] * (FAST if shift else 1))
        elif key in ARROWS:
            right, down = ARROWS[key]
            by = FAST if shift else 1
            if self._plane is Plane.ALONG:
                self._look.scroll(self._plane, right)
            self._look.move(self._plane, right * by, down * by)
        elif key in "+=-":
            self._look.magnify(-1 if key == "-" else 1)
        elif key == "Enter" and self._draws():
            self._drag(STROKE, self._look.place_mm, True)
        elif key == "Enter":
            await self._act(self._look.place_mm)
        else:
            self._key(key)
        self._looked()

    async def _mouse(self, event: Any) -> None:
        cut, draft, args = self._cut, self._draft, event.args
        if cut is None or draft is None:
            return
        kind, x, y = args.get("mouse_event_type"), float(args["image_x"]), float(args["image_y"])
        if kind == "mousedown" and args.get("button") == 0 and self._draws():
            self._dragged = STROKE
            self._drag(STROKE, cut.to_patient_mm(x, y), True)
            self._begun = True
        elif kind == "mousedown" and args.get("button") == 0:
            way = next((one for one in draft.ways if one.identifier == self._look.way), None)
            self._dragged = grasped(cut, way, x, y) if way is not None else ""
            self._begun = False
            if not self._dragged:
                await self._act(cut.to_patient_mm(x, y))
        elif kind == "mousemove" and self._dragged:
            self._drag(self._dragged, self._in_depth(cut, x, y), not self._begun)
            self._begun = True
        elif kind in ("mouseup", "mouseleave"):
            self._dragged = ""

    def _in_depth(self, cut: Cut, x: float, y: float) -> Point:
        """New position of the end: dragged within the image, at its previous depth behind it."""
        if self._dragged == STROKE:
            return cut.to_patient_mm(x, y)
        assert self._draft is not None
        way = self._draft.way(self._look.way)
        place = way.entry_mm if self._dragged == "entry" else way.target_mm
        if place is None or self._plane is Plane.ALONG:
            return cut.to_patient_mm(x, y)
        _, _, off_mm = cut.to_picture(place)
        a, b, c = (p + off_mm * n for p, n in zip(cut.to_patient_mm(x, y), cut.normal.tolist(), strict=True))
        return a, b, c


def _address(cut: Cut, window: str) -> str:
    def as_text(values: Any) -> str:
        return ",".join(f"{value:.5g}" for value in values)

    numbers = {
        "m": ",".join(f"{value:.3f}" for value in cut.middle_mm),
        "r": as_text(cut.right),
        "d": as_text(cut.down),
        "s": f"{cut.step_mm:.5f}",
        "w": window,
    }
    return f"/cut.png?{urlencode(numbers)}"

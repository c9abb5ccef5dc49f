"""Panel of coordinates: crosshair, entry and target in LPS and, once it is clicked, in the AC-PC frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from nicegui import ui

from console.panels.elements import card, group, html, small_button
from console.panels.html import head_row, table_of, tag, text
from console.planning.draft import LANDMARKS, Draft
from console.planning.fields import NumberField
from console.planning.plan_editor import PlanEditor
from console.planning.slices import PageView
from procedures.strategies.trajectory import Point

CLICK_NEXT = (
    "Click the centre of the anterior commissure (AC).",
    "Now the centre of the posterior commissure (PC).",
    "Now a point of the midline far above them, such as on the falx.",
)
AXES = ("x", "y", "z")
HEAD = head_row("mm", "L", "P", "S", "x right", "y front", "z up")
NO_FRAME = "No AC-PC frame yet: choose “AC–PC” above the pictures, then click three points."


class AcPcPanel:
    """Panel of the coordinates in both frames. Typed AC-PC coordinates move the crosshair."""

    def __init__(
        self, editor: PlanEditor, page_view: PageView, go: Callable[[Point], None], *, may_edit: bool
    ) -> None:
        self._editor, self._page_view, self._go, self._may_edit = editor, page_view, go, may_edit
        self._shown: object = None
        with card("acpc", "Coordinates"):
            self._table = html()
            self._frame = html()
            self._points = group("views", "AC-PC points")
            with group("numbers", "Go to AC-PC") as fields:
                ui.label("Go to").classes("rowname")
                self.fields = [
                    NumberField(axis, f"AC-PC {axis}", partial(self._go_along, number))
                    for number, axis in enumerate(AXES)
                ]
            self._typed = fields

    def show(self) -> None:
        draft = self._editor.draft
        frame = draft.ac_pc
        self._table.set_content(render_coordinates(draft, self._page_view.way, self._page_view.place_mm))
        words = NO_FRAME if frame is None else f"AC to PC {frame.length_mm:.1f} mm; origin halfway"
        self._frame.set_content(tag("p", text(words), class_="dim"))
        self._typed.set_visibility(frame is not None)
        if frame is not None:
            for field, value in zip(self.fields, frame.from_lps_mm(self._page_view.place_mm), strict=True):
                field.show(value)
        if draft.landmarks != self._shown:
            self._shown = draft.landmarks
            self._build_points(draft.landmarks)

    def _build_points(self, landmarks: Sequence[Point]) -> None:
        self._points.clear()
        with self._points:
            for name, place_mm in zip(LANDMARKS, landmarks, strict=False):
                small_button(name, partial(self._go, place_mm), f"crosshair to {name}")
            if landmarks and self._may_edit:
                small_button("remove", self._remove, "remove the AC-PC points")

    def _remove(self) -> None:
        self._editor.change(replace(self._editor.draft, landmarks=()))

    def _go_along(self, axis: int, value: float) -> None:
        frame = self._editor.draft.ac_pc
        if frame is not None:
            place = list(frame.from_lps_mm(self._page_view.place_mm))
            place[axis] = value
            self._go(frame.to_lps_mm(place))


def render_coordinates(draft: Draft, chosen: str, crosshair_mm: Point) -> str:
    """Build the table of crosshair, entry and target in both frames."""
    way = draft.find_way(chosen)
    places = [("crosshair", crosshair_mm)]
    if way is not None:
        places += [
            (f"{end} {chosen}", place)
            for end, place in (("entry", way.entry_mm), ("target", way.target_mm))
            if place is not None
        ]
    return table_of(HEAD, "".join(_row_html(draft, name, place) for name, place in places))


def _row_html(draft: Draft, name: str, place_mm: Point) -> str:
    frame = draft.ac_pc
    ac_pc = ["–"] * 3 if frame is None else [f"{value:.1f}" for value in frame.from_lps_mm(place_mm)]
    cells = [f"{value:.1f}" for value in place_mm] + ac_pc
    row = tag("th", text(name), scope="row") + "".join(tag("td", text(cell), class_="num") for cell in cells)
    return tag("tr", row, data_place=name.split()[0], data_acpc=" ".join(ac_pc))

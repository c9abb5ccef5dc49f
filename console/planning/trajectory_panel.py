"""Panel of the trajectories: the one edited, its ends as numbers, its axis as two angles and a depth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from nicegui import ui

from console.planning.draft import Axis, DraftTrajectory
from console.planning.fields import NumberField, small_button
from console.planning.plan_editor import PlanEditor
from console.planning.slices import PageView
from procedures.strategies.trajectory import Point

ENDS = (("entry", "Entry"), ("target", "Target"))


class TrajectoryPanel:
    """Panel of the trajectories, in LPS mm and degrees; each change is one undo step."""

    def __init__(
        self, editor: PlanEditor, look: PageView, looked: Callable[[], None], *, may_edit: bool
    ) -> None:
        self._editor, self._look, self._looked, self._may_edit = editor, look, looked, may_edit
        self._names: tuple[tuple[str, ...], str] = ((), "")
        self.fields: dict[str, NumberField] = {}
        with ui.element("section").classes("card ways").props('aria-label="Trajectories"'):
            ui.html("<h2>Trajectories</h2>", sanitize=False)
            self._tabs = ui.element("div").classes("views").props('role=group aria-label="Trajectories"')
            for end, title in ENDS:
                with ui.element("div").classes("numbers").props(f'role=group aria-label="{title}"'):
                    ui.label(title).classes("rowname")
                    for axis, letter in enumerate("LPS"):
                        self._field(f"{end} {letter}", letter, self._set_end(end, axis))
                with ui.element("div").classes("under"):
                    if self._may_edit:
                        self._button(
                            f"{title} here", partial(self._at_crosshair, end), f"{end} at the crosshair"
                        )
                    self._button("show", partial(self._go, end), f"crosshair to the {end}")
            with ui.element("div").classes("numbers").props('role=group aria-label="Axis"'):
                ui.label("Axis").classes("rowname")
                self._field("azimuth", "az. °", self._set_azimuth)
                self._field("elevation", "el. °", self._set_elevation)
                self._field("depth", "mm", self._set_depth)
            with ui.element("div").classes("numbers").props('role=group aria-label="Guide"'):
                ui.label("Guide").classes("rowname")
                self._field("free angle", "angle °", self._set_free_angle)
                self._field("margin", "margin mm", self._set_margin, 2)

    def show(self) -> None:
        """Show the current draft."""
        draft = self._editor.draft
        names = tuple(one.identifier for one in draft.ways)
        if self._look.way not in names:
            self._look.way = names[0]
        if (names, self._look.way) != self._names:
            self._names = names, self._look.way
            self._build_tabs(names)
        way = self._way
        for end, place in (("entry", way.entry_mm), ("target", way.target_mm)):
            for axis, letter in enumerate("LPS"):
                self.fields[f"{end} {letter}"].show(None if place is None else place[axis])
        axis_of = Axis.of(*way.ends) if way.ends else None
        self.fields["azimuth"].show(axis_of.azimuth_deg if axis_of else None)
        self.fields["elevation"].show(axis_of.elevation_deg if axis_of else None)
        self.fields["depth"].show(way.depth_mm)
        self.fields["free angle"].show(way.free_angle_deg)
        self.fields["margin"].show(way.margin_mm)

    def place(self, end: str, place_mm: Point, *, goes_on: bool = False) -> None:
        """Move an end of the current trajectory."""
        way = self._way
        way = replace(way, entry_mm=place_mm) if end == "entry" else replace(way, target_mm=place_mm)
        self._change(way, goes_on=goes_on)

    @property
    def _way(self) -> DraftTrajectory:
        return self._editor.draft.way(self._look.way)

    def _change(self, way: DraftTrajectory, *, goes_on: bool = False) -> None:
        if self._may_edit:
            self._editor.change(self._editor.draft.with_way(way.identifier, way), goes_on=goes_on)

    def _build_tabs(self, names: tuple[str, ...]) -> None:
        self._tabs.clear()
        with self._tabs:
            for name in names:
                chosen = name == self._look.way
                button = self._button(name, partial(self._choose, name), f"trajectory {name}")
                button.props(f"aria-pressed={'true' if chosen else 'false'}").classes(
                    "chosen" if chosen else ""
                )
            if self._may_edit:
                self._button("+", self._add, "add a trajectory")
                self._button("−", self._remove, "remove this trajectory")

    def _choose(self, name: str) -> None:
        self._look.way = name
        self._looked()

    def _add(self) -> None:
        draft, self._look.way = self._editor.draft.with_new_way()
        self._editor.change(draft)

    def _remove(self) -> None:
        self._editor.change(self._editor.draft.without_way(self._look.way))

    def _at_crosshair(self, end: str) -> None:
        self.place(end, self._look.place_mm)

    def _go(self, end: str) -> None:
        place = self._way.entry_mm if end == "entry" else self._way.target_mm
        if place is not None:
            self._look.go_to(place)
            self._looked()

    def _set_end(self, end: str, axis: int) -> Callable[[float], None]:
        def take(value: float) -> None:
            way = self._way
            place = list((way.entry_mm if end == "entry" else way.target_mm) or self._look.place_mm)
            place[axis] = value
            self.place(end, (place[0], place[1], place[2]))

        return take

    def _set_axis(self, change: Callable[[Axis], Axis], depth_mm: float | None = None) -> None:
        way = self._way
        if way.ends is None or way.target_mm is None or way.depth_mm is None:
            return
        axis = change(Axis.of(*way.ends))
        self.place("entry", axis.entry_mm(way.target_mm, depth_mm or way.depth_mm))

    def _set_azimuth(self, value: float) -> None:
        self._set_axis(lambda axis: replace(axis, azimuth_deg=value))

    def _set_elevation(self, value: float) -> None:
        self._set_axis(lambda axis: replace(axis, elevation_deg=value))

    def _set_depth(self, value: float) -> None:
        self._set_axis(lambda axis: axis, value)

    def _set_free_angle(self, value: float) -> None:
        self._change(replace(self._way, free_angle_deg=value))

    def _set_margin(self, value: float) -> None:
        self._change(replace(self._way, margin_mm=value))

    def _field(self, name: str, label: str, take: Callable[[float], None], decimals: int = 1) -> None:
        field = NumberField(label, name, take, decimals)
        field.enable(self._may_edit)
        self.fields[name] = field

    def _button(self, sign: str, act: Callable[[], None], name: str) -> ui.button:
        return small_button(sign, act, name).tooltip(name)

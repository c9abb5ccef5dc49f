"""Panel of the trajectories: the edited one, its endpoint coordinates, and its axis as angles and depth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from nicegui import ui

from console.panels.elements import card, group, small_button
from console.planning.draft import Axis, DraftTrajectory
from console.planning.fields import NumberField
from console.planning.fused_series import ShownSeries, name_series
from console.planning.plan_editor import PlanEditor
from console.planning.slices import PageView
from procedures.strategies.trajectory import Point

ENDS = (("entry", "Entry"), ("target", "Target"))


class TrajectoryPanel:
    """Panel of the trajectories, in LPS mm and degrees. Each change is one undo step."""

    def __init__(
        self, editor: PlanEditor, page_view: PageView, on_view_change: Callable[[], None], *, may_edit: bool
    ) -> None:
        self._editor, self._page_view, self._may_edit = editor, page_view, may_edit
        self._on_view_change = on_view_change
        self._names: tuple[tuple[str, ...], str] = ((), "")
        self.fields: dict[str, NumberField] = {}
        with card("ways", "Trajectories"):
            self._tabs = group("views", "Trajectories")
            for end, title in ENDS:
                with group("numbers", title):
                    ui.label(title).classes("rowname")
                    for axis, letter in enumerate("LPS"):
                        self._add_field(f"{end} {letter}", letter, self._set_end(end, axis))
                with ui.element("div").classes("under"):
                    if self._may_edit:
                        self._add_button(
                            f"{title} here", partial(self._set_at_crosshair, end), f"{end} at the crosshair"
                        )
                    self._add_button("show", partial(self._go, end), f"crosshair to the {end}")
            with ui.element("div").classes("under") as self._origin:
                self._origin_words = ui.label("").classes("warn")
                if self._may_edit:
                    self._add_button(
                        "Chosen in the CT",
                        lambda: self._set(fusion_error_mm=None),
                        "the target counts as chosen in the CT, without an error of the fusion",
                    )
            with group("numbers", "Axis"):
                ui.label("Axis").classes("rowname")
                self._add_field("azimuth", "az. °", lambda value: self._set_axis(azimuth_deg=value))
                self._add_field("elevation", "el. °", lambda value: self._set_axis(elevation_deg=value))
                self._add_field("depth", "mm", self._set_axis)
            with group("numbers", "Guide"):
                ui.label("Guide").classes("rowname")
                self._add_field("free angle", "angle °", lambda value: self._set(free_angle_deg=value))
                self._add_field("margin", "margin mm", lambda value: self._set(margin_mm=value), 2)

    def show(self) -> None:
        draft = self._editor.draft
        names = tuple(item.identifier for item in draft.ways)
        if self._page_view.way not in names:
            self._page_view.way = names[0]
        if (names, self._page_view.way) != self._names:
            self._names = names, self._page_view.way
            self._build_tabs(names)
        way = self._way
        self._show_origin(way)
        for end, place in (("entry", way.entry_mm), ("target", way.target_mm)):
            for axis, letter in enumerate("LPS"):
                self.fields[f"{end} {letter}"].show(None if place is None else place[axis])
        way_axis = Axis.of(*way.ends) if way.ends else None
        self.fields["azimuth"].show(way_axis.azimuth_deg if way_axis else None)
        self.fields["elevation"].show(way_axis.elevation_deg if way_axis else None)
        self.fields["depth"].show(way.depth_mm)
        self.fields["free angle"].show(way.free_angle_deg)
        self.fields["margin"].show(way.margin_mm)

    def _show_origin(self, way: DraftTrajectory) -> None:
        """Tell if the target was chosen in a fused series, and with which error."""
        self._origin.set_visibility(way.fusion_error_mm is not None)
        if way.fusion_error_mm is not None:
            name = name_series(self._editor.draft.fusion)
            self._origin_words.set_text(
                f"Target chosen in the {name}: fusion error {way.fusion_error_mm:.2f} mm"
            )

    def place(self, end: str, place_mm: Point, *, continues: bool = False) -> None:
        if not self._may_edit:
            return
        draft, way, fused = self._editor.draft, self._way, self._editor.fused
        is_other_shown = self._page_view.series is not ShownSeries.CT
        if end == "entry":
            draft = draft.with_way(way.identifier, replace(way, entry_mm=place_mm))
        # Moved in the CT, a target that was chosen in the other series stays marked, with the larger error,
        # until a person says that it was chosen in the CT.
        elif fused is not None and (is_other_shown or way.fusion_error_mm is not None):
            draft = fused.with_target(draft, way, place_mm)
        else:
            draft = draft.with_way(way.identifier, replace(way, target_mm=place_mm))
        self._editor.change(draft, continues=continues)

    @property
    def _way(self) -> DraftTrajectory:
        return self._editor.draft.way(self._page_view.way)

    def _change(self, way: DraftTrajectory) -> None:
        if self._may_edit:
            self._editor.change(self._editor.draft.with_way(way.identifier, way))

    def _build_tabs(self, names: tuple[str, ...]) -> None:
        self._tabs.clear()
        with self._tabs:
            for name in names:
                chosen = name == self._page_view.way
                button = self._add_button(name, partial(self._choose, name), f"trajectory {name}")
                button.props(f"aria-pressed={'true' if chosen else 'false'}").classes(
                    "chosen" if chosen else ""
                )
            if self._may_edit:
                self._add_button("+", self._add, "add a trajectory")
                self._add_button("−", self._remove, "remove this trajectory")

    def _choose(self, name: str) -> None:
        self._page_view.way = name
        self._on_view_change()

    def _add(self) -> None:
        draft, self._page_view.way = self._editor.draft.with_new_way()
        self._editor.change(draft)

    def _remove(self) -> None:
        self._editor.change(self._editor.draft.without_way(self._page_view.way))

    def _set_at_crosshair(self, end: str) -> None:
        self.place(end, self._page_view.place_mm)

    def _go(self, end: str) -> None:
        place = self._way.entry_mm if end == "entry" else self._way.target_mm
        if place is not None:
            self._page_view.go_to(place)
            self._on_view_change()

    def _set_end(self, end: str, axis: int) -> Callable[[float], None]:
        def set_value(value: float) -> None:
            way = self._way
            place = list((way.entry_mm if end == "entry" else way.target_mm) or self._page_view.place_mm)
            place[axis] = value
            self.place(end, (place[0], place[1], place[2]))

        return set_value

    def _set_axis(self, depth_mm: float | None = None, **angles_deg: float) -> None:
        way = self._way
        if way.ends is None or way.target_mm is None or way.depth_mm is None:
            return
        axis = replace(Axis.of(*way.ends), **angles_deg)
        self.place("entry", axis.entry_mm(way.target_mm, depth_mm or way.depth_mm))

    def _set(self, **values: Any) -> None:
        self._change(replace(self._way, **values))

    def _add_field(
        self, name: str, label: str, set_value: Callable[[float], None], decimals: int = 1
    ) -> None:
        field = NumberField(label, name, set_value, decimals)
        field.enable(self._may_edit)
        self.fields[name] = field

    def _add_button(self, sign: str, act: Callable[[], None], name: str) -> ui.button:
        return small_button(sign, act, name).tooltip(name)

"""The spheres that count as markers, rejected candidates with reasons, and the plan's remarks on them."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable
from dataclasses import replace
from functools import partial
from math import sqrt

from nicegui import ui

from console.panels.html import tag, text
from console.planning.desk import PlanDesk
from console.planning.fields import NumberField
from procedures.imaging import Candidate, Marker
from procedures.planning.plan_model import PatientPosition
from procedures.strategies.trajectory import Point

MOST_CANDIDATES = 12  # as many as a person will look at


class MarkerPanel:
    """Rebuilt when spheres or candidates change."""

    def __init__(
        self,
        desk: PlanDesk,
        go: Callable[[Point], None],
        pick: Callable[[Point], Awaitable[None]],
        *,
        may_edit: bool,
    ) -> None:
        self._desk, self._go, self._pick, self._may_edit = desk, go, pick, may_edit
        self._shown: object = None
        with ui.element("section").classes("card markers").props('aria-label="Markers"'):
            ui.html("<h2>Markers</h2>", sanitize=False)
            self._words = ui.html("", sanitize=False)
            self._list = ui.element("div").classes("rows")
            with (
                ui.element("div").classes("numbers wideones").props('role=group aria-label="On the patient"')
            ):
                self._implanted = NumberField("spheres implanted", "implanted", self._set_implanted, 0)
                self._standoff = NumberField("guide stand-off, mm", "stand-off", self._set_standoff)
                self._length = NumberField("instrument length, mm", "instrument length", self._set_length)
            self._position = ui.select(
                [one.value for one in PatientPosition], label="patient position", on_change=self._set_position
            )
            self._position.props('dense outlined options-dense aria-label="patient position in the scanner"')
            self._position.set_enabled(may_edit and not desk.volume.patient_position)
            self.fields = (self._implanted, self._standoff, self._length)
            for one in self.fields:
                one.enable(may_edit)

    def show(self) -> None:
        """Show the current draft."""
        desk, draft = self._desk, self._desk.draft
        self._implanted.show(draft.implanted)
        self._standoff.show(draft.standoff_mm)
        self._length.show(draft.instrument_length_mm)
        self._position.set_value(draft.patient_orientation or None)
        self._words.set_content(_state(desk))
        key = (tuple(map(id, draft.markers)), id(desk.candidates))
        if key != self._shown:
            self._shown = key
            self._list.clear()
            with self._list:
                self._build(draft.markers, desk.candidates)

    def _build(self, markers: Iterable[Marker], candidates: Iterable[Candidate]) -> None:
        for number, marker in enumerate(markers, start=1):
            sigma_mm = sqrt(float(marker.covariance_mm2.trace()))
            x, y, z = marker.centre_mm.tolist()
            about = ", ".join([f"σ {sigma_mm:.3f} mm", *marker.flags])
            with ui.element("div").classes("sphere").props(f'role=group aria-label="sphere {number}"'):
                self._place(f"{number}", (x, y, z), about)
                if self._may_edit:
                    self._button("reject", partial(self._desk.reject_marker, number), f"reject {number}")
        others = [one for one in candidates if not one.accepted][:MOST_CANDIDATES]
        if not others:
            return
        with ui.expansion("Other candidates").classes("others"):
            for number, one in enumerate(others, start=1):
                with ui.element("div").classes("sphere"):
                    self._place(f"c{number}", one.centre_mm, one.reason)
                    if self._may_edit:
                        self._button("accept", partial(self._pick, one.centre_mm), f"accept c{number}")

    def _place(self, name: str, centre_mm: Point, about: str) -> None:
        place = ", ".join(f"{value:.1f}" for value in centre_mm)
        self._button(name, lambda: self._go(centre_mm), f"crosshair to {name}")
        ui.html(
            tag("span", text(place), class_="num") + tag("div", text(about), class_="dim"), sanitize=False
        )

    def _button(self, words: str, act: Callable[[], object], name: str) -> None:
        ui.button(words, on_click=act, color=None).classes("plain small").props(
            f'no-caps unelevated aria-label="{name}"'
        )

    def _set_implanted(self, value: float) -> None:
        self._desk.change(replace(self._desk.draft, implanted=int(value)))

    def _set_position(self) -> None:
        position = str(self._position.value or "")
        if position != self._desk.draft.patient_orientation:
            self._desk.change(replace(self._desk.draft, patient_orientation=position))

    def _set_standoff(self, value: float) -> None:
        self._desk.change(replace(self._desk.draft, standoff_mm=value))

    def _set_length(self, value: float) -> None:
        self._desk.change(replace(self._desk.draft, instrument_length_mm=value))


def _state(desk: PlanDesk) -> str:
    if desk.searching:
        return tag("p", "searching for spheres…", class_="warn", id="searching")
    found = len(desk.draft.markers)
    return tag(
        "p", f"{found} spheres accepted as markers", class_="ok" if found else "bad", data_found=str(found)
    )

"""Marker panels: accepted spheres, rejected candidates with reasons, and proposed additional sites."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from nicegui import ui

from console.panels.elements import button, card, group, html, small_button
from console.panels.html import table, tag, text
from console.planning.draft import Draft
from console.planning.fields import NumberField
from console.planning.plan_editor import PlanEditor
from procedures.imaging import Candidate, Marker
from procedures.planning.head_in_ct import fit_head
from procedures.planning.marker_sites import propose_further, propose_markers
from procedures.planning.plan_model import PatientPosition
from procedures.registration.points import FEWEST_PAIRS
from procedures.strategies.trajectory import Point, Trajectory
from ronna_hw.errors import RonnaError

MOST_CANDIDATES = 12  # as many as a person will look at
MARKER_ERROR_MM = 0.1  # per marker, 3-D rms, as in `ronna-plan markers`
NOTE = f"expected with markers of {MARKER_ERROR_MM:g} mm each; the arm's error is not included"
COUNTS = (3, 4, 5, 6, 7, 8)
USUAL_COUNT = 5
SiteProposal = tuple[str, Sequence[Point]]  # in words, and where


class MarkerPanel:
    """Panel of the markers, rebuilt whenever spheres or candidates change."""

    def __init__(
        self,
        editor: PlanEditor,
        go: Callable[[Point], None],
        pick: Callable[[Point], Awaitable[None]],
        *,
        may_edit: bool,
    ) -> None:
        self._editor, self._go, self._pick, self._may_edit = editor, go, pick, may_edit
        self._shown: object = None
        with card("markers", "Markers"):
            self._words = html()
            self._list = ui.element("div").classes("rows")
            with group("numbers wideones", "On the patient"):
                self._implanted = NumberField("spheres implanted", "implanted", self._set_implanted, 0)
                self._standoff = NumberField("guide stand-off, mm", "stand-off", self._set_standoff)
                self._length = NumberField("instrument length, mm", "instrument length", self._set_length)
            self._position = ui.select(
                [item.value for item in PatientPosition],
                label="patient position",
                on_change=self._set_position,
            )
            self._position.props('dense outlined options-dense aria-label="patient position in the scanner"')
            self._position.set_enabled(may_edit and not editor.volume.patient_position)
            self.fields = (self._implanted, self._standoff, self._length)
            for item in self.fields:
                item.enable(may_edit)

    def show(self) -> None:
        editor, draft = self._editor, self._editor.draft
        self._implanted.show(draft.implanted)
        self._standoff.show(draft.standoff_mm)
        self._length.show(draft.instrument_length_mm)
        self._position.set_value(draft.patient_orientation or None)
        self._words.set_content(_search_state(editor))
        key = (tuple(map(id, draft.markers)), id(editor.candidates))
        if key != self._shown:
            self._shown = key
            self._list.clear()
            with self._list:
                self._build(draft.markers, editor.candidates)

    def _build(self, markers: Iterable[Marker], candidates: Iterable[Candidate]) -> None:
        for number, marker in enumerate(markers, start=1):
            details = ", ".join([f"σ {marker.sigma_mm:.3f} mm", *marker.flags])
            with group("sphere", f"sphere {number}"):
                self._add_place(f"{number}", marker.centre_mm, details)
                if self._may_edit:
                    small_button("reject", partial(self._editor.reject_marker, number), f"reject {number}")
        others = [item for item in candidates if not item.accepted][:MOST_CANDIDATES]
        if not others:
            return
        with ui.expansion("Other candidates").classes("others"):
            for number, item in enumerate(others, start=1):
                with ui.element("div").classes("sphere"):
                    self._add_place(f"c{number}", item.centre_mm, item.reason)
                    if self._may_edit:
                        small_button("accept", partial(self._pick, item.centre_mm), f"accept c{number}")

    def _add_place(self, name: str, centre_mm: Point, details: str) -> None:
        place = ", ".join(f"{value:.1f}" for value in centre_mm)
        small_button(name, lambda: self._go(centre_mm), f"crosshair to {name}")
        html(tag("span", text(place), class_="num") + tag("div", text(details), class_="dim"))

    def _set_implanted(self, value: float) -> None:
        self._editor.change(replace(self._editor.draft, implanted=int(value)))

    def _set_position(self) -> None:
        position = str(self._position.value or "")
        if position != self._editor.draft.patient_orientation:
            self._editor.change(replace(self._editor.draft, patient_orientation=position))

    def _set_standoff(self, value: float) -> None:
        self._editor.change(replace(self._editor.draft, standoff_mm=value))

    def _set_length(self, value: float) -> None:
        self._editor.change(replace(self._editor.draft, instrument_length_mm=value))


class ProposalPanel:
    """Panel that proposes a marker set like `ronna-plan markers`, or one more besides accepted spheres."""

    def __init__(self, editor: PlanEditor, go: Callable[[Point], None]) -> None:
        self._editor, self._go = editor, go
        with card("proposal", "Proposed marker sites"):
            with ui.element("div").classes("numbers"):
                self._count = ui.select(list(COUNTS), value=USUAL_COUNT)
                self._count.props('dense outlined options-dense aria-label="number of markers"')
                self._buttons = (
                    button("Propose", partial(self._propose, self._propose_set), "propose"),
                    button("One more", partial(self._propose, self._propose_one_more), "further"),
                )
            self._words = html()
            self._sites = ui.element("div").classes("views")

    async def _propose(self, work: Callable[[Draft, list[Trajectory], int], SiteProposal]) -> None:
        draft, count = self._editor.draft, int(self._count.value or USUAL_COUNT)
        ways = [Trajectory(item.identifier, *item.ends) for item in draft.ways if item.ends and item.depth_mm]
        self._sites.clear()
        if not ways:
            self._words.set_content(tag("p", "Set entry and target first.", class_="dim"))
            return
        self._enable(enabled=False)
        try:
            words, centres_mm = await asyncio.to_thread(work, draft, ways, count)
        except RonnaError as refused:
            self._words.set_content(tag("p", text(f"{refused.code}: {refused.summary}"), class_="bad"))
        else:
            self._words.set_content(tag("div", words, data_proposed=str(len(centres_mm))))
            self._show_sites(centres_mm)
        finally:
            self._enable(enabled=True)

    def _enable(self, *, enabled: bool) -> None:
        for item in self._buttons:
            item.set_enabled(enabled)

    def _propose_set(self, _draft: Draft, ways: list[Trajectory], count: int) -> SiteProposal:
        volume = self._editor.volume
        found = propose_markers(fit_head(volume), ways, count, MARKER_ERROR_MM, volume=volume)
        rows = [(item.target, f"{item.expected_mm:.3f}", f"{item.usual_mm:.3f}") for item in found.targets]
        return table(("target", "proposed mm", "random mm"), rows, NOTE), found.centres_mm

    def _propose_one_more(self, draft: Draft, ways: list[Trajectory], _count: int) -> SiteProposal:
        if len(draft.markers) < FEWEST_PAIRS:
            return tag("p", "Needs three accepted spheres.", class_="dim"), ()
        volume = self._editor.volume
        present_mm = np.array([item.centre_mm for item in draft.markers])
        found = propose_further(fit_head(volume), ways, present_mm, MARKER_ERROR_MM, volume=volume)
        rows = [(name, f"{now:.3f}", f"{after:.3f}") for name, now, after in found.targets]
        return table(("target", "now mm", "with it mm"), rows, NOTE), (found.centre_mm,)

    def _show_sites(self, centres_mm: Sequence[Point]) -> None:
        with self._sites:
            for number, centre_mm in enumerate(centres_mm, start=1):
                place = ", ".join(f"{value:.0f}" for value in centre_mm)
                small_button(place, partial(self._go, centre_mm), f"site {number}")


def _search_state(editor: PlanEditor) -> str:
    if editor.searching:
        return tag("p", "searching for spheres…", class_="warn", id="searching")
    found = len(editor.draft.markers)
    return tag(
        "p", f"{found} spheres accepted as markers", class_="ok" if found else "bad", data_found=str(found)
    )

"""Proposes where further markers would help the targets: on request, shown, never adopted automatically."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial

from nicegui import ui

from console.panels.html import table, tag, text
from console.planning.desk import PlanDesk
from console.planning.draft import Draft
from procedures.planning.head.shape import head_shape
from procedures.planning.markers.sites import ProposedMarkers, propose_markers
from procedures.strategies.trajectory import Point, Trajectory
from ronna_hw.errors import RonnaError

MARKER_ERROR_MM = 0.1  # per marker, 3-D rms, as in `ronna-plan markers`
COUNTS = (3, 4, 5, 6, 7, 8)
USUAL_COUNT = 5


class ProposalPanel:
    """As proposed by `ronna-plan markers`; useful before the markers are implanted."""

    def __init__(self, desk: PlanDesk, go: Callable[[Point], None]) -> None:
        self._desk, self._go = desk, go
        with ui.element("section").classes("card proposal").props('aria-label="Proposed marker sites"'):
            ui.html("<h2>Proposed marker sites</h2>", sanitize=False)
            with ui.element("div").classes("numbers"):
                self._count = ui.select(list(COUNTS), value=USUAL_COUNT)
                self._count.props('dense outlined options-dense aria-label="number of markers"')
                self._ask = ui.button("Propose", on_click=self._propose, color=None)
                self._ask.classes("plain").props("no-caps unelevated data-do=propose")
            self._words = ui.html("", sanitize=False)
            self._sites = ui.element("div").classes("views")

    async def _propose(self) -> None:
        draft, count = self._desk.draft, int(self._count.value or USUAL_COUNT)
        self._ask.set_enabled(False)
        self._sites.clear()
        try:
            found = await asyncio.to_thread(self._found, draft, count)
        except RonnaError as refused:
            self._words.set_content(tag("p", text(f"{refused.code}: {refused.summary}"), class_="bad"))
        else:
            self._show(found)
        finally:
            self._ask.set_enabled(True)

    def _found(self, draft: Draft, count: int) -> ProposedMarkers | None:
        ways = [Trajectory(one.identifier, *one.ends) for one in draft.ways if one.ends and one.depth_mm]
        if not ways:
            return None
        volume = self._desk.volume
        return propose_markers(head_shape(volume), ways, count, MARKER_ERROR_MM, volume=volume)

    def _show(self, found: ProposedMarkers | None) -> None:
        if found is None:
            self._words.set_content(tag("p", "Set entry and target first.", class_="dim"))
            return
        rows = [(one.target, f"{one.expected_mm:.3f}", f"{one.usual_mm:.3f}") for one in found.targets]
        note = f"expected with markers of {found.marker_error_mm:g} mm each; the arm's error is not included"
        head = ("target", "proposed mm", "random mm")
        self._words.set_content(tag("div", table(head, rows, note), data_proposed=str(len(found.markers))))
        with self._sites:
            for number, centre_mm in enumerate(found.centres_mm, start=1):
                place = ", ".join(f"{value:.0f}" for value in centre_mm)
                button = ui.button(f"{place}", on_click=partial(self._go, centre_mm), color=None)
                button.classes("plain small").props(f'no-caps unelevated aria-label="site {number}"')

"""Proposes where further markers would help the targets: on request, shown, never adopted automatically."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from nicegui import ui

from console.panels.html import table, tag, text
from console.planning.desk import PlanDesk
from console.planning.draft import Draft
from procedures.planning.head_in_ct import head_shape
from procedures.planning.marker_sites import propose_further, propose_markers
from procedures.registration.points import FEWEST_PAIRS
from procedures.strategies.trajectory import Point, Trajectory
from ronna_hw.errors import RonnaError

MARKER_ERROR_MM = 0.1  # per marker, 3-D rms, as in `ronna-plan markers`
NOTE = f"expected with markers of {MARKER_ERROR_MM:g} mm each; the arm's error is not included"
COUNTS = (3, 4, 5, 6, 7, 8)
USUAL_COUNT = 5
Found = tuple[str, Sequence[Point]]  # in words, and where


class ProposalPanel:
    """A set as proposed by `ronna-plan markers`, or one more besides the accepted spheres."""

    def __init__(self, desk: PlanDesk, go: Callable[[Point], None]) -> None:
        self._desk, self._go = desk, go
        with ui.element("section").classes("card proposal").props('aria-label="Proposed marker sites"'):
            ui.html("<h2>Proposed marker sites</h2>", sanitize=False)
            with ui.element("div").classes("numbers"):
                self._count = ui.select(list(COUNTS), value=USUAL_COUNT)
                self._count.props('dense outlined options-dense aria-label="number of markers"')
                self._buttons = (
                    self._button("Propose", self._proposed, "propose"),
                    self._button("One more", self._further, "further"),
                )
            self._words = ui.html("", sanitize=False)
            self._sites = ui.element("div").classes("views")

    def _button(
        self, words: str, work: Callable[[Draft, list[Trajectory], int], Found], name: str
    ) -> ui.button:
        button = ui.button(words, on_click=partial(self._propose, work), color=None)
        return button.classes("plain").props(f"no-caps unelevated data-do={name}")

    async def _propose(self, work: Callable[[Draft, list[Trajectory], int], Found]) -> None:
        draft, count = self._desk.draft, int(self._count.value or USUAL_COUNT)
        ways = [Trajectory(one.identifier, *one.ends) for one in draft.ways if one.ends and one.depth_mm]
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
            self._show(centres_mm)
        finally:
            self._enable(enabled=True)

    def _enable(self, *, enabled: bool) -> None:
        for button in self._buttons:
            button.set_enabled(enabled)

    def _proposed(self, _draft: Draft, ways: list[Trajectory], count: int) -> Found:
        volume = self._desk.volume
        found = propose_markers(head_shape(volume), ways, count, MARKER_ERROR_MM, volume=volume)
        rows = [(one.target, f"{one.expected_mm:.3f}", f"{one.usual_mm:.3f}") for one in found.targets]
        return table(("target", "proposed mm", "random mm"), rows, NOTE), found.centres_mm

    def _further(self, draft: Draft, ways: list[Trajectory], _count: int) -> Found:
        if len(draft.markers) < FEWEST_PAIRS:
            return tag("p", "Needs three accepted spheres.", class_="dim"), ()
        volume = self._desk.volume
        present_mm = np.array([one.centre_mm for one in draft.markers])
        found = propose_further(head_shape(volume), ways, present_mm, MARKER_ERROR_MM, volume=volume)
        rows = [(name, f"{now:.3f}", f"{after:.3f}") for name, now, after in found.targets]
        return table(("target", "now mm", "with it mm"), rows, NOTE), (found.centre_mm,)

    def _show(self, centres_mm: Sequence[Point]) -> None:
        with self._sites:
            for number, centre_mm in enumerate(centres_mm, start=1):
                place = ", ".join(f"{value:.0f}" for value in centre_mm)
                button = ui.button(f"{place}", on_click=partial(self._go, centre_mm), color=None)
                button.classes("plain small").props(f'no-caps unelevated aria-label="site {number}"')

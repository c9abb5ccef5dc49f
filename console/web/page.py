"""Case page: its panels, their content, and the update loop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

from fastapi import FastAPI, Request
from nicegui import ui

from console.changes import await_change
from console.figures import LatestFigures, figures_at
from console.guard import LOW, SESSION, Session, SessionRole
from console.hub import NO_REPLY, Hub
from console.panels.case_state import (
    advice,
    banner,
    case_line,
    chart,
    chart_key,
    clock,
    devices,
    devices_key,
    mode,
)
from console.panels.elements import card, html
from console.panels.html import tag, text
from console.panels.orders import OrderPanel, QuestionPanel, SeatPanel, add_stop_button
from console.panels.results import (
    LogTail,
    accuracy,
    accuracy_key,
    course,
    cuts,
    cuts_key,
    journal,
    live_key,
    live_pair,
    log,
    notices,
    pictures,
    problems,
)
from console.panels.skin_scan import skin_scan
from console.recorded_case import RecordedCase
from console.scene.scanned_skin import shown_scan
from console.scene.theatre_scene import ScenePanel
from console.web.library import bind_page, page_head, use_library
from procedures.engine.case_view import CaseView
from procedures.reporting.case_figures import CaseFigures
from procedures.runs.orders import explain_invalid_order

TITLE = "RONNA console"  # the same for every case: titles are visible in window lists
OPERATOR_PERIOD_S = 0.05  # host time between two updates of a page
VIEWER_PERIOD_S = 0.1
GATHERING_S = 0.004  # host time: simultaneous events are shown together
BEAT_S = 0.4  # host time between two updates when nothing happens: ages grow
SLOW_KEYS_S = 0.5  # host time between two updates of what a person reads as numbers


def add_page(app: FastAPI, hub: Hub) -> None:
    """Serve the page at `/` of an application."""
    figures = LatestFigures(hub)
    figures.add_routes(app)
    tail = LogTail(hub.folder)
    head = page_head()

    @ui.page("/")
    async def page(request: Request) -> None:
        ui.add_head_html(head)
        session: Session = request.scope[SESSION]
        bind_page(ui.context.client, session.identifier)
        CasePage(hub, figures, tail, session, low=LOW in request.query_params).build()

    use_library(app, TITLE)


class CasePage:
    """Case page open in one session."""

    def __init__(
        self, hub: Hub, figures: LatestFigures, tail: LogTail, session: Session, *, low: bool
    ) -> None:
        self._hub = hub
        self._figures = figures
        self._tail = tail
        self._session = session
        self._low = low
        self._panels: list[
            tuple[ui.html, Callable[[CaseView], str], Callable[[CaseView], object], list[object]]
        ] = []
        self._beat = 0
        self._slow = 0
        self._figures_key: object = None
        self._shown_figures: CaseFigures | None = None

    @property
    def _is_mine(self) -> bool:
        return self._hub.seated_session == self._session.identifier and self._hub.view.seat is not None

    def build(self) -> None:
        """Create the panels and start updating them."""
        may_operate = self._session.role is SessionRole.OPERATOR and self._hub.review is None
        with ui.element("header").classes("head"):
            with ui.element("div").classes("headrow"):
                self._add(banner, lambda view: view.banner)
                self._stop = add_stop_button(self._give_order) if may_operate else None
            with ui.element("div").classes("headmore"):
                self._add(
                    case_line,
                    lambda view: (view.run, view.theatre, view.strategy, view.methods, view.outcome),
                )
                self._add(mode, lambda view: view.mode)
                self._clock = html()
                self._seat = SeatPanel(self._give_order, may_operate=may_operate)
        self._frozen = html().classes("frozenbox")
        html('<div id="lost" role="alert" hidden></div>')
        if self._hub.review is not None:
            self._add(lambda _view: problems(self._shown_figures), self._update_figures).classes("words")
        self._words = html().classes("words")
        self._moment = None if self._hub.review is None else MomentPanel(self._hub.review, self._hub.notify)
        self._orders: OrderPanel | None = None
        with ui.element("main").classes("places case-places"):
            with ui.element("div").classes("ask"):
                self._question = QuestionPanel(self._get_reply, self._show_message)
                self._advice = html()
            with ui.element("div").classes("left"):
                if may_operate:
                    self._orders = OrderPanel(self._give_order, self._show_message)
                self._section("Progress", chart, chart_key, "chart")
            with ui.element("div").classes("middle"):
                self._scene = ScenePanel(low=self._low)
                self._section(
                    "Trajectories in the CT",
                    lambda view: cuts(view, self._shown_figures),
                    lambda view: (self._update_figures(view), cuts_key(view)),
                    "cutbox",
                )
            with ui.element("div").classes("right"):
                self._section(
                    "Scan of the skin",
                    lambda view: skin_scan(
                        shown_scan(view, self._shown_figures), self._figures.skin, self._margins_mm
                    ),
                    lambda view: (self._update_figures(view), view.scan, self._figures.heads),
                    "skinbox",
                )
                self._section(
                    "Accuracy",
                    lambda view: accuracy(view, self._shown_figures),
                    lambda view: (self._update_figures(view), accuracy_key(view)),
                    "accuracy",
                )
                self._section("Faults, refusals, notes", notices, lambda view: view.notices, "noticebox")
                self._section(
                    "Stereo pictures",
                    lambda _view: pictures(self._shown_figures),
                    self._update_figures,
                    "picturebox",
                    live=lambda: live_pair(self._hub),
                )
            with ui.element("div").classes("bottom"):
                self._section("Devices", devices, lambda view: (self._slow, devices_key(view)), "devicebox")
                self._section(
                    "Timeline", lambda _view: course(self._shown_figures), self._update_figures, "coursebox"
                )
                lines = self._tail.lines
                self._section("Journal", journal, lambda view: view.journal, "journalbox")
                self._section("Log", lambda _view: log(lines()), lambda _view: lines(), "logbox")
        view = self._view()  # with the page itself, not only once its socket is open
        self._show_case(view)
        self._show_scene(view)  # drawn as soon as there is something to draw on
        client = ui.context.client
        ui.on("alive", self._on_alive)
        changed = self._hub.subscribe()
        client.on_connect(changed.set)  # what has changed since is not left until the next beat
        task = asyncio.create_task(self._keep_fresh(client, changed))

        def forget_page() -> None:
            self._hub.unsubscribe(changed)
            task.cancel()

        client.on_delete(forget_page)

    def _add(self, render: Callable[[CaseView], str], key: Callable[[CaseView], object]) -> ui.html:
        place = html()
        self._panels.append((place, render, key, [object()]))
        return place

    def _section(
        self,
        title: str,
        render: Callable[[CaseView], str],
        key: Callable[[CaseView], object],
        name: str,
        live: Callable[[], str] | None = None,
    ) -> None:
        with card(name, title):
            if live is not None and self._hub.review is None:
                self._add(lambda _view: live(), lambda _view: live_key(self._hub))
            self._add(render, key).classes("body")

    def _update_figures(self, view: CaseView) -> object:
        """Update the figures known at the displayed moment, and return a key that changes with them."""
        key = self._figures.key(), view.steps, self._hub.view.steps
        if key != self._figures_key:
            self._figures_key = key
            self._shown_figures = figures_at(self._figures.latest, view, self._hub.view)
        return key

    @property
    def _margins_mm(self) -> Mapping[str, float]:
        return {} if self._shown_figures is None else self._shown_figures.margins_mm

    async def _give_order(self, order: dict[str, Any]) -> None:
        """Give an order and show the engine's reply."""
        self._show_message(await self._get_reply(order))

    async def _get_reply(self, order: dict[str, Any]) -> str:
        """Give an order and return the engine's refusal in words, or an empty string."""
        try:
            refusal = await self._hub.order(self._session, order)
        except ValueError:
            refusal = explain_invalid_order(order)
        words = refusal if refusal == NO_REPLY else f"Refused: {refusal}"
        return f"{words}." if refusal else ""

    def _show_message(self, words: str) -> None:
        self._words.set_content(tag("div", text(words), class_="said", role="alert") if words else "")

    async def _on_alive(self) -> None:
        if (
            self._hub.seated_session == self._session.identifier
        ):  # even before the engine's first event says so
            await self._hub.order(self._session, {"kind": "renew"})

    async def _keep_fresh(self, client: Any, changed: asyncio.Event) -> None:
        """Show facts immediately, and signals at the page's refresh rate."""
        loop = asyncio.get_running_loop()
        while True:
            if client.has_socket_connection:
                with client:
                    self._show(loop.time())
            fact, next_s = self._hub.view.fact, loop.time() + self._period_s
            await await_change(changed, BEAT_S)
            await asyncio.sleep(GATHERING_S)
            while self._hub.view.fact == fact and (remaining_s := next_s - loop.time()) > 0.0:
                await await_change(changed, remaining_s)

    @property
    def _period_s(self) -> float:
        return OPERATOR_PERIOD_S if self._is_mine else VIEWER_PERIOD_S

    def _view(self) -> CaseView:
        latest = self._hub.aged_view
        return self._hub.told(latest if self._moment is None else self._moment.view(latest))

    def _show(self, now_s: float) -> None:
        view = self._view()
        self._slow = int(now_s / SLOW_KEYS_S)
        self._show_case(view)
        self._show_scene(view)
        self._beat += 1
        self._clock.set_content(clock(view, self._beat))

    def _show_scene(self, view: CaseView) -> None:
        self._scene.show(view, self._shown_figures, self._figures.heads)

    def _show_case(self, view: CaseView) -> None:
        """Show all but the scene, and the beat, which needs an open page."""
        for place, render, key, shown in self._panels:
            current = key(view)
            if current != shown[0]:
                shown[0] = current
                place.set_content(render(view))
        is_latest = view.number == self._hub.view.number
        mine, frozen = self._is_mine, self._hub.frozen if is_latest else ""  # a past moment stands still
        self._question.show(view, is_mine=mine and not frozen, has_seat=view.seat is not None)
        may_order = self._hub.live and not frozen and not self._hub.view.outcome
        self._seat.show(view, is_mine=mine, orders=may_order)
        if self._stop is not None:
            self._stop.set_enabled(not self._hub.view.outcome)  # else also where orders are refused
        may_answer = self._orders is not None and not frozen
        self._advice.set_content(advice(view, is_mine=mine, may_operate=may_answer) if not frozen else "")
        if self._orders is not None:
            self._orders.show(view, is_mine=mine and not frozen)
        self._update_figures(view)
        self._frozen.set_content(f'<div class="frozen" role="alert">{text(frozen)}</div>' if frozen else "")


class MomentPanel:
    """Slider through a recorded case. At the end position it follows new events."""

    def __init__(self, recorded: RecordedCase, changed: Callable[[], None]) -> None:
        self._recorded = recorded
        self._changed = changed
        with ui.element("section").classes("moment card").props('aria-label="Playback position"'):
            self._back = self._button("◀", -1, "previous event")
            self._slider = ui.slider(min=0, max=len(recorded), value=len(recorded), step=1)
            self._slider.on_value_change(self._on_move).props('aria-label="Playback position"').classes(
                "slide"
            )
            self._forward = self._button("▶", +1, "next event")
            self._text = ui.label("").classes("num")

    def view(self, latest: CaseView) -> CaseView:
        """Return the view at the selected moment."""
        count, chosen = len(self._recorded), int(self._slider.value)
        if self._slider.props["max"] != count:
            is_at_end = chosen >= self._slider.props["max"]
            self._slider.props(f"max={count}")
            self._slider.props["max"] = count
            if is_at_end:
                self._slider.set_value(count)
                chosen = count
        status_text = "" if self._recorded.is_over else ", running"
        self._text.set_text(f"{self._recorded.time_s(chosen):.1f} s, event {chosen} of {count}{status_text}")
        return latest if chosen >= count else self._recorded.at(chosen)

    def _button(self, sign: str, by: int, name: str) -> ui.button:
        def move() -> None:
            self._slider.set_value(min(max(int(self._slider.value) + by, 0), len(self._recorded)))

        return (
            ui.button(sign, on_click=move, color=None)
            .classes("plain")
            .props(f'unelevated aria-label="{name}"')
        )

    def _on_move(self) -> None:
        self._changed()

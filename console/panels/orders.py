"""The operator's buttons, and the seat. A button only sends a request: the engine decides."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from nicegui import ui

from console.feed.view import CaseView
from console.panels.bar import seat_line
from console.panels.question import Give, HeldButton

AT_PAUSE = "pause"  # topic of the question answered by Resume: no button here answers it
NOT_EMERGENCY = (
    "Stop motion makes the driver bring the arm to rest. "
    "It is not an emergency stop: for that, press the red button."
)


class SeatPanel:
    """The operator: taking the seat requires a name and a button press."""

    def __init__(self, give: Give, *, may_operate: bool) -> None:
        self._give = give
        self._may_operate = may_operate
        with ui.element("div").classes("seatbox"):
            self._line = ui.html("", sanitize=False)
            self._name = (
                ui.input("Your name").props("dense outlined maxlength=60 autocomplete=off").classes("name")
            )
            self._claim = self._button("Take the seat", self._claim_seat, "claim")
            self._release = self._button("Leave the seat", self._release_seat, "release")

    def show(self, view: CaseView, *, is_mine: bool, orders: bool) -> None:
        """Show who is in the seat."""
        self._line.set_content(seat_line(view, is_mine=is_mine, may_operate=self._may_operate))
        free = self._may_operate and orders and view.seat is None
        self._name.set_visibility(free)
        self._claim.set_visibility(free)
        self._release.set_visibility(is_mine and orders)

    def _button(self, label: str, work: Callable[[], Awaitable[None]], name: str) -> ui.button:
        return (
            ui.button(label, on_click=work, color=None)
            .classes("plain")
            .props(f"no-caps unelevated data-do={name}")
        )

    async def _claim_seat(self) -> None:
        await self._give({"kind": "claim", "name": str(self._name.value or "")})

    async def _release_seat(self) -> None:
        await self._give({"kind": "release"})


class OrderPanel:
    """Next, Run to, Pause, Resume, Acknowledge, Abort; Stop is separate and needs no seat."""

    def __init__(self, give: Give, tell: Callable[[str], None]) -> None:
        self._give = give
        with ui.element("div").classes("orders").props('role=toolbar aria-label="Orders"'):
            self._next_place = ui.element("div").style("display: contents")
            self._to = ui.select([], label="up to").props("dense outlined options-dense").classes("upto")
            self._run_place = ui.element("div").style("display: contents")
            self._pause = self._button("Pause", self._order_pause, "pause")
            self._acknowledge = self._button("Acknowledge faults", self._order_acknowledge, "acknowledge")
            self._abort = HeldButton("Abort (hold)", self._order_abort, tell).button
            self._abort.props("data-do=abort").classes("plain")
        self._build("")

    def _build(self, upcoming: str) -> None:
        """New buttons for the present state: a late click on the old ones has no effect."""
        self._quoted = upcoming

        async def order_next() -> None:
            await self._give({"kind": "next", "upcoming": upcoming})

        async def order_run_to() -> None:
            await self._give({"kind": "run_to", "upcoming": upcoming, "step": str(self._to.value)})

        async def order_resume() -> None:
            await self._give({"kind": "resume", "upcoming": upcoming})

        self._next_place.clear()
        with self._next_place:
            self._next = self._button(f"Next: {upcoming}" if upcoming else "Next", order_next, "next", "go")
        self._run_place.clear()
        with self._run_place:
            self._run_to = self._button("Run to", order_run_to, "run_to")
            self._resume = self._button("Run on", order_resume, "resume")

    def show(self, view: CaseView, *, is_mine: bool) -> None:
        """Enable what is possible now; each button's order quotes the state it was shown with."""
        paused = view.question is not None and view.question.topic == AT_PAUSE
        waits = view.waiting is not None and bool(view.upcoming) and view.question is None
        ended = view.state in ("finished", "aborted") or bool(view.outcome)
        quoted = view.upcoming if waits and is_mine else ""
        if quoted != self._quoted:
            self._build(quoted)
        self._next.set_enabled(is_mine and waits and not ended)
        self._run_to.set_enabled(is_mine and waits and not ended)
        self._resume.set_enabled(is_mine and waits and not ended)
        self._pause.set_enabled(is_mine and not waits and not paused and not ended)
        faulty = any(row.seen.fault for row in view.devices.values())
        self._acknowledge.set_visibility(faulty)
        self._acknowledge.set_enabled(is_mine and (waits or paused) and not ended)
        self._abort.set_enabled(is_mine and not ended)
        options = [row.step for row in view.steps if row.state != "done"]
        if options != self._to.options:
            kept = self._to.value if self._to.value in options else (options[-1] if options else None)
            self._to.set_options(options, value=kept)

    def _button(
        self, label: str, work: Callable[[], Awaitable[None]], name: str, kind: str = "plain"
    ) -> ui.button:
        return (
            ui.button(label, on_click=work, color=None)
            .classes(kind)
            .props(f"no-caps unelevated data-do={name}")
        )

    async def _order_pause(self) -> None:
        await self._give({"kind": "pause"})

    async def _order_acknowledge(self) -> None:
        await self._give({"kind": "acknowledge"})

    async def _order_abort(self) -> None:
        await self._give({"kind": "abort"})


def stop_button(give: Give) -> None:
    """Always visible, always enabled for operators."""

    async def stop() -> None:
        await give({"kind": "stop"})

    with ui.element("div").classes("stopbox"):
        ui.button("Stop motion", on_click=stop, color=None).classes("stop").props(
            "no-caps unelevated data-do=stop"
        ).tooltip(NOT_EMERGENCY)
        ui.html(
            '<div class="stopnote">not an emergency stop:<br>for that, press the red button</div>',
            sanitize=False,
        )

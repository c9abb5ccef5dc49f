"""Operator controls: the seat, the orders, and the open question with its answers.

A button only sends a request: the engine decides. An answer that moves the arm, or releases it on a result,
must be held for a second, and counts only once the panel has been visible for a moment: neither a slip nor
Enter triggers it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Awaitable, Callable
from datetime import UTC, datetime
from functools import partial
from typing import Any

from nicegui import ui

from console.panels.case_state import seat_line
from console.panels.elements import button, html
from console.panels.html import tag, text
from console.panels.question import question_evidence, question_heading, question_pictures, question_words
from procedures.engine.case_view import CaseView
from procedures.engine.events import Questioned
from procedures.engine.events.event_types import digest_of_question
from procedures.operator.checkpoint import ABORT
from procedures.runs.orders import (
    PAUSED,
    RULE_OF,
    WAITING,
    Abort,
    Acknowledge,
    Next,
    Pause,
    Resume,
    RunTo,
    activity_of,
)
from ronna_hw.text import parse_typed_number

HOLD_S = 1.0  # host time for which an answer must be held
PRESS = f"(press {HOLD_S:g} s)"  # on a button that must be held
ARMED_S = 0.7  # host time after appearing before it can be given
DIGEST_SHOWN = 12  # characters; the journal has all of them
Give = Callable[[dict[str, Any]], Awaitable[None]]
GetReply = Callable[[dict[str, Any]], Awaitable[str]]  # the reason for a refusal, or an empty string
NOT_EMERGENCY = (
    "Stop motion makes the driver bring the arm to rest. "
    "It is not an emergency stop: for that, press the red button."
)


class SeatPanel:
    """Panel for the operator's seat, taken by entering a name and pressing a button."""

    def __init__(self, give: Give, *, may_operate: bool) -> None:
        self._give = give
        self._may_operate = may_operate
        with ui.element("div").classes("seatbox"):
            self._line = html()
            # not cut to the longest name: a name that is too long is refused like any other
            self._name = ui.input("Your name").props("dense outlined autocomplete=off").classes("name")
            self._name.on("keydown.enter", self._claim_seat)
            self._claim = button("Take the seat", self._claim_seat, "claim")
            self._release = button("Leave the seat", partial(give, {"kind": "release"}), "release")

    def show(self, view: CaseView, *, is_mine: bool, orders: bool) -> None:
        self._line.set_content(seat_line(view, is_mine=is_mine, may_operate=self._may_operate))
        free = self._may_operate and orders and view.seat is None
        self._name.set_visibility(free)
        self._claim.set_visibility(free)
        self._release.set_visibility(is_mine and orders)

    async def _claim_seat(self) -> None:
        await self._give({"kind": "claim", "name": str(self._name.value or "")})


class OrderPanel:
    """Panel of the order buttons. Stop is separate, since it needs no seat."""

    def __init__(self, give: Give, tell: Callable[[str], None]) -> None:
        self._give = give
        with ui.element("div").classes("orders").props('role=toolbar aria-label="Orders"'):
            self._next_place = ui.element("div").style("display: contents")
            self._last_step = (
                ui.select([], label="up to").props("dense outlined options-dense").classes("upto")
            )
            self._run_place = ui.element("div").style("display: contents")
            self._pause = button("Pause", partial(give, {"kind": "pause"}), "pause")
            self._acknowledge = button(
                "Acknowledge faults", partial(give, {"kind": "acknowledge"}), "acknowledge"
            )
            self._abort = HeldButton(f"Abort {PRESS}", partial(give, {"kind": "abort"}), tell).button
            self._abort.props("data-do=abort").classes("plain")
        self._build("")

    def _build(self, upcoming: str) -> None:
        """Create new buttons for the present state, so that a late click on the old ones has no effect."""
        self._quoted = upcoming

        async def order_next() -> None:
            await self._give({"kind": "next", "upcoming": upcoming})

        async def order_run_to() -> None:
            await self._give({"kind": "run_to", "upcoming": upcoming, "step": str(self._last_step.value)})

        async def order_resume() -> None:
            await self._give({"kind": "resume", "upcoming": upcoming})

        self._next_place.clear()
        with self._next_place:
            self._next = button(f"Next: {upcoming}" if upcoming else "Next", order_next, "next", "go")
        self._run_place.clear()
        with self._run_place:
            self._run_to = button("Run to", order_run_to, "run_to")
            self._resume = button("Run on", order_resume, "resume")

    def show(self, view: CaseView, *, is_mine: bool) -> None:
        """Enable the valid orders. Each order quotes the state in which its button was shown."""
        state = activity_of(
            None if view.question is None else view.question.topic,
            is_waiting=bool(view.waiting and view.waiting.upcoming),
        )
        has_ended = view.state in ("finished", "aborted") or bool(view.outcome)
        quoted = view.upcoming if state is WAITING and is_mine else ""
        if quoted != self._quoted:
            self._build(quoted)
        for shown, order in (
            (self._next, Next),
            (self._run_to, RunTo),
            (self._resume, Resume),
            (self._pause, Pause),
            (self._acknowledge, Acknowledge),
            (self._abort, Abort),
        ):
            is_repeated = order is Pause and state is PAUSED  # would only pause anew after the answer
            is_accepted = state in RULE_OF[order].from_console and not is_repeated
            shown.set_enabled(is_mine and is_accepted and not has_ended)
        self._acknowledge.set_visibility(any(row.seen.fault for row in view.devices.values()))
        options = [row.step for row in view.steps if row.state != "done"]
        if options != self._last_step.options:
            kept_step = (
                self._last_step.value
                if self._last_step.value in options
                else (options[-1] if options else None)
            )
            self._last_step.set_options(options, value=kept_step)


def add_stop_button(give: Give) -> ui.button:
    """Add the stop button, which is visible to operators always, and enabled until the case is closed."""

    async def stop() -> None:
        await give({"kind": "stop"})

    with ui.element("div").classes("stopbox"):
        shown = ui.button("Stop motion", on_click=stop, color=None).classes("stop")
        shown.props("no-caps unelevated data-do=stop").tooltip(NOT_EMERGENCY)
        html('<div class="stopnote">not an emergency stop: for that, press the red button</div>')
    return shown


class QuestionPanel:
    """Panel of the open question, rebuilt for each question and whenever the seat changes hands."""

    def __init__(self, give: GetReply, tell: Callable[[str], None]) -> None:
        """Set up the panel. `tell` shows what was still said in it when its question is gone."""
        self._give = give
        self._tell = tell
        self._words = ""
        self._said: ui.html | None = None
        self._shown: tuple[object, ...] | None = ()
        self._time_limit: ui.html | None = None
        self._place = (
            ui.element("section").classes("question").props('aria-label="Question" aria-live=polite')
        )

    def show(self, view: CaseView, *, is_mine: bool, has_seat: bool) -> None:
        question = view.question
        key = (
            None if question is None else (question.question, digest_of_question(question), is_mine, has_seat)
        )
        if key != self._shown:
            if self._words and key is not None and (self._shown or ())[:2] == key[:2]:
                self._words = ""  # the seat changed hands: it was said to somebody else
            if self._words:
                self._tell(self._words)
            self._shown, self._time_limit, self._said, self._words = key, None, None, ""
            self._place.clear()
            self._place.set_visibility(question is not None)
            if question is not None:
                with self._place:
                    self._build(question, view, is_mine=is_mine)
        if self._time_limit is not None and question is not None:
            self._time_limit.set_content(_time_limit(question, view))

    def _say(self, words: str) -> None:
        self._words = words
        if self._said is not None:
            self._said.set_content(tag("p", text(words), class_="warn", role="alert") if words else "")

    def _build(self, question: Questioned, view: CaseView, *, is_mine: bool) -> None:
        digest = digest_of_question(question)
        html(question_heading(question))
        with ui.element("div").classes("asked"):
            html(question_words(question))
            if question.pictures:
                html(question_pictures(question)).classes("cutbox")
        if question.evidence:
            html(question_evidence(question))
        with ui.element("div").classes("answerbar"):
            self._build_answers(question, view, digest, is_mine=is_mine)

    def _build_answers(self, question: Questioned, view: CaseView, digest: str, *, is_mine: bool) -> None:
        """Add what is typed and the buttons, which stay in view below the question."""
        self._time_limit = html()
        if not is_mine:
            who = f"{view.seat.holder} answers" if view.seat else "the operator's seat is empty"
            html(tag("p", text(f"Answers: {', '.join(question.answers)}; {who}."), class_="dim"))
            return
        read_back_field = None
        if question.read_back is not None:
            read_back_field = _typed_field(f"Type {question.read_back}", "maxlength=60")
        reading_fields = [
            _typed_field(f"Type {what}", "maxlength=20 inputmode=decimal") for what in question.reads
        ]
        self._said = html()
        with ui.element("div").classes("answers"):
            for answer in question.answers:
                self._answer_button(question, answer, digest, read_back_field, reading_fields)
        signed = f"Your answer signs exactly what is shown here: {digest[:DIGEST_SHOWN]} in the journal."
        html(tag("p", signed, class_="digest dim"))

    def _answer_button(
        self,
        question: Questioned,
        answer: str,
        digest: str,
        read_back_field: ui.input | None,
        reading_fields: list[ui.input],
    ) -> None:
        is_go_ahead = answer == question.answers[0]

        async def act() -> None:
            order: dict[str, Any] = {
                "kind": "answer",
                "question": question.question,
                "answer": answer,
                "shown": digest,
            }
            if read_back_field is not None and is_go_ahead:
                order["typed"] = str(read_back_field.value or "")
            if reading_fields and is_go_ahead:
                try:
                    order["readings"] = [
                        parse_typed_number(str(field.value or ""), "mm") for field in reading_fields
                    ]
                except ValueError as error:
                    self._say(f"{error} is not a number in mm, such as 0.12")
                    return
            self._say(await self._give(order))

        # The last answer, also given by silence, changes nothing, unless it ends the case.
        if question.deliberate and (answer == ABORT or answer != question.answers[-1]):
            answering = HeldButton(f"{answer} {PRESS}", act, self._say).button
        else:
            answering = ui.button(answer, on_click=act, color=None).props("no-caps unelevated")
        answering.classes("go" if is_go_ahead else "plain").props(f'data-answer="{answer}"')


class HeldButton:
    """Button that acts after being held for a second, by pointer or space bar."""

    def __init__(self, label: str, act: Callable[[], Awaitable[None]], tell: Callable[[str], None]) -> None:
        self._act = act
        self._tell = tell
        self._appeared_s = time.monotonic()
        self._down_ms: float | None = None  # by the browser's clock: the hold time is measured, not reported
        self._by_key = False
        self.button = ui.button(label, color=None).classes("held").props("no-caps unelevated")
        self.button.tooltip("hold for one second; on the keyboard, hold the space bar")
        self.button.on("pointerdown", self._down, args=["timeStamp"])
        self.button.on("pointerup", self._up, args=["timeStamp"])
        for event_name in ("pointerleave", "pointercancel"):
            self.button.on(event_name, self._pointer_gone)
        self.button.on("blur", self._cancel_hold)
        self.button.on("keydown", self._key_down, args=["key", "repeat", "timeStamp"])
        self.button.on("keyup", self._key_up, args=["key", "timeStamp"])

    def _down(self, event: Any) -> None:
        armed = time.monotonic() - self._appeared_s >= ARMED_S
        self._down_ms = _moment_ms(event) if armed else None
        self._by_key = False

    async def _up(self, event: Any) -> None:
        down_ms, self._down_ms = self._down_ms, None
        if down_ms is None:
            return
        if not _moment_ms(event) - down_ms >= 1000.0 * HOLD_S:  # also rejects NaN
            self._tell("Hold the button for one second.")
            return
        await self._act()

    def _cancel_hold(self) -> None:
        self._down_ms = None

    def _pointer_gone(self) -> None:
        if not self._by_key:  # a page that moves under a resting pointer does not release the space bar
            self._cancel_hold()

    def _key_down(self, event: Any) -> None:
        if event.args.get("key") == " " and not event.args.get("repeat"):
            self._down(event)
            self._by_key = True

    async def _key_up(self, event: Any) -> None:
        if event.args.get("key") == " ":
            await self._up(event)


def _moment_ms(event: Any) -> float:
    """Return the event's browser timestamp in ms, or NaN if not reported."""
    moment = event.args.get("timeStamp")
    return float(moment) if isinstance(moment, int | float) else math.nan


def _time_limit(question: Questioned, view: CaseView) -> str:
    if question.timeout_s is None:
        return tag("p", "No time limit.", class_="dim")
    asked = datetime.fromisoformat(view.asked_at)
    remaining_s = max(0.0, question.timeout_s - (datetime.now(UTC) - asked).total_seconds())
    return tag(
        "p",
        f"{remaining_s:.0f} s left; no answer means “{text(question.answers[-1])}”.",
        class_="dim num age",
    )


def _typed_field(what: str, props: str) -> ui.input:
    """Add a field below its label, which wraps where one inside would be cut."""
    html(tag("p", text(what), class_="label"))
    field = ui.input().classes("typed").props(f"dense outlined autocomplete=off {props}")
    field.props["aria-label"] = what
    return field

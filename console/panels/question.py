"""The open question, docked: what is asked, the evidence, and the answers.

An answer that moves the arm, or releases it on a result, must be held for a second, and counts only once the
panel has been visible for a moment: neither a slip nor Enter triggers it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Awaitable, Callable
from datetime import UTC, datetime
from typing import Any

from nicegui import ui

from console.feed.view import CaseView
from console.panels.html import evidence_table, tag, text
from procedures.engine.events import Questioned
from procedures.engine.events.event_types import shown_digest
from ronna_hw.text.typed_number import typed_number

HOLD_S = 1.0  # host time for which an answer must be held
ARMED_S = 0.7  # host time after appearing before it can be given
DIGEST_SHOWN = 12  # characters; the journal has all of them

Give = Callable[[dict[str, Any]], Awaitable[None]]


class HeldButton:
    """A button that acts after being held by pointer or space bar for a second."""

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
        for gone in ("pointerleave", "pointercancel"):
            self.button.on(gone, self._pointer_gone)
        self.button.on("blur", self._let_go)
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

    def _let_go(self) -> None:
        self._down_ms = None

    def _pointer_gone(self) -> None:
        if not self._by_key:  # a page that moves under a resting pointer does not release the space bar
            self._let_go()

    def _key_down(self, event: Any) -> None:
        if event.args.get("key") == " " and not event.args.get("repeat"):
            self._down(event)
            self._by_key = True

    async def _key_up(self, event: Any) -> None:
        if event.args.get("key") == " ":
            await self._up(event)


def _moment_ms(event: Any) -> float:
    """Time of the event by the browser's clock; NaN if not reported."""
    moment = event.args.get("timeStamp")
    return float(moment) if isinstance(moment, int | float) else math.nan


class QuestionPanel:
    """Rebuilt for each question, and when the seat changes hands."""

    def __init__(self, give: Give, tell: Callable[[str], None]) -> None:
        self._give = give
        self._tell = tell
        self._shown: object = ()
        self._left: ui.html | None = None
        self._place = (
            ui.element("section").classes("question").props('aria-label="Question" aria-live=polite')
        )

    def show(self, view: CaseView, *, is_mine: bool, has_seat: bool) -> None:
        """Show the open question, if any."""
        question = view.question
        key = None if question is None else (question.question, shown_digest(question), is_mine, has_seat)
        if key != self._shown:
            self._shown, self._left = key, None
            self._place.clear()
            self._place.set_visibility(question is not None)
            if question is not None:
                with self._place:
                    self._build(question, view, is_mine=is_mine)
        if self._left is not None and question is not None:
            self._left.set_content(_left(question, view))

    def _build(self, question: Questioned, view: CaseView, *, is_mine: bool) -> None:
        digest = shown_digest(question)
        ui.html(
            tag("h2", text(question.subject), data_question=str(question.question))
            + tag("p", text(question.value), class_="value")
            + "".join(map(evidence_table, question.evidence)),
            sanitize=False,
        )
        self._left = ui.html("", sanitize=False)
        if not is_mine:
            who = f"{view.seat.holder} answers" if view.seat else "the operator's seat is empty"
            ui.html(
                tag("p", text(f"Answers: {', '.join(question.answers)}; {who}."), class_="dim"),
                sanitize=False,
            )
            return
        typed = None
        if question.read_back is not None:
            label = f"Read back: {question.read_back}"
            typed = ui.input(label).classes("typed").props("dense outlined autocomplete=off maxlength=60")
        read = [
            ui.input(what)
            .classes("typed")
            .props("dense outlined autocomplete=off maxlength=20 inputmode=decimal")
            for what in question.reads
        ]
        with ui.element("div").classes("answers"):
            for answer in question.answers:
                self._answer_button(question, answer, digest, typed, read)
        ui.html(tag("p", f"shown: {digest[:DIGEST_SHOWN]}", class_="digest"), sanitize=False)

    def _answer_button(
        self, question: Questioned, answer: str, digest: str, typed: ui.input | None, read: list[ui.input]
    ) -> None:
        goes_on = answer == question.answers[0]

        async def act() -> None:
            order: dict[str, Any] = {
                "kind": "answer",
                "question": question.question,
                "answer": answer,
                "shown": digest,
            }
            if typed is not None and goes_on:
                order["typed"] = str(typed.value or "")
            if read and goes_on:
                try:
                    order["readings"] = [typed_number(str(one.value or ""), "mm") for one in read]
                except ValueError as error:
                    self._tell(f"{error} is not a number in mm, such as 0.12")
                    return
            await self._give(order)

        # The last answer, which silence means too, changes nothing.
        if question.deliberate and answer != question.answers[-1]:
            button = HeldButton(f"{answer} (hold)", act, self._tell).button
        else:
            button = ui.button(answer, on_click=act, color=None).props("no-caps unelevated")
        button.classes("go" if goes_on else "plain").props(f'data-answer="{answer}"')


def _left(question: Questioned, view: CaseView) -> str:
    if question.timeout_s is None:
        return tag("p", "No time limit.", class_="dim")
    asked = datetime.fromisoformat(view.asked_at)
    left_s = max(0.0, question.timeout_s - (datetime.now(UTC) - asked).total_seconds())
    return tag("p", f"{left_s:.0f} s left; no answer means “{text(question.answers[-1])}”.", class_="dim num")

"""A button gives the order that it showed, however late its click arrives."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest
from nicegui import Client, ui

from console.case_view import CaseView
from console.panels.orders import ARMED_S, HeldButton, OrderPanel, QuestionPanel
from procedures.engine.events import Questioned, Waiting


def test_the_next_button_is_replaced_when_the_upcoming_step_changes() -> None:
    async def give(_order: dict[str, Any]) -> None:
        pass

    async def clicks() -> tuple[bool, str]:
        with Client(ui.page("/of-a-test"), request=None):
            panel = OrderPanel(give, lambda _words: None)
            panel.show(CaseView(waiting=Waiting(upcoming="image")), is_mine=True)
            seen = panel._next
            panel.show(CaseView(waiting=Waiting(upcoming="fit:T1")), is_mine=True)
        return seen.is_deleted, panel._next.text

    assert asyncio.run(clicks()) == (True, "Next: fit:T1")


@pytest.mark.parametrize(("topic", "possible"), [("pause", True), ("park", False)])
def test_faults_can_be_acknowledged_at_a_pause(topic: str, possible: bool) -> None:
    async def give(_order: dict[str, Any]) -> None:
        pass

    open_question = Questioned(
        question=1, topic=topic, subject="", value="", answers=("yes", "no"), timeout_s=None
    )

    async def enabled() -> bool:
        with Client(ui.page("/of-a-test"), request=None):
            panel = OrderPanel(give, lambda _words: None)
            panel.show(CaseView(question=open_question), is_mine=True)
        return panel._acknowledge.enabled

    assert asyncio.run(enabled()) is possible


@pytest.mark.parametrize(
    ("up", "acted"),
    [({"timeStamp": 1009.0}, 0), ({"timeStamp": 1011.0}, 1), ({}, 0), ({"timeStamp": "x"}, 0)],
)
def test_a_hold_button_acts_only_after_the_browser_reports_a_hold_of_one_second(
    up: dict[str, Any], acted: int
) -> None:
    done, said = [], []

    async def act() -> None:
        done.append(True)

    async def hold() -> None:
        with Client(ui.page("/of-a-test"), request=None):
            button = HeldButton("yes", act, said.append)
        button._down(SimpleNamespace(args={"timeStamp": 10.0}))
        await button._up(SimpleNamespace(args={"timeStamp": 5000.0}))  # it has only just appeared
        button._appeared_s -= ARMED_S
        button._down(SimpleNamespace(args={"timeStamp": 10.0}))
        await button._up(SimpleNamespace(args=up))

    asyncio.run(hold())
    assert (len(done), len(said)) == (acted, 1 - acted)


def test_of_a_deliberate_question_every_answer_is_held_but_the_one_that_silence_means() -> None:
    async def give(_order: dict[str, Any]) -> None:
        pass

    asked = Questioned(
        question=1,
        topic="head_unseen",
        subject="",
        value="",
        answers=("wait", "continue", "leave"),
        timeout_s=None,
        deliberate=True,
    )

    async def labels() -> list[str]:
        with Client(ui.page("/of-a-test"), request=None) as client:
            QuestionPanel(give, lambda _words: None).show(
                CaseView(question=asked), is_mine=True, has_seat=True
            )
            return [one.text for one in client.elements.values() if isinstance(one, ui.button)]

    assert asyncio.run(labels()) == ["wait (hold)", "continue (hold)", "leave"]

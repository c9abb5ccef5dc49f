"""A button orders what it showed, whenever its click arrives."""

from __future__ import annotations

import asyncio
from typing import Any

from nicegui import Client, ui

from console.feed.view import CaseView
from console.panels.orders import OrderPanel
from procedures.engine.events import Waiting


def test_a_late_click_on_next_is_not_for_the_step_that_is_shown_since() -> None:
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

"""A link whose parent is gone keeps running until the controller's program has been sent the stop."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from rsi_loop import CYCLE_MS, FIRST_IPOC, InProcessLink, telegram

from drivers.kuka_rsi.realtime import loop as link_loop

MS = 1_000_000  # ns


@pytest.fixture
def link() -> Iterator[InProcessLink]:
    made = InProcessLink()
    made.open()
    yield made
    made.close()


@pytest.mark.hazard(30)
def test_a_controller_delayed_by_less_than_its_timeout_is_still_sent_the_stop(
    link: InProcessLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    def done_after(quiet_ms: int) -> bool:
        now_ns = link.now_ns + quiet_ms * MS
        monkeypatch.setattr(
            link_loop, "time", SimpleNamespace(monotonic_ns=lambda: now_ns, sleep=lambda _: 0)
        )
        return link.loop._done()

    def reply(cycle: int) -> bytes:
        data = link.receive(telegram(FIRST_IPOC + cycle * CYCLE_MS))
        assert data is not None
        return data

    assert b"<Stop>0</Stop>" in reply(0)
    assert not done_after(10_000)  # its parent is there
    link.loop.responder.parent_gone = True
    assert not done_after(390)
    assert done_after(410)
    cycle = 1
    while b"<Stop>1</Stop>" not in reply(cycle):
        assert not done_after(390)
        cycle += 1
    assert cycle < 10  # the arm is at rest
    assert not done_after(90)
    assert done_after(110)

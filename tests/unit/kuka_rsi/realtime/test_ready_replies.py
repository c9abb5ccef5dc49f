"""A reply prepared before its telegram arrives is byte for byte the one that would be made on arrival."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rsi_loop import CYCLE_MS, FIRST_IPOC, START_DEG, InProcessLink, corrections_of, telegram
from rsi_stand import FAR, LIMITS, MODEL, START

from ronna_hw.arm.motion.planning import plan_joint_move
from ronna_hw.arm_stream.records import Command, LinkFault, Move, StopOrder

MOVE = Command(0, Move(plan_joint_move(MODEL, START, FAR, LIMITS)))

EVENTS = st.lists(
    st.sampled_from(["", "", "", "", "reply lost", "telegram lost", "hold", "protective", "strict form"]),
    min_size=20,
    max_size=120,
)


class Follower:
    """Controller that follows at once, with a link under it."""

    def __init__(self, *, ahead: bool) -> None:
        self.link = InProcessLink()
        self.link.open()
        self.ahead = ahead
        self.ahead_used = 0
        self.ipoc = FIRST_IPOC
        self.delay = 0
        self.axes_deg = START_DEG
        self.replies: list[bytes | None] = []

    def cycle(self, event: str = "") -> None:
        self.ipoc += CYCLE_MS
        if event == "telegram lost":
            self.delay += 1
            return
        if event == "hold":
            self.link.stop(StopOrder.HOLD)
        elif event == "protective":
            self.link.stop(StopOrder.PROTECTIVE)
        data = telegram(self.ipoc, self.axes_deg, self.delay)
        if event == "strict form":
            data = data.replace(b"/>", b" />")
        if not self.ahead:
            self.link.loop.session.ready = None
        self.ahead_used += self.link.loop.session.ready is not None
        reply = self.link.receive(data)
        self.replies.append(reply)
        if event == "reply lost":
            self.delay += 1
        elif reply is not None:
            a, b, c, d, e, f = (s + v for s, v in zip(START_DEG, corrections_of(reply), strict=True))
            self.axes_deg = (a, b, c, d, e, f)


@given(EVENTS)
@settings(max_examples=30, deadline=None)
def test_replies_prepared_ahead_equal_those_made_on_arrival(events: list[str]) -> None:
    ahead, on_arrival = Follower(ahead=True), Follower(ahead=False)
    for follower in (ahead, on_arrival):
        follower.cycle()
        follower.link.give(MOVE)
        for event in events:
            follower.cycle(event)
        state = follower.link.loop.session.state(real_time=False, locked=False)
        follower.link.close()
        assert state.violation_kind == ""
        assert state.fault in (LinkFault.NONE, LinkFault.PROTECTIVE)
    assert ahead.replies == on_arrival.replies
    assert ahead.ahead_used > len(events) / 4


def test_a_stop_ordered_after_a_reply_was_prepared_acts_on_the_very_next_reply(
    link: InProcessLink,
) -> None:
    link.receive(telegram(FIRST_IPOC))
    link.give(MOVE)
    last = [corrections_of(link.receive(telegram(FIRST_IPOC + CYCLE_MS * k)) or b"") for k in range(1, 60)]
    ready = link.loop.session.ready
    assert ready is not None
    link.stop(StopOrder.HOLD)
    reply = link.receive(telegram(FIRST_IPOC + CYCLE_MS * 60)) or b""
    assert reply != ready.reply
    # The step shrinks against the one before, where the made one would have grown or kept it.
    assert corrections_of(reply)[0] - last[-1][0] < corrections_of(ready.reply)[0] - last[-1][0]


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data.replace(b'Type="KUKA"', b'Type="OTHER"'),
        lambda data: data.replace(b'A1="0.0000"', b'A1="nan"'),
        lambda data: data.replace(b'A1="0.0000"', b'A1="1e999"'),
        lambda data: data.replace(b'A1="0.0000"', b'A1="1.2.3"'),
        lambda data: data[:-6],
        lambda data: data.replace(b"<AIPos", b"<Other"),
    ],
)
def test_a_malformed_telegram_gets_no_reply_even_with_the_expected_time_stamp(
    link: InProcessLink, change: object
) -> None:
    assert link.receive(telegram(FIRST_IPOC))
    assert link.loop.session.ready is not None
    assert link.receive(change(telegram(FIRST_IPOC + CYCLE_MS))) is None  # type: ignore[operator]
    assert link.loop.session.rejected == 1
    assert link.receive(telegram(FIRST_IPOC + 2 * CYCLE_MS))

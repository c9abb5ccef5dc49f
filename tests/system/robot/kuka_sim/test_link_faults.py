"""Every scripted fault of the RSI link, and what a client sees of it."""

from __future__ import annotations

from itertools import pairwise

import pytest
from shared_controller import SharedController, largest_step, on_a1, rests_at


@pytest.mark.parametrize(
    ("fault", "late"),
    [
        ("drop 100 % for 0.1 s", 25),
        ("delay 2 cycles for 0.1 s", 25),
        ("corrupt replies 100 % for 0.1 s", 25),
        ("duplicate 100 % for 0.1 s", 0),
    ],
)
def test_lost_delayed_and_corrupt_replies_count_as_late_cycles_and_the_arm_does_not_jump(
    shared: SharedController, fault: str, late: int
) -> None:
    base_deg = shared.rsi.axes_deg[0]
    shared.inject(fault)
    angles = shared.move(2.0)
    assert shared.rsi.late == late
    assert largest_step(angles) < 0.3
    assert rests_at(shared, 2.0, base_deg)
    assert shared.rsi.late == late
    assert shared.eki.state(Id="8").get("RSI") == "2"


def test_lost_telegrams_are_gaps_in_the_stamps_and_late_cycles(shared: SharedController) -> None:
    shared.inject("lose telegrams 30 % for 0.8 s")
    stamps = [shared.rsi.ipoc]
    for _ in range(200):
        shared.rsi.cycles(1)
        stamps.append(shared.rsi.ipoc)
    steps = [b - a for a, b in pairwise(stamps)]
    assert all(step % 4 == 0 and step > 0 for step in steps)
    lost = sum(step // 4 - 1 for step in steps)
    assert 30 < lost < 90
    assert shared.rsi.late == lost


def test_the_stream_continues_after_a_short_network_cut(shared: SharedController) -> None:
    base_deg, before = shared.rsi.axes_deg[0], shared.rsi.ipoc
    shared.rsi.cycles(100, on_a1(0.1))
    between = shared.rsi.ipoc
    shared.inject("network cut for 0.2 s")
    shared.rsi.cycles(1, on_a1(0.1))
    shared.rsi.cycles(5, on_a1(0.1))
    assert between - before == 400
    assert shared.rsi.late == pytest.approx(50, abs=1)
    assert shared.rsi.ipoc - between == pytest.approx(4 * (6 + 50), abs=8)
    assert shared.rsi.axes_deg[0] == pytest.approx(base_deg + 0.1, abs=1e-4)


def test_a_foreign_sender_has_its_own_port_and_is_not_counted_as_late(shared: SharedController) -> None:
    ours = shared.rsi.source
    shared.inject("foreign sender for 0.1 s")
    sources = []
    for _ in range(80):
        shared.rsi.receive()
        sources.append(shared.rsi.source)
        if shared.rsi.source == ours:
            shared.rsi.answer()
    assert sources.count(ours) < 80
    assert {source[0] for source in sources} == {"127.0.0.1"}
    assert len(set(sources)) == 2
    assert shared.rsi.late == 0


def test_a_run_may_begin_with_a_nearly_empty_telegram(shared: SharedController) -> None:
    shared.inject("short first telegram for 100 s", "program restart")
    source = shared.rsi.source
    shared.rsi.until_other_source(source)
    assert len(shared.rsi.last) < 100
    assert shared.rsi.last.startswith(b'<Rob Type="KUKA"><IPOC>')
    shared.rsi.answer()
    shared.rsi.cycles(5)
    assert len(shared.rsi.last) > 300

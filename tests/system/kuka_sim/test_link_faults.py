"""Every scripted fault of the RSI link, and what a client sees of it."""

from __future__ import annotations

from itertools import pairwise

import pytest
from kuka_stage import Stage, largest_step, on_a1, rests_at


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
    stage: Stage, fault: str, late: int
) -> None:
    base_deg = stage.rsi.axes_deg[0]
    stage.inject(fault)
    angles = stage.move(2.0)
    assert stage.rsi.late == late
    assert largest_step(angles) < 0.3
    assert rests_at(stage, 2.0, base_deg)
    assert stage.rsi.late == late
    assert stage.eki.state(Id="8").get("RSI") == "2"


def test_lost_telegrams_are_gaps_in_the_stamps_and_late_cycles(stage: Stage) -> None:
    stage.inject("lose telegrams 30 % for 0.8 s")
    stamps = [stage.rsi.ipoc]
    for _ in range(200):
        stage.rsi.cycles(1)
        stamps.append(stage.rsi.ipoc)
    steps = [b - a for a, b in pairwise(stamps)]
    assert all(step % 4 == 0 and step > 0 for step in steps)
    lost = sum(step // 4 - 1 for step in steps)
    assert 30 < lost < 90
    assert stage.rsi.late == lost


def test_the_stream_continues_after_a_short_network_cut(stage: Stage) -> None:
    base_deg, before = stage.rsi.axes_deg[0], stage.rsi.ipoc
    stage.rsi.cycles(100, on_a1(0.1))
    between = stage.rsi.ipoc
    stage.inject("network cut for 0.2 s")
    stage.rsi.cycles(1, on_a1(0.1))
    stage.rsi.cycles(5, on_a1(0.1))
    assert between - before == 400
    assert stage.rsi.late == pytest.approx(50, abs=1)
    assert stage.rsi.ipoc - between == pytest.approx(4 * (6 + 50), abs=8)
    assert stage.rsi.axes_deg[0] == pytest.approx(base_deg + 0.1, abs=1e-4)


def test_a_foreign_sender_has_its_own_port_and_is_not_counted_as_late(stage: Stage) -> None:
    ours = stage.rsi.source
    stage.inject("foreign sender for 0.1 s")
    sources = []
    for _ in range(80):
        stage.rsi.receive()
        sources.append(stage.rsi.source)
        if stage.rsi.source == ours:
            stage.rsi.answer()
    assert sources.count(ours) < 80
    assert {source[0] for source in sources} == {"127.0.0.1"}
    assert len(set(sources)) == 2
    assert stage.rsi.late == 0


def test_a_run_may_begin_with_a_nearly_empty_telegram(stage: Stage) -> None:
    stage.inject("short first telegram for 100 s", "program restart")
    source = stage.rsi.source
    stage.rsi.until_other_source(source)
    assert len(stage.rsi.last) < 100
    assert stage.rsi.last.startswith(b'<Rob Type="KUKA"><IPOC>')
    stage.rsi.answer()
    stage.rsi.cycles(5)
    assert len(stage.rsi.last) > 300

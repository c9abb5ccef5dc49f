"""Every fault of arm, cell, EKI channel and RSI link, scripted and live, and what a client sees of it."""

from __future__ import annotations

import re
from itertools import pairwise

import pytest
from shared_controller import SharedController, largest_step, on_a1, rests_at

STOPS = [
    ("emergency stop for 0.2 s", {"EStop": "1", "Drives": "0", "Err": "1"}, {"EStop": "0"}),
    ("guard open for 0.2 s", {"Guard": "1", "Drives": "0", "Err": "6"}, {"Guard": "0"}),
    ("mode T2 for 0.2 s", {"Mode": "T2", "Drives": "0", "Err": "0"}, {"Mode": "EXT"}),
    ("drives off", {"Drives": "0", "Err": "0"}, {}),
    ("collision", {"Drives": "0", "Err": "117"}, {}),
]


@pytest.mark.parametrize(("fault", "during", "after"), STOPS, ids=[stop[0] for stop in STOPS])
def test_eki_reports_a_stop_of_the_robot_and_the_arm_stays_at_rest_while_rsi_streams(
    shared: SharedController, fault: str, during: dict[str, str], after: dict[str, str]
) -> None:
    shared.move(3.0, cycles=50)
    shared.inject(fault)
    shared.rsi.cycles(40, on_a1(3.5))
    shared.eki.until(lambda e: all(e.get(key) == value for key, value in during.items()))
    resting_deg = shared.rsi.axes_deg
    shared.rsi.cycles(40, on_a1(4.0))
    assert shared.rsi.axes_deg == resting_deg
    state = shared.eki.state(**after, RSI="1")
    assert state.get("ProState") == "P_STOP"
    assert shared.eki.command("RSI_START") == 4
    assert shared.eki.command("RSI_STOP") == 0
    assert shared.rsi.quiet(0.1)
    if during.get("Err", "0") != "0":
        assert shared.eki.command("RSI_START") == 1
        assert shared.eki.command("ACK_ERRORS") == 0
    assert shared.eki.command("RSI_START") == 5  # the drives are off
    assert shared.eki.command("DRIVES", On=1) == 0
    assert shared.eki.command("RSI_START") == 0


def test_a_restarted_program_has_a_new_port_new_stamps_and_the_current_pose_as_its_base(
    shared: SharedController,
) -> None:
    base_deg, source, stamp = shared.rsi.axes_deg[0], shared.rsi.source, shared.rsi.ipoc
    shared.move(4.0, cycles=60)
    shared.inject("program restart")
    shared.rsi.until_other_source(source)
    assert abs(shared.rsi.ipoc - stamp) > 4 * 1000
    assert shared.rsi.late == 0
    reached_deg = shared.rsi.axes_deg[0]
    assert 3.0 < reached_deg - base_deg < 4.5
    shared.rsi.answer()
    shared.rsi.cycles(20)
    assert shared.rsi.axes_deg[0] == reached_deg


def test_cutting_eki_ends_the_connection_but_not_the_run(shared: SharedController) -> None:
    shared.inject("eki cut")
    shared.rsi.cycles(3)
    with pytest.raises(ConnectionError):
        shared.eki.until(lambda element: False)
    shared.rsi.cycles(20)
    assert shared.reconnect().state(Id="8").get("RSI") == "2"


@pytest.mark.parametrize(("fault", "outside"), [("eki garbage", b"what?"), ("eki padding", b"\0\0")])
def test_garbage_and_padding_are_outside_the_telegrams(
    shared: SharedController, fault: str, outside: bytes
) -> None:
    shared.inject(fault)
    shared.rsi.cycles(3)
    (spoilt,) = [segment for segment in shared.eki.raw(4) if outside in segment]
    assert re.search(rb"<State .*</State>", spoilt)  # the telegram itself is whole
    shared.world.set_fault_script("")
    assert shared.reconnect().state(Id="8").get("RSI") == "2"


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

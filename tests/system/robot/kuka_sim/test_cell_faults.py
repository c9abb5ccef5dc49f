"""Every fault of arm and cell, scripted and live, and what a client sees of it."""

from __future__ import annotations

import pytest
from shared_controller import SharedController, on_a1

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

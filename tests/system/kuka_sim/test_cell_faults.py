"""Every fault of arm and cell, scripted and live, and what a client sees of it."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from kuka_clients import Cell
from kuka_stage import Stage, on_a1

from ronna_hw.host.control_port import ask_control_port

STOPS = [
    ("emergency stop for 0.2 s", {"EStop": "1", "Drives": "0", "Err": "1"}, {"EStop": "0"}),
    ("guard open for 0.2 s", {"Guard": "1", "Drives": "0", "Err": "6"}, {"Guard": "0"}),
    ("mode T2 for 0.2 s", {"Mode": "T2", "Drives": "0", "Err": "0"}, {"Mode": "EXT"}),
    ("drives off", {"Drives": "0", "Err": "0"}, {}),
    ("collision", {"Drives": "0", "Err": "117"}, {}),
]


@pytest.mark.parametrize(("fault", "during", "after"), STOPS, ids=[stop[0] for stop in STOPS])
def test_eki_reports_a_stop_of_the_robot_and_the_arm_stays_at_rest_while_rsi_streams(
    stage: Stage, fault: str, during: dict[str, str], after: dict[str, str]
) -> None:
    stage.move(3.0, cycles=50)
    stage.inject(fault)
    stage.rsi.cycles(40, on_a1(3.5))
    stage.eki.until(lambda e: all(e.get(key) == value for key, value in during.items()))
    resting_deg = stage.rsi.axes_deg
    stage.rsi.cycles(40, on_a1(4.0))
    assert stage.rsi.axes_deg == resting_deg
    state = stage.eki.state(**after, RSI="1")
    assert state.get("ProState") == "P_STOP"
    assert stage.eki.command("RSI_START") == 4
    assert stage.eki.command("RSI_STOP") == 0
    assert stage.rsi.quiet(0.1)
    if during.get("Err", "0") != "0":
        assert stage.eki.command("RSI_START") == 1
        assert stage.eki.command("ACK_ERRORS") == 0
    assert stage.eki.command("RSI_START") == 5  # the drives are off
    assert stage.eki.command("DRIVES", On=1) == 0
    assert stage.eki.command("RSI_START") == 0


def test_a_restarted_program_has_a_new_port_new_stamps_and_the_current_pose_as_its_base(
    stage: Stage,
) -> None:
    base_deg, source, stamp = stage.rsi.axes_deg[0], stage.rsi.source, stage.rsi.ipoc
    stage.move(4.0, cycles=60)
    stage.inject("program restart")
    stage.rsi.until_other_source(source)
    assert abs(stage.rsi.ipoc - stamp) > 4 * 1000
    assert stage.rsi.late == 0
    reached_deg = stage.rsi.axes_deg[0]
    assert 3.0 < reached_deg - base_deg < 4.5
    stage.rsi.answer()
    stage.rsi.cycles(20)
    assert stage.rsi.axes_deg[0] == reached_deg


def test_both_channels_report_a_live_emergency_stop(
    cell: Callable[..., Cell],
) -> None:
    here = cell()
    eki, sdk = here.project(), here.sdk()
    sdk.read()
    eki.read()
    ask_control_port(here.child.ready["control"], "fault", line="now: robot emergency stop")
    eki.until(lambda state: state.get("EStop") == "1")
    status = sdk.read().find("Status")  # its first since: this channel tells changes only
    assert status is not None
    assert status.get("EmergencyStop") == "1"

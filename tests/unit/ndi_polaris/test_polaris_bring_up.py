"""From a closed port to a unit that is ready: its identity, its baud rate and its tools."""

from __future__ import annotations

from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from polaris_unit_in_process import bring_up

from drivers.ndi_polaris import PolarisTracker
from drivers.ndi_polaris.tool_definition import encode_definition, planar_tool

Make = Callable[..., PolarisTracker]


def test_connect_reads_the_units_identity(make_tracker: Make) -> None:
    identity = make_tracker(expected_model="spectra", expected_serial="P7-01234").connect()
    assert (identity.vendor, identity.model, identity.serial) == ("NDI", "Polaris Spectra", "P7-01234")
    assert identity.firmware == "007.000.012"
    assert dict(identity.details)["api revision"] == "G.001.005"


@pytest.mark.parametrize("left_at", [9600, 115200, 57600, 921600])
def test_the_unit_is_found_at_the_rate_it_was_left_at(make_tracker: Make, unit: Any, left_at: int) -> None:
    unit.unit_baud = left_at
    make_tracker().connect()
    assert unit.baud == left_at
    assert unit.breaks == 0


def test_a_unit_at_an_unusual_rate_is_recovered_by_a_break(make_tracker: Make, unit: Any) -> None:
    unit.unit_baud = 1228739
    make_tracker().connect()
    assert unit.breaks == 1
    assert unit.baud == 9600


def test_a_unit_that_fails_to_initialise_is_reset_and_initialised_again(
    make_tracker: Make, unit: Any
) -> None:
    refusals = iter(["ERROR15"])
    usual = unit._do_init
    unit._do_init = lambda argument: next(refusals, None) or usual(argument)

    def reset(argument: str) -> str:
        unit.restart()
        return "RESET"

    unit._do_reset = reset
    unit.initialised = True
    make_tracker().connect()
    assert "RESET:0" in unit.commands
    assert unit.initialised


def test_configure_negotiates_the_fastest_common_rate(make_tracker: Make, unit: Any) -> None:
    device = make_tracker()
    device.connect()
    device.configure()
    assert unit.unit_baud == unit.baud == device.baud == 115200
    assert [line for line in unit.commands if line.startswith("COMM")][:3] == [
        "COMM:60000",
        "COMM:A0000",
        "COMM:50000",
    ]


def test_the_negotiated_rate_can_be_limited(make_tracker: Make, unit: Any) -> None:
    device = make_tracker(maximum_baud=38400)
    device.connect()
    device.configure()
    assert unit.unit_baud == 38400


def test_a_rate_at_which_the_unit_does_not_answer_is_abandoned(make_tracker: Make, unit: Any) -> None:
    usual = unit._do_comm
    # says OKAY to 921600 and stays where it is
    unit._do_comm = lambda argument: "OKAY" if argument[0] == "6" else usual(argument)
    device = make_tracker()
    device.connect()
    device.configure()
    assert unit.baud == unit.unit_baud == 115200


def test_a_rate_the_cable_does_not_carry_is_abandoned_by_a_break_for_a_slower_one(
    make_tracker: Make, unit: Any
) -> None:
    unit.known_bauds["6"] = 921600
    unit.deliver = lambda name, reply: [(0.001, reply if unit.unit_baud < 921600 else b"\xff\x80" * 9)]
    device = make_tracker()
    device.connect()
    device.configure(30.0)
    assert unit.breaks == 1
    assert device.baud == unit.unit_baud == 115200
    device.activate()
    assert device.read_frame().tool("robot_frame").position_mm


def test_a_lost_reply_to_comm_does_not_lose_the_unit(make_tracker: Make, unit: Any) -> None:
    unit.known_bauds = {"0": 9600, "6": 921600}
    unit.deliver = lambda name, reply: [] if name == "COMM" else [(0.001, reply)]
    device = make_tracker()
    device.connect()
    device.configure(20.0)
    assert device.baud == 921600


def test_no_rate_is_negotiated_on_a_link_without_one(make_tracker: Make, unit: Any) -> None:
    unit.__init__(baud=None)
    device = bring_up(make_tracker())
    assert device.baud is None
    device.close()
    assert not any(line.startswith("COMM") for line in unit.commands)


def test_plausible_command_time_limits_from_the_unit_are_adopted(make_tracker: Make, unit: Any) -> None:
    usual = unit._do_get
    said = ["BX=1.5", "TX=9", "GET=0", "INIT=900", "PHSR=soon", "NOPE=3", "TSTOP=7"]
    limits = "\n".join(f"Info.Timeout.{line}" for line in said)
    unit._do_get = lambda name: limits if name == "Info.Timeout.*" else usual(name)
    device = make_tracker(time_limits_s={"TSTOP": 3.0})
    device.connect()
    device.configure()
    unit.set_baud(9600)
    waits = {name: device._link.limit_s(name, 0, 96) for name in ("BX", "TX", "GET", "INIT", "PHSR", "TSTOP")}
    assert waits == pytest.approx({"BX": 1.6, "TX": 9.1, "GET": 8.1, "INIT": 4.1, "PHSR": 2.1, "TSTOP": 3.1})


def test_the_illuminator_rate_is_set_to_60_hz_by_set_or_by_irate(make_tracker: Make, unit: Any) -> None:
    bring_up(make_tracker())
    assert unit.parameters["Param.Tracking.Illuminator Rate"] == "2"
    unit.restart()
    unit.answers_to["SET"] = "ERROR01"
    unit._do_irate = lambda argument: "OKAY"
    device = bring_up(make_tracker())
    assert "IRATE:2" in unit.commands
    assert device.notices == ()


def test_a_unit_that_keeps_its_own_illuminator_rate_is_reported_not_refused(
    make_tracker: Make, unit: Any
) -> None:
    unit.answers_to["SET"] = unit.answers_to["IRATE"] = "ERROR23"
    device = bring_up(make_tracker())
    assert device.notices == ("the illuminators stay at 20 Hz instead of 60 Hz",)
    for _ in range(5):
        unit.frame += 2
        device.read_frame()
    assert device.statistics.missed == 0


def test_handles_left_by_an_earlier_client_are_freed(make_tracker: Make, unit: Any) -> None:
    device = make_tracker()
    device.connect()
    for number in (1, 2, 7):
        unit.handles[number] = {"occupied", "initialised", "enabled"}
    device.configure()
    assert list(unit.handles) == [1]
    assert unit.handles[1] == {"occupied", "initialised", "enabled"}


def test_the_tool_definition_arrives_complete_and_zero_padded(make_tracker: Make, unit: Any) -> None:
    bring_up(make_tracker())
    assert unit.memory[1][580:585] == b"RONNA"
    assert not any(unit.memory[1][752:])


def test_a_pinit_warning_counts_as_success_and_is_reported(make_tracker: Make, unit: Any) -> None:
    usual = unit._do_pinit
    unit._do_pinit = lambda argument: "WARNING05" if usual(argument) == "OKAY" else "ERROR13"
    device = bring_up(make_tracker())
    assert any("wavelength" in note for note in device.notices)


def test_a_tool_with_similar_marker_distances_is_reported(make_tracker: Make, tmp_path: Path) -> None:
    corners = ((0.0, 0.0, 0.0), (50.0, 0.0, 0.0), (50.0, 60.0, 0.0), (0.0, 60.0, 0.0))
    rectangle = planar_tool("BOX", corners, manufacturer="TEST", made_on=date(2025, 1, 1))
    (tmp_path / "box.rom").write_bytes(encode_definition(rectangle))
    device = bring_up(make_tracker(tools=[{"name": "box", "rom": str(tmp_path / "box.rom")}]))
    assert any("50.0 and 50.0 mm" in note for note in device.notices)


def test_a_lost_reply_to_phrq_leaves_no_orphan_handle(make_tracker: Make, unit: Any) -> None:
    lost = iter([True])
    unit.deliver = lambda name, reply: [] if name == "PHRQ" and next(lost, False) else [(0.001, reply)]
    bring_up(make_tracker())
    assert len(unit.handles) == 1


def test_a_dummy_tool_makes_strays_visible_when_no_tools_are_configured(
    make_tracker: Make, unit: Any
) -> None:
    unit.strays = [(0.0, 0.0, -1500.0)]
    frame = bring_up(make_tracker(tools=[])).read_frame()
    assert "PHRQ:*********1**01" in unit.commands
    assert frame.tools == ()
    assert len(frame.strays) == 1

"""A unit is found, identified, set to its baud rate and volume, and its tools are loaded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from polaris_unit_in_process import bring_up, configured

from drivers.ndi_polaris import PolarisTracker
from drivers.ndi_polaris.errors import MalformedReply
from drivers.ndi_polaris.measuring_volume import PUBLISHED_VOLUMES, parse_volumes
from drivers.ndi_polaris.tool_definition import encode_definition, make_planar_tool
from ronna_hw.wire.polaris import PolarisModel

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
    usual = unit.usual("INIT")
    unit.override("INIT", lambda argument: next(refusals, None) or usual(argument))

    def reset(argument: str) -> str:
        unit.restart()
        return "RESET"

    unit.override("RESET", reset)
    unit.initialised = True
    make_tracker().connect()
    assert "RESET:0" in unit.commands
    assert unit.initialised


def test_configure_negotiates_the_fastest_common_rate(make_tracker: Make, unit: Any) -> None:
    device = configured(make_tracker())
    assert unit.unit_baud == unit.baud == device.baud == 115200
    assert [line for line in unit.commands if line.startswith("COMM")][:3] == [
        "COMM:60000",
        "COMM:A0000",
        "COMM:50000",
    ]


def test_the_negotiated_rate_can_be_limited(make_tracker: Make, unit: Any) -> None:
    configured(make_tracker(maximum_baud=38400))
    assert unit.unit_baud == 38400


def test_a_rate_at_which_the_unit_does_not_answer_is_abandoned(make_tracker: Make, unit: Any) -> None:
    usual = unit.usual("COMM")
    # says OKAY to 921600 and stays where it is
    unit.override("COMM", lambda argument: "OKAY" if argument[0] == "6" else usual(argument))
    configured(make_tracker())
    assert unit.baud == unit.unit_baud == 115200


def test_a_rate_the_cable_does_not_carry_is_abandoned_by_a_break_for_a_slower_one(
    make_tracker: Make, unit: Any
) -> None:
    unit.known_bauds["6"] = 921600
    unit.deliver = lambda name, reply: [(0.001, reply if unit.unit_baud < 921600 else b"\xff\x80" * 9)]
    device = configured(make_tracker(), 30.0)
    assert unit.breaks == 1
    assert device.baud == unit.unit_baud == 115200
    device.activate()
    assert device.read_frame().tool("robot_frame").position_mm


def test_a_lost_reply_to_comm_does_not_lose_the_unit(make_tracker: Make, unit: Any) -> None:
    unit.known_bauds = {"0": 9600, "6": 921600}
    unit.deliver = lambda name, reply: [] if name == "COMM" else [(0.001, reply)]
    device = configured(make_tracker(), 20.0)
    assert device.baud == 921600


def test_no_rate_is_negotiated_on_a_link_without_one(make_tracker: Make, unit: Any) -> None:
    unit.__init__(baud=None)
    device = bring_up(make_tracker())
    assert device.baud is None
    device.close()
    assert not any(line.startswith("COMM") for line in unit.commands)


def test_plausible_command_time_limits_from_the_unit_are_adopted(make_tracker: Make, unit: Any) -> None:
    usual = unit.usual("GET")
    said = ["BX=1.5", "TX=9", "GET=0", "INIT=900", "PHSR=soon", "NOPE=3", "TSTOP=7"]
    limits = "\n".join(f"Info.Timeout.{line}" for line in said)
    unit.override("GET", lambda name: limits if name == "Info.Timeout.*" else usual(name))
    device = configured(make_tracker(time_limits_s={"TSTOP": 3.0}))
    unit.set_baud(9600)
    waits = {name: device._link.limit_s(name, 0, 96) for name in ("BX", "TX", "GET", "INIT", "PHSR", "TSTOP")}
    assert waits == pytest.approx({"BX": 1.6, "TX": 9.1, "GET": 8.1, "INIT": 4.1, "PHSR": 2.1, "TSTOP": 3.1})


def test_the_illuminator_rate_is_set_to_60_hz_by_set_or_by_irate(make_tracker: Make, unit: Any) -> None:
    bring_up(make_tracker())
    assert unit.parameters["Param.Tracking.Illuminator Rate"] == "2"
    unit.restart()
    unit.answers_to["SET"] = "ERROR01"
    unit.override("IRATE", lambda argument: "OKAY")
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


def test_a_tool_with_similar_marker_distances_is_reported(make_tracker: Make, tmp_path: Path) -> None:
    corners = ((0.0, 0.0, 0.0), (50.0, 0.0, 0.0), (50.0, 60.0, 0.0), (0.0, 60.0, 0.0))
    rectangle = make_planar_tool("BOX", corners, manufacturer="TEST", made_on=date(2025, 1, 1))
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


ANSWER = (
    "25-240000-153200-095000+057200+039800+056946+024303+029773+999999+99999924\n"
    "5-300000-153200-095000+057200+039800+056946+024303+029773+999999+07350024\n"
)

# half extents (x, y) at depth z, from the published table
SECTIONS = {
    "pyramid": {
        -950: (224.72, 240.57),
        -1532: (398.0, 572.0),
        -2000: (537.34, 685.74),
        -2400: (656.43, 782.95),
    },
    "extended": {-950: (224.72, 240.57), -2664: (735.0, 847.11), -3000: (735.0, 928.77)},
}


@pytest.mark.parametrize(
    ("index", "z", "half_x", "half_y"),
    [
        (index, z, *halves)
        for index, sections in enumerate(SECTIONS.values())
        for z, halves in sections.items()
    ],
)
def test_the_sections_of_both_volumes_have_the_published_size(
    index: int, z: float, half_x: float, half_y: float
) -> None:
    volume = parse_volumes(ANSWER)[index]
    for x, y in ((half_x, half_y), (-half_x, half_y), (half_x, -half_y)):
        assert volume.contains((x * 0.9999, y * 0.9999, z)) is True
        assert volume.contains((x * 1.0005, y * 0.9, z)) is False
        assert volume.contains((x * 0.9, y * 1.0005, z)) is False


def test_points_in_front_of_or_behind_a_volume_are_outside() -> None:
    pyramid, extended = parse_volumes(ANSWER)
    assert pyramid.contains((0, 0, -949)) is False
    assert pyramid.contains((0, 0, -2401)) is False
    assert extended.contains((0, 0, -2401)) is True
    assert extended.contains((0, 0, 1500)) is False


def test_containment_in_a_shape_without_a_known_formula_is_unknown() -> None:
    (volume,) = parse_volumes("1" + ANSWER[1:].split("\n")[0].replace("5-", "7-", 1) + "\n")
    assert volume.contains((0, 0, -1500)) is None


@pytest.mark.parametrize("text", ["", "0", "3" + ANSWER[1:], "1x" + ANSWER[2:80], "25-2400"])
def test_a_malformed_volume_reply_is_refused(text: str) -> None:
    with pytest.raises(MalformedReply):
        parse_volumes(text)


def test_a_record_padded_before_its_line_feed_is_read() -> None:
    assert parse_volumes(ANSWER.replace("\n", "   \n")) == parse_volumes(ANSWER)


def test_a_volumes_faces_bend_at_the_knee_and_where_the_width_is_capped() -> None:
    pyramid, extended = parse_volumes(ANSWER)
    assert [round(z) for z, _, _ in pyramid.sections_mm] == [-950, -1532, -2400]
    assert [round(z) for z, _, _ in extended.sections_mm] == [-950, -1532, -2664, -3000]
    for z, half_x, half_y in (*pyramid.sections_mm, *extended.sections_mm):
        published = {**SECTIONS["pyramid"], **SECTIONS["extended"]}[round(z)]
        assert (half_x, half_y) == pytest.approx(published, abs=0.3)
    assert replace(pyramid, shape="7").sections_mm == ()


def test_a_tracker_has_the_volume_published_for_its_model_until_the_unit_says_its_own(
    make_tracker: Make, unit: Any
) -> None:
    vicra = PUBLISHED_VOLUMES[PolarisModel.VICRA].sections_mm
    assert make_tracker(expected_model="vicra").volume_sections_mm == vicra
    tracker = make_tracker()
    pyramid, extended = (volume.sections_mm for volume in parse_volumes(ANSWER))
    assert tracker.volume_sections_mm == pyramid  # a Spectra, unless another one is expected
    unit.answers_to["SFLIST"] = ANSWER
    unit.parameters["Param.Tracking.Selected Volume"] = "1"
    configured(tracker)
    assert tracker.volume_sections_mm == extended


@pytest.mark.parametrize(("name", "known"), [("Polaris Vega ST", True), ("Polaris Lyra", False)])
def test_a_unit_that_does_not_say_its_volume_has_that_of_the_model_it_says_it_is(
    name: str, known: bool, make_tracker: Make, unit: Any
) -> None:
    unit.answers_to["VER"] = f"{name} Control Firmware"
    unit.answers_to["SFLIST"] = "ERROR25"
    published = PUBLISHED_VOLUMES[PolarisModel.VEGA].sections_mm
    assert configured(make_tracker()).volume_sections_mm == (published if known else ())

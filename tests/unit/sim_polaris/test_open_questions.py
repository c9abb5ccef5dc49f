"""Every behaviour that no public source settles is a parameter, and each parameter takes effect."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import pytest
from coded_errors import raises
from polaris_bench import MakeBench

from ronna_hw.wire.polaris import ReplyOption, SystemStatus
from sim.named_parameters import rows
from sim.polaris.errors import BAD_UNIT_PARAMETER
from sim.polaris.handlers.frame_replies import binary_body, text_reply
from sim.polaris.measurement.frame import MeasuredFrame, Stray
from sim.polaris.unit.behaviour import UnitBehaviour
from sim.polaris.unit.refusal import NdiErrorCode
from sim.world.scene.model import TrackerTool


@pytest.mark.parametrize(
    ("behaviour", "line", "usual", "other"),
    [
        ({"accepts_lower_case": True}, "echo x", "ERROR01", "x"),
        ({"malformed_line_settings": NdiErrorCode.PARAMETER_COUNT}, "COMM Z0000", "ERROR23", "ERROR07"),
        ({"absent_command": NdiErrorCode.UNKNOWN_COMMAND}, "GETIO 01", "ERROR33", "ERROR01"),
        ({"absent_command": NdiErrorCode.UNKNOWN_COMMAND}, "PSTART ", "ERROR33", "ERROR01"),
        ({"unknown_feature_list": NdiErrorCode.NO_FEATURE_LIST}, "SFLIST 77", "ERROR23", "ERROR25"),
        ({"starts_without_tools": False}, "TSTART ", "OKAY", "ERROR12"),
        ({"most_tracked": -1}, "TSTART ", "OKAY", "ERROR28"),
        ({"freeze_tag_with_minor": False}, "VER 0", "Rev 007.000\n", "Rev 007\n"),
        ({"memory_of_passive": "1E/1F"}, "PPRD 010000", "ERROR32", "ERROR1E"),
        ({"memory_of_passive": "1E/1F"}, "PPWR 010000" + "00" * 64, "ERROR32", "ERROR1F"),
    ],
)
def test_a_parameter_can_change_the_answer_to_a_command(
    make_bench: MakeBench, behaviour: dict[str, Any], line: str, usual: str, other: str
) -> None:
    for bench, answer in ((make_bench(), usual), (make_bench(**behaviour), other)):
        bench.send("INIT ")
        bench.send("PHRQ *********1****")
        assert answer in bench.send(line)


@pytest.mark.parametrize(
    ("behaviour", "way", "line", "usual", "other"),
    [
        ({"answers_before_init": False}, "", "GET Features.Hardware.Model", "Features", "ERROR10"),
        ({"answers_before_init": False}, "", "COMM 00000", "OKAY", "ERROR10"),
        ({"identity_while_tracking": False}, "INIT ,TSTART ", "VER 5", "024", "ERROR0C"),
        ({"settings_in_diagnostic": False}, "INIT ,DSTART ", "SFLIST 05", "1", "ERROR0C"),
        ({"settings_in_diagnostic": False}, "INIT ,DSTART ", "SAVE ", "OKAY", "ERROR0C"),
        ({"settings_while_tracking": True}, "INIT ,TSTART ", "SFLIST 05", "ERROR0C", "1"),
        ({"handles_in_diagnostic": True}, "INIT ,DSTART ", "PHSR 00", "ERROR0C", "00"),
        ({"init_forgets_handles": False}, "INIT ,PHRQ *********1****,INIT ", "PHSR 00", "00", "0101001"),
    ],
)
def test_a_parameter_can_change_which_commands_a_mode_allows(
    make_bench: MakeBench, behaviour: dict[str, Any], way: str, line: str, usual: str, other: str
) -> None:
    for bench, answer in ((make_bench(), usual), (make_bench(**behaviour), other)):
        for step in filter(None, way.split(",")):
            bench.send(step)
        assert bench.send(line).startswith(answer)


def test_replies_can_list_disabled_handles(make_bench: MakeBench, pointer: TrackerTool) -> None:
    for status, shown in ((False, "02DISABLED\n"), (True, "02DISABLED00000011")):
        bench = make_bench(lists_disabled_handles=True, status_of_unseen_handles=status).ready()
        bench.enable(pointer)
        bench.enable(pointer)
        bench.send("PDIS 02")
        bench.send("TSTART 80")
        answer = bench.send("TX 0001")
        assert answer.startswith("0201+")
        assert shown in answer
        raw = bench.raw("BX 0003")
        assert raw[6:8] == b"\x02\x01"
        assert raw[6 + 1 + 2 + 32 + 8 + 11 :][:2] == b"\x02\x04"
        assert raw[6 + 1 + 2 + 32 + 8 + 11 + 2 :][:2] == b"\0\0"  # nothing of it, for any option


def test_the_active_stray_of_a_passive_tool_has_two_forms(
    make_bench: MakeBench, pointer: TrackerTool
) -> None:
    for behaviour, text, size in (
        ({}, "02\n", 13),
        ({"text_active_stray": "words", "binary_active_stray_always": False}, "MISSING\n", 1),
    ):
        bench = make_bench(**behaviour).ready().track(pointer)
        assert bench.send("TX 0004") == f"0101{text}0000"
        assert len(bench.raw("BX 0004")) == 6 + 1 + 2 + size + 2 + 2


def test_tool_markers_are_reported_by_bx_and_optionally_by_tx(
    make_bench: MakeBench, pointer: TrackerTool
) -> None:
    bench = make_bench(text_tool_markers=True).ready().track(pointer)
    answer = bench.send("TX 0008")
    assert answer.startswith("0101" + "04" + "0")
    assert len(answer) == 4 + 2 + 1 + 4 * 21 + 1 + 4
    raw = bench.raw("BX 0008")
    assert raw[9:11] == b"\x04\0"
    assert len(raw) == 6 + 1 + 2 + 1 + 1 + 48 + 2 + 2
    usual = make_bench().ready()
    usual.send("TSTART 80")
    assert usual.send("TX 0008") == "ERROR23"


def test_out_of_volume_bits_can_start_at_either_end_of_a_byte() -> None:
    outside, inside = Stray((900.0, 0.0, -1000.0), False), Stray((0.0, 0.0, -1000.0), True)
    frame = MeasuredFrame(1, (), (outside, inside, inside), SystemStatus(0))
    option = ReplyOption.STRAY_PASSIVE
    assert binary_body(frame, option, UnitBehaviour())[1:3] == b"\x03\x01"
    assert binary_body(frame, option, UnitBehaviour(first_stray_is_low_bit=False))[1:3] == b"\x03\x80"
    assert text_reply(frame, option, UnitBehaviour())[2:5] == "034"
    assert text_reply(frame, option, UnitBehaviour(first_stray_is_high_bit=False))[2:5] == "031"


def test_phinf_can_report_the_serial_number_in_either_byte_order(
    make_bench: MakeBench, pointer: TrackerTool
) -> None:
    for number, shown in ((True, "3E000001"), (False, "0100003E")):
        bench = make_bench(serial_low_byte_first=number).ready()
        bench.enable(pointer)
        assert bench.send("PHINF 01")[23:31] == shown


def test_every_parameter_has_a_meaning_and_can_be_set_by_its_name() -> None:
    listed = rows(UnitBehaviour)
    assert [name for name, _, _ in listed] == [entry.name for entry in fields(UnitBehaviour)]
    assert all(len(meaning) > len(name) for name, _, meaning in listed)
    assert UnitBehaviour.parse([f"{name}={value}" for name, value, _ in listed]) == UnitBehaviour()


def test_parameters_are_set_by_text() -> None:
    settings = ["enforces_line=no", "bad_definition=40", "watch_dog=reset", "reset_s=2.5"]
    chosen = UnitBehaviour.parse(settings)
    assert not chosen.enforces_line
    assert chosen.bad_definition is NdiErrorCode.DEFINITION_CORRUPT
    assert (chosen.watch_dog, chosen.reset_s) == ("reset", 2.5)


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("weak_dog=reset", "watch_dog"),
        ("watch_dog=bark", "stop or reset"),
        ("watch_dog", "stop or reset"),
        ("enforces_line=perhaps", "true or false"),
        ("bad_definition=99", "error code"),
        ("reset_s=soon", "a number"),
    ],
)
def test_a_wrong_setting_is_refused_with_its_reason(setting: str, said: str) -> None:
    with raises(BAD_UNIT_PARAMETER, match=said) as refused:
        UnitBehaviour.parse([setting])
    assert refused.value.code == "PSU-001"

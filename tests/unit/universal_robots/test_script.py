"""Our script as the controller gets it: settings at its head, registers as agreed, and no jump."""

from __future__ import annotations

import re

from drivers.universal_robots.controller.script import render_script
from drivers.universal_robots.options import UrOptions, script_settings
from ronna_hw.wire.universal_robots import (
    ORDER_INPUT,
    RUN_INPUT,
    RUN_OUTPUT,
    SCRIPT_NAME,
    SEQUENCE_INPUT,
    SEQUENCE_OUTPUT,
    SET_POINT_INPUTS,
    STATE_OUTPUT,
    UNCHANGED_OUTPUT,
    ScriptState,
)

SETTINGS = script_settings(UrOptions())
SCRIPT = render_script(SETTINGS)


def test_every_setting_is_one_line_at_the_head() -> None:
    assert SCRIPT.startswith(f"def {SCRIPT_NAME}():\n")
    head = SCRIPT.partition("WAITING")[0]
    for name, value in SETTINGS._asdict().items():
        found = re.findall(rf"^  {name} = (\S+)$", head, re.MULTILINE)
        assert [round(float(text), 6) for text in found] == [round(value, 6)], name


def test_the_registers_are_those_of_the_vocabulary() -> None:
    used = {int(number) for number in re.findall(r"read_input_integer_register\((\d+)\)", SCRIPT)}
    assert {f"input_int_register_{number}" for number in used} == {SEQUENCE_INPUT, ORDER_INPUT, RUN_INPUT}
    read = re.findall(r"read_input_float_register\((\d+)\)", SCRIPT)
    assert tuple(f"input_double_register_{number}" for number in read) == SET_POINT_INPUTS
    written = {int(number) for number in re.findall(r"write_output_integer_register\((\d+),", SCRIPT)}
    outputs = {SEQUENCE_OUTPUT, STATE_OUTPUT, RUN_OUTPUT, UNCHANGED_OUTPUT}
    assert {f"output_int_register_{number}" for number in written} == outputs
    for state in ScriptState:
        assert state is ScriptState.NONE or f"  {state.name} = {state.value}\n" in SCRIPT
    assert f'rtde_set_watchdog("{SEQUENCE_INPUT}", 10, "stop")' in SCRIPT


def test_blocks_are_balanced_and_the_script_is_plain_ascii_that_ends() -> None:
    lines = [line.partition("#")[0].strip() for line in SCRIPT.splitlines()]
    opened = sum(line.startswith(("def ", "while ", "if ")) for line in lines)
    assert opened == sum(line == "end" for line in lines)
    assert SCRIPT.isascii()
    assert SCRIPT.endswith("end\n")
    assert len(lines) < 80


def test_a_payload_is_set_only_where_it_is_given() -> None:
    assert "set_payload" not in SCRIPT
    assert "\n  set_payload(1.25)\n" in render_script(SETTINGS, ("set_payload(1.25)",))

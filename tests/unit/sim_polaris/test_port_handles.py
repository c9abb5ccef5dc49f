"""Port handles: PHRQ, PHSR, PHF, PVWR, PINIT, PENA, PDIS, PHINF."""

from __future__ import annotations

import pytest
from polaris_bench import Bench, MakeBench

from sim.polaris.unit.model import SPECTRA, VICRA, UnitModel
from sim.polaris.unit.tool_definition import write_definition
from sim.world.scene.model import TrackerTool

BLOCK = "00" * 64
ANY_PASSIVE = "PHRQ *********1****"


def test_handles_are_distinct_and_a_freed_one_is_reused(bench: Bench) -> None:
    assert [bench.send(ANY_PASSIVE) for _ in range(3)] == ["01", "02", "03"]
    assert bench.send("PHF 02") == "OKAY"
    assert bench.send("PHF 02") == "ERROR2B"
    assert bench.send("PHRQ ********01****") == "02"


def test_handles_run_out(bench: Bench) -> None:
    answers = [bench.send(ANY_PASSIVE) for _ in range(25)]
    assert answers[23:] == ["18", "ERROR2D"]


@pytest.mark.parametrize(
    "argument", ["*********004**", "*********0**02", "*********1GG**", "*********101**", "********11****"]
)
def test_ports_that_the_unit_does_not_have_are_refused(bench: Bench, argument: str) -> None:
    assert bench.send(f"PHRQ {argument}") == "ERROR2F"


@pytest.mark.parametrize(
    ("argument", "answer"),
    [
        ("010000" + BLOCK, "OKAY"),
        ("0107C0" + BLOCK, "OKAY"),
        ("0107c0" + "fF" * 64, "OKAY"),
        ("010800" + BLOCK, "ERROR23"),
        ("010001" + BLOCK, "ERROR23"),
        ("01zzzz" + BLOCK, "ERROR23"),
        ("010000" + "g" * 128, "ERROR23"),
        ("010000" + BLOCK[:-2], "ERROR07"),
        ("020000" + BLOCK, "ERROR2B"),
        ("xx0000" + BLOCK, "ERROR08"),
    ],
)
def test_tool_memory_is_written_in_whole_blocks_of_hex_in_either_case(
    bench: Bench, argument: str, answer: str
) -> None:
    bench.send(ANY_PASSIVE)
    assert bench.send(f"PVWR {argument}") == answer


def test_a_port_without_a_definition_cannot_be_initialised_or_enabled(bench: Bench) -> None:
    bench.send(ANY_PASSIVE)
    assert bench.send("PINIT 01") == "ERROR0D"
    assert bench.send("PENA 01D") == "ERROR0E"
    assert bench.send("PDIS 01") == "ERROR0E"


def test_a_tool_that_is_not_enabled_cannot_be_disabled(bench: Bench, pointer: TrackerTool) -> None:
    bench.load(write_definition(pointer))
    assert bench.send("PINIT 01") == "OKAY"
    assert bench.send("PINIT 01") == "OKAY"
    assert bench.send("PDIS 01") == "ERROR0F"


@pytest.mark.parametrize(("model", "tools"), [(SPECTRA, 15), (VICRA, 6)])
def test_no_more_tools_are_enabled_than_the_unit_tracks(
    make_bench: MakeBench, pointer: TrackerTool, model: UnitModel, tools: int
) -> None:
    bench = make_bench(model=model).ready()
    for _ in range(tools):
        bench.enable(pointer)
    handle = bench.load(write_definition(pointer))
    bench.send(f"PINIT {handle:02X}")
    assert bench.send(f"PENA {handle:02X}D") == "ERROR28"
    assert bench.send("PENA 01S") == "OKAY"  # enabled already


def test_port_information_copies_the_definition(bench: Bench, pointer: TrackerTool) -> None:
    bench.enable(pointer)
    basic = bench.send("PHINF 01")
    assert basic == "01000000RONNA       0003E00000131"
    assert len(basic) == 33
    assert bench.send("PHINF 010004") == "8700340".ljust(20)
    assert bench.send("PHINF 010002") == "00000000"
    assert bench.send("PHINF 010010") == "29"
    assert len(bench.send("PHINF 010025")) == 67
    assert bench.send("PHINF 010025").startswith(basic + "8700340".ljust(20))


@pytest.mark.parametrize(
    ("argument", "answer"), [("0100", "ERROR07"), ("010080", "ERROR23"), ("02", "ERROR2B"), ("zz", "ERROR08")]
)
def test_phinf_arguments_are_checked(bench: Bench, argument: str, answer: str) -> None:
    bench.send(ANY_PASSIVE)
    assert bench.send(f"PHINF {argument}") == answer


def test_before_pinit_only_the_status_is_known(bench: Bench) -> None:
    bench.send(ANY_PASSIVE)
    basic = bench.send("PHINF 010001")
    assert len(basic) == 33
    assert basic.endswith("0000000001")


def test_a_dummy_tool_needs_no_definition_and_excludes_real_tools(bench: Bench, pointer: TrackerTool) -> None:
    assert bench.send("PHRQ *********1**01") == "01"
    assert bench.send("PVWR 010000" + BLOCK) == "ERROR32"
    assert bench.send("PINIT 01") == "OKAY"
    assert bench.send("PENA 01D") == "OKAY"
    bench.enable(pointer)
    assert bench.send("TSTART 80") == "ERROR12"
    bench.send("PDIS 02")
    assert bench.send("TSTART 80") == "OKAY"
    answer = bench.send("TX 1801")
    assert answer.startswith("0101MISSING00000031")
    assert answer.split("\n")[1].startswith("030")

"""A few mutants for every parser of external input; the full million is in tests/soak."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from bounded_cost import bounded_cost
from good_inputs import PARSER_NAMES
from hostile_inputs import Parser, feed, parsers, taken
from memory_folder import memory_folder

from ronna_hw.bounded_input import InputRefused
from sim.world.world import World

FEW = 40
REFUSING = ("Polaris BX", "Polaris .rom", "EKI", "RSI", "RSI reply")  # most mutants are none of theirs
ON_THE_WIRE = {  # parsers that take some microseconds
    **dict.fromkeys((*REFUSING, "GVCP", "GVSP", "conformance BX"), 4000),
    "Polaris text": 1000,
}


@pytest.mark.parametrize("chained", [True, False])
def test_a_refusal_because_of_the_harness_bound_on_memory_is_none(chained: bool) -> None:
    def take(_data: bytes) -> None:
        try:
            raise MemoryError
        except MemoryError as error:
            if chained:
                raise InputRefused("it cannot be read") from error
            raise InputRefused("it cannot be read")  # noqa: B904 - as third parties do

    with pytest.raises(AssertionError, match="it cannot be read"):
        taken(Parser((b"",), take), b"")


@pytest.fixture(scope="module")
def all_parsers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Parser]]:
    with memory_folder(tmp_path_factory.mktemp("hostile")) as folder:
        yield parsers(folder)


def test_a_mistake_of_ours_in_the_room_is_no_refusal(
    all_parsers: dict[str, Parser], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(World, "mount_tool", lambda *_: next(iter(())))
    room = all_parsers["room"]
    with pytest.raises(AssertionError, match="the simulator failed"):
        taken(room, room.good[0])
    assert "StopIteration" in capsys.readouterr().err


@pytest.mark.parametrize("name", PARSER_NAMES)
def test_a_parser_accepts_valid_input_and_reads_or_refuses_mutants(
    all_parsers: dict[str, Parser], name: str
) -> None:
    parser = all_parsers[name]
    for good in parser.good:
        parser.take(good)
    count = ON_THE_WIRE.get(name, FEW)
    with bounded_cost():
        read = feed(parser, count, seed=1)
    if name in REFUSING:
        assert 0 < read < 0.6 * count

"""The command interpreter: frames measured and encoded once, and RESET sent unprompted after a restart."""

from __future__ import annotations

from typing import Any

import pytest
from polaris_bench import Bench, MakeBench

from ronna_hw.wire.polaris import COMMAND_TIMEOUT_S, PVWR_BLOCK_BYTES, PVWR_SPACE_BYTES
from sim.polaris.handlers.table import COMMANDS
from sim.world.scene.model import TrackerTool

FRAME_NS = 1_000_000_000 // 60


@pytest.fixture
def counted(
    make_bench: MakeBench, pointer: TrackerTool, monkeypatch: pytest.MonkeyPatch
) -> tuple[Bench, list[int], list[int]]:
    """A tracking bench, its time in ns, set by hand, and the numbers of the frames measured."""
    bench = make_bench(paced=True)
    now_ns, measured = [0], []
    monkeypatch.setattr(bench.world.clock, "now_ns", lambda: now_ns[0])
    measure = bench.unit.measurer.frame

    def counting(number: int, *rest: Any) -> Any:
        measured.append(number)
        return measure(number, *rest)

    monkeypatch.setattr(bench.unit.measurer, "frame", counting)
    bench.send("INIT ")
    bench.track(pointer)
    return bench, now_ns, measured


def test_a_frame_is_measured_once_for_any_number_of_tx_and_bx_requests(
    counted: tuple[Bench, list[int], list[int]],
) -> None:
    bench, now_ns, measured = counted
    for frame in range(3):
        now_ns[0] = frame * FRAME_NS + FRAME_NS // 2
        answers = {bench.raw(line) for line in ("TX 1801", "BX 1801", "TX:1801" + "3D9A") for _ in range(50)}
        assert len(answers) == 2
    assert measured == [0, 1, 2]


def test_a_repeated_reply_is_encoded_once(
    counted: tuple[Bench, list[int], list[int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    bench, now_ns, _ = counted
    first = bench.raw("BX 1801")
    monkeypatch.setattr("sim.polaris.handlers.tracking.binary_body", None)  # fails if called
    assert {bench.raw("BX 1801") for _ in range(20)} == {first}
    now_ns[0] += FRAME_NS + 1
    with pytest.raises(TypeError):
        bench.raw("BX 1801")


def test_a_changed_setting_shows_in_the_same_frame(counted: tuple[Bench, list[int], list[int]]) -> None:
    bench, _, _ = counted
    assert "MISSING" not in bench.send("TX 0001")
    bench.send(f"SET Param.Simulated Alerts={1 << 21}")
    assert bench.send("TX 0001").endswith("0100")


def test_the_whole_virtual_memory_can_be_written_in_blocks(bench: Bench) -> None:
    bench.send("PHRQ *********1****")
    for address in range(0, PVWR_SPACE_BYTES, PVWR_BLOCK_BYTES):
        assert bench.send(f"PVWR 01{address:04X}{'aB' * PVWR_BLOCK_BYTES}") == "OKAY"
    assert bench.send("PINIT 01") == "ERROR13"


@pytest.mark.parametrize("name", sorted({*COMMAND_TIMEOUT_S, "GX", "IRINIT", "IRCHK", "VCAP"}))
def test_every_vendor_command_is_known(bench: Bench, name: str) -> None:
    assert name in COMMANDS
    assert not bench.raw(f"{name} ").startswith(b"ERROR01")

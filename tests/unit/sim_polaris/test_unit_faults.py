"""Replies of the tracker while the unit itself has a fault."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import pytest
from polaris_bench import Bench, MakeBench

from sim.polaris.unit.tool_definition import write_definition
from sim.world.scene.model import TrackerTool


def system_status(bench: Bench) -> str:
    return bench.send("TX 0801")[-4:]


def frame_numbers(bench: Bench, count: int) -> list[int]:
    return [int(bench.send("TX 0001").split("\n")[0][-8:], 16) for _ in range(count)]


def test_a_bump_withholds_poses_until_the_alert_is_read_and_is_kept_until_cleared(tracked: Bench) -> None:
    tracked.disturb("bump")
    for _ in range(3):
        answer = tracked.send("TX 0801")
        assert answer.startswith("0101MISSING")
        assert answer.endswith("0100")
    assert tracked.value("Info.Status.Alerts") == str(1 << 21)
    assert tracked.value("Param.Bump Detector.Bumped") == "1"
    assert tracked.value("Info.Status.New Alerts") == str(1 << 21)
    answer = tracked.send("TX 0801")
    assert "MISSING" not in answer
    assert answer.endswith("0000")
    assert tracked.value("Param.Bump Detector.Bumped") == "1"
    assert tracked.send("SET Param.Bump Detector.Clear=1") == "OKAY"
    assert tracked.value("Info.Status.Alerts") == "0"
    assert tracked.value("Param.Bump Detector.Bumped") == "0"
    assert [system_status(tracked) for _ in range(5)] == ["0000"] * 5  # it does not recur


@pytest.mark.parametrize(("fault", "bit"), [("hot", 29), ("cold", 30)])
def test_a_unit_that_is_too_hot_or_too_cold_gives_no_poses(tracked: Bench, fault: str, bit: int) -> None:
    tracked.world.set_fault_script(f"at 0.1 s: tracker {fault} for 0.2 s")
    assert system_status(tracked) == "0000"
    tracked.world.clock.sleep(0.1)
    assert tracked.send("TX 0801").startswith("0101MISSING")
    assert system_status(tracked) == "0300"  # and an alert that nobody has read
    assert tracked.value("Info.Status.New Alerts") == str(1 << bit)
    assert system_status(tracked) == "0200"
    tracked.world.clock.sleep(0.2)
    assert "MISSING" not in tracked.send("TX 0801")
    assert tracked.value("Info.Status.Alerts") == "0"


def test_a_hardware_fault_shows_in_tstart_init_alerts_and_system_status(
    bench: Bench, pointer: TrackerTool
) -> None:
    bench.enable(pointer)
    bench.disturb("alert 5")
    assert bench.send("TSTART 80") == "ERROR12"
    assert bench.send("INIT ") == "WARNING01"
    assert bench.value("Info.Status.Alerts") == str(1 << 5)
    bench.disturb()
    bench.track(pointer)
    bench.disturb("alert 0")
    bench.send("TX 0801")
    assert bench.value("Info.Status.New Alerts") == str(1 << 0 | 1 << 5)  # both are news
    assert system_status(bench) == "0010"
    assert bench.send("TX 0801").startswith("0101MISSING")


@pytest.mark.parametrize("answer", ["ERROR15", "ERROR1A"])
def test_a_unit_with_a_hardware_fault_may_refuse_to_initialise(make_bench: MakeBench, answer: str) -> None:
    bench = make_bench(hardware_fault_at_init=answer)
    bench.disturb("alert 1")
    assert bench.send("INIT ") == answer
    assert bench.send("PHSR 00") == "ERROR10"


def test_a_watchdog_timeout_ends_tracking(tracked: Bench) -> None:
    tracked.disturb("watchdog")
    assert tracked.send("TX 0801") == "ERROR0C"
    assert tracked.send("TSTART ") == "OKAY"
    assert "MISSING" not in tracked.send("TX 0801")


def test_the_plug_fault_connects_a_wired_tool_for_its_duration(tracked: Bench) -> None:
    tracked.world.set_fault_script("at 0.5 s: tracker plug 2 for 1 s")
    tracked.world.clock.sleep(0.5)
    assert system_status(tracked) == "0040"
    tracked.send("TSTOP ")
    assert tracked.send("PHSR 02").startswith("0102")
    assert tracked.send("PINIT 02") == "OKAY"
    assert tracked.send("PENA 02D") == "OKAY"
    tracked.send("TSTART ")
    assert tracked.send("TX 0801").startswith("02")
    tracked.world.clock.sleep(1.0)
    answer = tracked.send("TX 0801")
    assert "02UNOCCUPIED\n" in answer
    assert answer.endswith("0080")
    tracked.send("TSTOP ")
    assert tracked.send("PHSR 01").startswith("0102")


def test_a_corrupt_definition_is_refused(bench: Bench, pointer: TrackerTool) -> None:
    bench.disturb("corrupt definitions")
    handle = bench.load(write_definition(pointer))
    assert bench.send(f"PINIT {handle:02X}") == "ERROR13"
    assert bench.send(f"PENA {handle:02X}D") == "ERROR0E"


def test_a_unit_allows_no_more_tools_and_handles_than_the_fault_permits(
    bench: Bench, pointer: TrackerTool
) -> None:
    bench.disturb("allow 1 tools", "allow 2 handles")
    bench.enable(pointer)
    second = bench.load(write_definition(pointer))
    bench.send(f"PINIT {second:02X}")
    assert bench.send(f"PENA {second:02X}D") == "ERROR28"
    assert bench.send("PHRQ *********1****") == "ERROR2D"


def test_tracking_does_not_start_with_a_volume_for_another_wavelength(
    bench: Bench, pointer: TrackerTool
) -> None:
    bench.enable(pointer)
    bench.disturb("wrong wavelength")
    assert bench.send("TSTART 80") == "ERROR22"
    bench.disturb()
    assert bench.send("TSTART 80") == "OKAY"


@pytest.mark.parametrize(("name", "seconds"), [("INIT", 4.0), ("PINIT", 6.0), ("TSTART", 6.0)])
def test_a_slow_command_takes_the_set_time(
    bench: Bench, pointer: TrackerTool, name: str, seconds: float
) -> None:
    handle = bench.load(write_definition(pointer))
    bench.disturb(f"slow {name} {seconds} s")
    took = {}
    for line in (f"PINIT {handle:02X}", f"PENA {handle:02X}D", "TSTART 80", "TSTOP ", "INIT "):
        began_s = bench.world.clock.now_s()
        assert not bench.send(line).startswith("ERROR")
        took[line.split()[0]] = bench.world.clock.now_s() - began_s
    assert took[name] == pytest.approx(seconds)
    assert all(duration_s < 0.1 for other, duration_s in took.items() if other != name)


def test_a_unit_that_measures_nothing_new_repeats_its_frame(tracked: Bench) -> None:
    tracked.world.set_fault_script("at 0.1 s: tracker repeat frames for 0.5 s")
    answers = [tracked.raw("BX 1801") for _ in range(60)]
    numbers = frame_numbers(tracked, 1)
    assert numbers[0] > 30  # the time has passed, though it measured only some of it
    assert 25 <= max(answers.count(answer) for answer in answers) <= 35
    assert len(set(answers)) >= 25


def test_skipped_frames_leave_gaps_in_the_frame_numbers(tracked: Bench) -> None:
    first = frame_numbers(tracked, 3)
    tracked.disturb("skip 4 frames")
    jumping = frame_numbers(tracked, 4)
    assert first == [1, 2, 3]
    assert [after - before for before, after in pairwise(jumping)] == [5, 5, 5]
    tracked.disturb()
    assert frame_numbers(tracked, 2)[1] - jumping[-1] == 2


def test_restarted_tracking_skips_no_more_frames(tracked: Bench) -> None:
    tracked.disturb("skip 4 frames")
    frame_numbers(tracked, 2)
    tracked.disturb()
    assert tracked.send("TSTOP ") == tracked.send("TSTART 80") == "OKAY"
    assert frame_numbers(tracked, 3) == [1, 2, 3]


def test_a_unit_without_power_is_silent_and_sends_reset_when_power_returns(
    tracked: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    moments = later()
    monkeypatch.setattr("sim.polaris.line.interpreter.time.monotonic", lambda: next(moments))
    assert tracked.send("COMM 50000") == "OKAY"
    tracked.world.set_fault_script("at 1 s: tracker power off for 2 s")
    tracked.world.clock.sleep(1.0)
    assert tracked.raw("TX 0801") == b""
    assert tracked.raw("INIT ") == b""
    assert tracked.interpreter.unsolicited_bytes() == b""
    tracked.world.clock.sleep(2.0)
    assert first_words(tracked) == b"RESETBE6F\r"
    assert tracked.interpreter.reply_line.baud == 9600
    assert tracked.send("TX 0801") == "ERROR10"
    assert tracked.send("INIT ") == "OKAY"
    assert tracked.send("PHSR 00") == "00"


def test_a_restarted_unit_sends_reset_once_and_requires_init(
    tracked: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    moments = later()
    monkeypatch.setattr("sim.polaris.line.interpreter.time.monotonic", lambda: next(moments))
    tracked.disturb("restart")
    assert tracked.raw("TX 0801") == b""
    assert first_words(tracked) == b"RESETBE6F\r"
    assert tracked.send("PHSR 00") == "ERROR10"
    assert tracked.interpreter.unsolicited_bytes() == b""  # once


def later() -> Iterator[float]:
    """Host times, 10 ms apart."""
    moment = 100.0
    while True:
        yield moment
        moment += 0.01


def first_words(bench: Bench) -> bytes:
    """First bytes that the unit sends unsolicited."""
    for _ in range(1000):
        if said := bench.interpreter.unsolicited_bytes():
            return said
    return b""

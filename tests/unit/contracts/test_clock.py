import mmap
import os
import select
import socket
import threading
from collections.abc import Iterator

import pytest

from ronna_hw.clock import (
    CLOCK,
    FOR_READER,
    FOR_TURN,
    STANDING_CYCLE_NS,
    TURN_NS,
    ClockUnavailable,
    SharedClock,
    open_clock,
)

CYCLE_NS = 4_000_000


def _block(paced: bool) -> tuple[int, str]:
    file = os.memfd_create("clock")
    os.ftruncate(file, CLOCK.size_bytes)
    with mmap.mmap(file, CLOCK.size_bytes) as memory:
        SharedClock.initialise(memory, paced=paced)
    return file, f"/proc/{os.getpid()}/fd/{file}"


@pytest.fixture
def path() -> Iterator[str]:
    file, path = _block(paced=False)
    yield path
    os.close(file)


def test_a_wait_advances_the_time_for_all_while_nothing_streams(path: str) -> None:
    one, other = SharedClock(path), SharedClock(path)
    one.sleep(1.5)
    assert other.now_s() == 1.5


def test_only_the_cycles_of_a_streaming_device_advance_the_time(path: str) -> None:
    robot, camera = SharedClock(path), SharedClock(path)
    robot.advance_cycle(CYCLE_NS)
    waited = threading.Event()

    def wait() -> None:
        camera.wait_until_ns(4 * CYCLE_NS)
        waited.set()

    threading.Thread(target=wait, daemon=True).start()
    while not robot.has_waiters():
        pass
    assert robot.now_ns() == CYCLE_NS
    for _ in range(3):
        robot.advance_cycle(CYCLE_NS)
    assert waited.wait(5.0)
    assert not robot.has_waiters()


def test_a_wait_advances_the_time_again_after_the_stream_ends(path: str) -> None:
    robot = SharedClock(path)
    robot.advance_cycle(CYCLE_NS)
    robot.end_stream()
    SharedClock(path).sleep(1.0)
    assert robot.now_ns() == CYCLE_NS + 1_000_000_000


def test_a_paced_clock_follows_the_host() -> None:
    file, path = _block(paced=True)
    clock = SharedClock(path)
    before = clock.now_ns()
    clock.advance_cycle(10**12)
    assert before <= clock.now_ns() < before + 10**12
    os.close(file)


def test_a_file_that_is_not_a_clock_is_refused(tmp_path: object) -> None:
    file = os.memfd_create("not a clock")
    os.ftruncate(file, CLOCK.size_bytes)
    with pytest.raises(ClockUnavailable, match=r"CLK-001.* --continue where a run is to go on"):
        open_clock(f"shm:///proc/{os.getpid()}/fd/{file}")
    os.close(file)


@pytest.mark.parametrize("path", ["/proc/self/fd/9999", "/a\0b"], ids=["gone", "no path"])
def test_a_clock_that_cannot_be_opened_is_refused(path: str) -> None:
    with pytest.raises(ClockUnavailable):
        SharedClock(path)


def test_cycles_wait_for_the_reader_of_a_measurement_until_it_waits(path: str) -> None:
    robot, tracker = SharedClock(path), SharedClock(path)
    robot.advance_cycle(CYCLE_NS)
    assert not robot.must_wait_for_reader(CYCLE_NS)  # nobody reads
    tracker.expect_reader(3 * CYCLE_NS)
    assert not robot.must_wait_for_reader(CYCLE_NS)  # it is not due yet
    robot.advance_cycle(CYCLE_NS)
    assert robot.must_wait_for_reader(CYCLE_NS)
    waiting = threading.Thread(target=tracker.wait_until_ns, args=(3 * CYCLE_NS,), daemon=True)
    waiting.start()
    while robot.must_wait_for_reader(CYCLE_NS):
        pass
    robot.advance_cycle(CYCLE_NS)
    waiting.join(5.0)
    tracker.expect_reader(0)
    assert not robot.must_wait_for_reader(CYCLE_NS)


def test_the_wish_of_an_interrupted_process_ends_by_itself(
    path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, camera = SharedClock(path), SharedClock(path)
    robot.advance_cycle(CYCLE_NS)

    def interrupt(_seconds: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("ronna_hw.clock.time.sleep", interrupt)
    with pytest.raises(KeyboardInterrupt):
        camera.wait_until_ns(10**15)
    assert robot.has_waiters()
    for _ in range(3_000_000_000 // CYCLE_NS):
        robot.advance_cycle(CYCLE_NS)
    assert not robot.has_waiters()


def test_a_resting_device_is_woken_by_a_wait_and_by_time_that_may_pass(path: str) -> None:
    robot, camera = SharedClock(path), SharedClock(path)
    robot.advance_cycle(CYCLE_NS)
    with robot.open_alarm() as alarm:
        with robot.rest(alarm):
            assert not robot.may_pass()
            camera.let_pass(0.003)
            assert select.select([alarm], (), (), 5.0)[0]
            robot.silence(alarm)
        assert robot.may_pass()
        assert not robot.has_waiters()  # cycles still wait for the reader of a measurement
        robot.advance_cycle(CYCLE_NS)
        assert not robot.may_pass()
        camera.let_pass(1.0)
        camera.hold_back()
        assert not robot.may_pass()
        with robot.rest(alarm):
            waiting = threading.Thread(target=camera.wait_until_ns, args=(3 * CYCLE_NS,), daemon=True)
            waiting.start()
            assert select.select([alarm], (), (), 5.0)[0]
            robot.silence(alarm)
        assert robot.may_pass()
        robot.advance_cycle(CYCLE_NS)
        waiting.join(5.0)
        camera.let_pass(1.0)  # while nobody rests
        with robot.rest(alarm):
            assert not select.select([alarm], (), (), 0.0)[0]


def test_a_device_that_rests_for_a_reader_is_woken_by_its_request_and_its_next_measurement(path: str) -> None:
    robot, tracker = SharedClock(path), SharedClock(path)
    robot.advance_cycle(CYCLE_NS)
    with robot.open_alarm() as alarm:
        tracker.expect_reader(2 * CYCLE_NS)
        with robot.rest(alarm, FOR_READER):
            assert robot.must_wait_for_reader(CYCLE_NS)
            waiting = threading.Thread(target=tracker.wait_until_ns, args=(2 * CYCLE_NS,), daemon=True)
            waiting.start()
            assert select.select([alarm], (), (), 5.0)[0]
            robot.silence(alarm)
        assert not robot.must_wait_for_reader(CYCLE_NS)
        robot.advance_cycle(CYCLE_NS)
        waiting.join(5.0)
        with robot.rest(alarm, FOR_READER):
            assert robot.must_wait_for_reader(CYCLE_NS)  # the measurement is not taken yet
            tracker.expect_reader(4 * CYCLE_NS)
            assert select.select([alarm], (), (), 5.0)[0]
            robot.silence(alarm)
        assert not robot.must_wait_for_reader(CYCLE_NS)
        with robot.rest(alarm):  # time may not pass for it
            tracker.expect_reader(6 * CYCLE_NS)
            assert not select.select([alarm], (), (), 0.0)[0]


def test_a_strangers_call_wakes_a_resting_device_and_lets_no_time_pass(path: str) -> None:
    robot = SharedClock(path)
    robot.advance_cycle(CYCLE_NS)
    with robot.open_alarm() as alarm, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as stranger:
        with robot.rest(alarm):
            stranger.sendto(b"x" * 1000, alarm.getsockname())
            assert select.select([alarm], (), (), 5.0)[0]
            robot.silence(alarm)
            assert not robot.may_pass()
        assert not select.select([alarm], (), (), 0.0)[0]
    assert robot.now_ns() == CYCLE_NS


def test_time_that_may_pass_stands_still_while_nothing_streams(path: str) -> None:
    clock = SharedClock(path)
    clock.let_pass(1.0)
    assert clock.now_ns() == 0
    clock.sleep(0.5)
    assert clock.now_s() == 0.5


@pytest.fixture
def arms(path: str) -> tuple[SharedClock, SharedClock]:
    """Two cyclic devices that have come equally far."""
    master, assistant = SharedClock(path, 0), SharedClock(path, 1)
    assistant.advance_cycle(CYCLE_NS)
    master.advance_cycle(CYCLE_NS)  # it begins at the time of the other
    assistant.advance_cycle(CYCLE_NS)
    assert master.now_ns() == 2 * CYCLE_NS
    return master, assistant


def _run_turn(device: SharedClock, limit_ns: int = 4 * TURN_NS) -> int:
    """Run cycles until the turn is another's; returns the theatre time that they took, ns."""
    ran_ns = 0
    while not device.must_wait_for_turn() and ran_ns < limit_ns:
        device.advance_cycle(CYCLE_NS)
        ran_ns += CYCLE_NS
    return ran_ns


def test_two_streaming_devices_take_turns(arms: tuple[SharedClock, SharedClock]) -> None:
    master, assistant = arms
    began_ns = master.now_ns()
    assert assistant.must_wait_for_turn()
    assert _run_turn(master) == TURN_NS
    assert master.now_ns() == began_ns
    assert _run_turn(assistant) == 2 * TURN_NS
    assert master.now_ns() == began_ns + TURN_NS
    assert _run_turn(master) == 2 * TURN_NS


def test_a_device_at_the_end_of_its_turn_wakes_the_other(arms: tuple[SharedClock, SharedClock]) -> None:
    master, assistant = arms
    with assistant.open_alarm() as alarm, assistant.rest(alarm):
        assert not assistant.may_pass()
        _run_turn(master)
        assert select.select([alarm], (), (), 5.0)[0]
        assert assistant.may_pass()


def test_a_device_that_rests_leaves_its_turn_to_the_other(arms: tuple[SharedClock, SharedClock]) -> None:
    master, assistant = arms
    with (
        assistant.open_alarm() as alarm,
        master.open_alarm() as masters_alarm,
        assistant.rest(alarm, FOR_TURN),
        master.rest(masters_alarm),
    ):
        assert select.select([alarm], (), (), 5.0)[0]
        assert _run_turn(assistant) == TURN_NS
        assert master.may_pass()


def test_a_device_that_stands_takes_longer_cycles_while_the_other_moves(
    arms: tuple[SharedClock, SharedClock],
) -> None:
    master, assistant = arms
    began_ns = master.now_ns()
    master.advance_cycle(CYCLE_NS, stands=True)
    assert master.must_wait_for_turn()  # far ahead of the other after one cycle
    assert _run_turn(assistant, limit_ns=STANDING_CYCLE_NS) == STANDING_CYCLE_NS
    assert assistant.now_ns() == began_ns + STANDING_CYCLE_NS


def test_a_device_that_stands_alone_takes_the_cycles_of_a_wait_at_once(path: str) -> None:
    robot, camera = SharedClock(path), SharedClock(path)
    robot.advance_cycle(CYCLE_NS)
    awaited_ns = 2 * TURN_NS + CYCLE_NS // 2  # within a cycle: the time ends with that cycle
    waiting = threading.Thread(target=camera.wait_until_ns, args=(awaited_ns,), daemon=True)
    waiting.start()
    while not robot.has_waiters():
        pass
    ends_ns = []
    while robot.has_waiters():
        ends_ns.append(robot.advance_cycle(CYCLE_NS, stands=True))
    assert ends_ns == [CYCLE_NS + TURN_NS, 2 * TURN_NS + CYCLE_NS]
    waiting.join(5.0)


def test_a_device_that_stands_takes_single_cycles_while_somebody_counts_them(path: str) -> None:
    robot, camera = SharedClock(path), SharedClock(path)
    robot.advance_cycle(CYCLE_NS)
    robot.let_pass(1.0)
    waiting = threading.Thread(target=camera.wait_until_ns, args=(2 * CYCLE_NS,), daemon=True)
    waiting.start()
    while not robot.has_waiters():
        pass
    assert robot.advance_cycle(CYCLE_NS, stands=True) == 2 * CYCLE_NS
    waiting.join(5.0)
    assert robot.advance_cycle(CYCLE_NS, stands=True) == 3 * CYCLE_NS


def test_where_both_stand_neither_takes_all_its_cycles(
    arms: tuple[SharedClock, SharedClock],
) -> None:
    cycles, began_ns = [0, 0], arms[0].now_ns()
    while arms[0].now_ns() < began_ns + 100 * TURN_NS:
        for number, device in enumerate(arms):
            if not device.must_wait_for_turn():
                device.advance_cycle(CYCLE_NS, stands=True)
                cycles[number] += 1
    first, second = cycles
    assert first < 200  # of 300: single ones only while the other does not wait for it
    assert second <= 100  # one in each turn


def test_a_device_that_ends_its_stream_holds_no_other_up(arms: tuple[SharedClock, SharedClock]) -> None:
    master, assistant = arms
    _run_turn(master)
    assert master.must_wait_for_turn()
    assistant.end_stream()
    assert not master.must_wait_for_turn()

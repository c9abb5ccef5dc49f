"""A stream gives readings as the device makes them: the newest, or every one, in a loop, a call or a task."""

from __future__ import annotations

import asyncio
import sys
import threading
from collections.abc import Callable
from itertools import islice

import pytest
from coded_errors import raises
from waiting import eventually

from ronna_hw.arguments import WrongArgument
from ronna_hw.devices.errors import CALL_GOES_ON, DEVICE_STREAMS, NO_NEW_STATE, STREAM_BEHIND, STREAM_TAKEN
from ronna_hw.devices.reading_stream import MOST_WAITING, NextArmState, ReadingStream, Turn
from ronna_hw.devices.readings import ArmReading, Stamp, Validity
from ronna_hw.errors import LinkTimeout, RonnaError


class Device:
    """Makes a reading for each one allowed, then fails or waits."""

    def __init__(self, allowed: int, error: Exception | None = None) -> None:
        self.made, self._error = 0, error
        self._allowed = threading.Semaphore(allowed)

    def allow(self, more: int) -> None:
        self._allowed.release(more)

    def read(self, timeout_s: float) -> ArmReading:
        if not self._allowed.acquire(timeout=0.01 if self._error else timeout_s):
            raise self._error or LinkTimeout("nothing more comes")
        self.made += 1
        joints_rad = (0.0,) * 6
        return ArmReading(Stamp(self.made, self.made, 0.0), Validity.OK, joints_rad, joints_rad, False)


def numbers(readings: list[ArmReading]) -> list[int]:
    return [one.stamp.sequence for one in readings]


def stream_of(device: Device, *, every: bool = False) -> ReadingStream[ArmReading]:
    return ReadingStream(device.read, every=every)


def test_every_reading_comes_once_and_in_order() -> None:
    assert numbers(list(islice(stream_of(Device(50), every=True), 50))) == list(range(1, 51))


def test_whoever_is_slow_gets_the_newest_and_is_told_how_many_were_dropped() -> None:
    device = Device(1)
    stream = stream_of(device)
    readings = iter(stream)
    next(readings)
    device.allow(9)
    eventually(lambda: device.made == 10)
    assert next(readings).stamp.sequence == 10
    assert stream.dropped == 10 - 2


def test_every_reading_is_not_kept_without_bound() -> None:
    device = Device(MOST_WAITING + 10)
    readings = iter(stream_of(device, every=True))
    next(readings)
    eventually(lambda: device.made > MOST_WAITING)
    with raises(STREAM_BEHIND):
        for _ in readings:
            pass


@pytest.mark.parametrize("consume", [list, lambda stream: asyncio.run(first_of(stream, 5))])
def test_the_devices_error_reaches_the_consumer_after_its_last_reading(
    consume: Callable[[ReadingStream[ArmReading]], object],
) -> None:
    with raises(LinkTimeout):
        consume(stream_of(Device(3, LinkTimeout("the cable is out")), every=True))


async def first_of(stream: ReadingStream[ArmReading], count: int) -> list[ArmReading]:
    readings = []
    async for reading in stream:
        readings.append(reading)
        if len(readings) == count:
            break
    return readings


def test_a_task_awaits_readings() -> None:
    assert numbers(asyncio.run(first_of(stream_of(Device(5), every=True), 5))) == [1, 2, 3, 4, 5]


def test_a_function_is_called_with_each_reading_while_the_block_runs() -> None:
    got: list[ArmReading] = []
    device = Device(5)
    with stream_of(device, every=True).calling(got.append):
        eventually(lambda: len(got) == 5)
    assert numbers(got) == [1, 2, 3, 4, 5]


def test_an_error_of_the_function_is_raised_at_the_end_of_the_block() -> None:
    failed = threading.Event()

    def fail(_reading: ArmReading) -> None:
        failed.set()
        raise ValueError("no room for it")

    with pytest.raises(ValueError, match="no room"), stream_of(Device(5)).calling(fail):
        failed.wait(5.0)


def test_every_reading_that_was_read_is_delivered_where_the_block_ends() -> None:
    got: list[ArmReading] = []
    device, may_go_on = Device(50), threading.Event()

    def record(reading: ArmReading) -> None:
        may_go_on.wait(5.0)
        got.append(reading)

    stream = stream_of(device, every=True)
    with stream.calling(record):
        eventually(lambda: device.made == 50)
        may_go_on.set()
    assert numbers(got) == list(range(1, 51))
    assert stream.dropped == 0


def test_a_function_that_does_not_end_in_time_is_told_with_what_it_has_missed() -> None:
    device, may_end = Device(5), threading.Event()
    stream = ReadingStream(device.read, every=True, timeout_s=0.05)
    with (
        raises(CALL_GOES_ON, match="a call of the function goes on, and 4 readings are not delivered"),
        stream.calling(lambda _reading: may_end.wait(5.0), end_limit_s=0.01),
    ):
        eventually(lambda: device.made == 5)
    may_end.set()
    assert stream.dropped == 4


def test_a_function_that_ends_the_program_ends_the_stream_and_the_program() -> None:
    device = Device(1)
    stream = stream_of(device).calling(lambda _reading: sys.exit(3))
    stream.__enter__()
    eventually(lambda: not any(one.name == "reading stream" for one in threading.enumerate()))
    with pytest.raises(SystemExit):
        stream.__exit__(None, None, None)


def test_an_error_of_the_function_is_a_note_on_that_of_the_block() -> None:
    failed = threading.Event()

    def fail(_reading: ArmReading) -> None:
        failed.set()
        raise ValueError("no room for it")

    def run_block() -> None:
        with stream_of(Device(2)).calling(fail):
            failed.wait(5.0)
            raise KeyError("block")

    with pytest.raises(KeyError) as caught:
        run_block()
    assert caught.value.__notes__ == [
        "The function that gets the readings raised ValueError('no room for it')."
    ]


def test_a_device_is_not_called_by_two_threads_at_a_time() -> None:
    turn = Turn("tracker")
    refused: list[RonnaError] = []

    def call() -> None:
        try:
            with turn.call("read_frame"):
                pass
        except RonnaError as error:
            refused.append(error)

    with turn.call("read_frame"):
        thread = threading.Thread(target=call)
        thread.start()
        thread.join()
    assert [str(one).partition(".")[0] for one in refused] == [
        "DEV-014: tracker: read_frame came while another thread reads the device"
    ]
    call()
    assert len(refused) == 1


def test_a_stream_has_one_reader_at_a_time() -> None:
    device = Device(1)
    stream = stream_of(device)
    first = iter(stream)
    next(first)
    with raises(STREAM_TAKEN):
        next(iter(stream))
    first.close()
    device.allow(1)
    assert next(iter(stream)).stamp.sequence > 1


class Arm:
    """Reports the same cycle until it is allowed another; by its controller it has no clock."""

    name = "arm"

    def __init__(self, *clocks: int) -> None:
        self._clocks = list(clocks)

    def read_state(self, timeout_s: float = 1.0) -> ArmReading:
        clock = self._clocks.pop(0) if len(self._clocks) > 1 else self._clocks[0]
        return ArmReading(Stamp(1, clock, 0.0), Validity.OK, (0.0,) * 6, None, False)


def test_an_arms_state_comes_once_for_each_cycle_of_its_stream() -> None:
    read = NextArmState(Arm(4, 4, 8, 8, 12))
    assert [read(1.0).stamp.device_clock for _ in range(3)] == [4, 8, 12]
    with raises(NO_NEW_STATE):
        read(0.01)


def test_a_state_that_was_asked_for_without_a_stream_has_no_clock_and_is_new() -> None:
    read = NextArmState(Arm(0))
    assert [read(1.0).stamp.device_clock for _ in range(3)] == [0, 0, 0]


def test_a_stream_that_is_left_reads_the_device_no_more() -> None:
    device = Device(1)
    stream = stream_of(device)
    for _ in stream:
        break
    assert not any(thread.name == "reading stream" for thread in threading.enumerate())


def test_a_device_that_its_stream_reads_refuses_other_calls_until_the_stream_ends() -> None:
    turn = Turn("tracker")
    readings = iter(ReadingStream(Device(1).read, turn=turn))
    next(readings)
    with raises(DEVICE_STREAMS, match="tracker: read_frame"):
        turn.require("read_frame")
    with raises(STREAM_TAKEN):
        next(iter(ReadingStream(Device(1).read, turn=turn)))
    readings.close()
    turn.require("read_frame")


@pytest.mark.parametrize("every", [True, False])
def test_a_deactivated_device_ends_its_stream_without_an_error(every: bool) -> None:
    turn = Turn("stereo")
    readings = iter(ReadingStream(Device(3).read, every=every, turn=turn))
    next(readings)
    turn.end_stream()
    assert list(readings) == []
    assert not any(thread.name == "reading stream" for thread in threading.enumerate())


def test_the_event_loop_goes_on_while_a_stream_waits_for_its_last_reading() -> None:
    device = Device(1)

    async def leave_while_a_reading_is_under_way() -> int:
        readings = aiter(stream_of(device))
        await anext(readings)
        leaving = asyncio.ensure_future(readings.aclose())
        turns = 0
        while turns < 100:  # turns of the loop, while the device keeps the stream's thread waiting
            await asyncio.sleep(0)
            turns += 1
            assert not leaving.done()
        device.allow(1)
        await leaving
        return turns

    assert asyncio.run(leave_while_a_reading_is_under_way()) == 100


async def awaited(_reading: ArmReading) -> None:
    """Never called: a task reads a stream in another way."""


@pytest.mark.parametrize("function", [5, None, lambda: 1, lambda first, second: first, awaited])
def test_what_cannot_be_called_with_a_reading_is_refused_before_the_stream_begins(function: object) -> None:
    device = Device(1)
    with (
        raises(WrongArgument, match="a function of one argument"),
        stream_of(device).calling(function),  # type: ignore[arg-type]  # wrong on purpose
    ):
        pass
    assert device.made == 0


@pytest.mark.parametrize("wrong", [{"timeout_s": "1"}, {"timeout_s": -1.0}, {"every": "yes"}])
def test_a_stream_with_a_wrong_argument_is_refused_before_it_begins(wrong: dict[str, object]) -> None:
    with raises(WrongArgument, match="of a stream"):
        ReadingStream(Device(1).read, **wrong)  # type: ignore[arg-type]  # wrong on purpose

"""Acquisition, triggers and stream packets of one camera, and of a pair in lock-step."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from ronna_hw.wire.gige_vision import Bootstrap, PixelFormat
from sim.basler.camera.settings import Settings
from sim.basler.camera.timing import SOFTWARE_TRIGGER_SKEW_NS, readout_us
from sim.basler.stream.channel import KEPT_BLOCKS

OK = 0
RESEND, ACTION = 0x40, 0x100
LEADER, TRAILER, PAYLOAD = 1, 2, 3
LEADER_LAYOUT = ">HHQIIIIIHH"


def triggered(bench: Any) -> None:
    """A camera that waits for software triggers, small frames."""
    bench.take_control(stream=True)
    bench.small_frames()
    assert bench.set("TriggerMode", 1) == OK
    assert bench.set("AcquisitionStart", 1) == OK


def header(packet: bytes) -> tuple[int, int, int, int]:
    """Status, block id, format and packet id."""
    status, block, word = struct.unpack_from(">HHI", packet)
    return status, block, word >> 24 & 0x7F, word & 0xFFFFFF


def stamp(frame: list[bytes]) -> int:
    return int(struct.unpack_from(LEADER_LAYOUT, frame[0], 8)[2])


def test_26_a_frame_is_leader_payload_and_trailer(bench: Any) -> None:
    triggered(bench)
    assert bench.set("TriggerSoftware", 1) == OK
    frame = bench.frame()
    share, size = 1500 - 36, 64 * 48
    count = -(-size // share)
    assert [header(packet)[2:] for packet in frame] == [
        (LEADER, 0),
        *((PAYLOAD, number) for number in range(1, count + 1)),
        (TRAILER, count + 1),
    ]
    assert [len(packet) - 8 for packet in frame[1:-1]] == [share] * (count - 1) + [size - share * (count - 1)]
    assert b"".join(packet[8:] for packet in frame[1:-1]) == b"\1" * size
    assert struct.unpack_from(">HHI", frame[-1], 8) == (0, 1, 48)


def test_28_the_leader_tells_geometry_format_and_time(bench: Any) -> None:
    bench.take_control(stream=True)
    bench.small_frames()
    for name, value in (("OffsetX", 160), ("OffsetY", 33), ("PixelFormat", PixelFormat.MONO12)):
        assert bench.set(name, value) == OK
    assert bench.set("TriggerMode", 1) == bench.set("AcquisitionStart", 1) == OK
    moment_ns = bench.clock.time_ns
    assert bench.set("TriggerSoftware", 1) == OK
    leader = struct.unpack_from(LEADER_LAYOUT, bench.frame()[0], 8)
    assert leader == (0, 1, moment_ns // 8, PixelFormat.MONO12, 64, 48, 160, 33, 0, 0)


def test_27_blocks_count_from_one_again_with_every_start(bench: Any) -> None:
    triggered(bench)
    for round_number in range(2):
        for expected in (1, 2, 3):
            assert bench.set("TriggerSoftware", 1) == OK
            frame = bench.frame()
            assert {header(packet)[1] for packet in frame} == {expected}
            assert frame[1][8] == expected, f"image of another trigger in round {round_number}"
        assert bench.set("AcquisitionStop", 1) == bench.set("AcquisitionStart", 1) == OK


def pictures(bench: Any, count: int) -> list[int]:
    """Numbers of the pictures that so many triggers give."""
    found = []
    for _ in range(count):
        assert bench.set("TriggerSoftware", 1) == OK
        found.append(bench.frame()[1][8])
    return found


def restart(bench: Any) -> None:
    assert bench.set("AcquisitionStop", 1) == bench.set("AcquisitionStart", 1) == OK


def test_a_picture_that_is_taken_again_is_the_same_picture(bench: Any) -> None:
    bench.images.where = b"here"
    triggered(bench)
    assert pictures(bench, 3) == [1, 2, 3]
    restart(bench)
    restart(bench)
    assert pictures(bench, 2) == [3, 4]


@pytest.mark.parametrize("change", [("place", b"there"), ("Width", 96), ("ExposureTimeRaw", 5000)])
def test_an_acquisition_of_something_else_counts_from_one(bench: Any, change: tuple[str, Any]) -> None:
    bench.images.where = b"here"
    triggered(bench)
    assert pictures(bench, 2) == [1, 2]
    assert bench.set("AcquisitionStop", 1) == OK
    name, value = change
    if name == "place":
        bench.images.where = value
    else:
        assert bench.set(name, value) == OK
    assert bench.set("AcquisitionStart", 1) == OK
    assert pictures(bench, 2) == [1, 2]


def test_27_block_ids_wrap_to_one(bench: Any) -> None:
    triggered(bench)
    bench.camera.channel._next_block_id = 65535
    found = []
    for _ in range(2):
        assert bench.set("TriggerSoftware", 1) == OK
        found.append(header(bench.frame()[0])[1])
    assert found == [65535, 1]


def test_33_one_software_trigger_gives_one_frame_and_none_without(bench: Any) -> None:
    triggered(bench)
    assert bench.nothing_comes()
    assert bench.set("TriggerSoftware", 1) == OK
    bench.frame()
    assert bench.nothing_comes()


def test_33_triggers_while_busy_are_dropped_and_counted(bench: Any) -> None:
    triggered(bench)
    bench.images.gate.clear()
    for _ in range(4):
        assert bench.set("TriggerSoftware", 1) == OK
    assert bench.get("AcquisitionStatus") == 0
    bench.images.gate.set()
    bench.frame()
    assert bench.nothing_comes()
    assert bench.get("OvertriggerCount") == 3
    assert bench.get("AcquisitionStatus") == 1


@pytest.mark.parametrize("spoil", [("TriggerMode", 0), ("TriggerSource", 1), ("TriggerSelector", 0)])
def test_a_trigger_that_is_not_listened_to_does_nothing(bench: Any, spoil: tuple[str, int]) -> None:
    bench.take_control(stream=True)
    bench.small_frames()
    assert bench.set("TriggerMode", 1) == OK
    assert bench.set("TriggerSoftware", 1) == OK  # before the start
    assert bench.set("AcquisitionStart", 1) == OK
    if spoil == ("TriggerMode", 0):
        assert bench.set("AcquisitionStop", 1) == OK
        assert bench.set(*spoil) == OK
    else:
        assert bench.set(*spoil) == OK
        assert bench.set("TriggerSoftware", 1) == OK
    assert bench.nothing_comes()


def test_34_a_repeated_trigger_command_fires_once(bench: Any) -> None:
    triggered(bench)
    from sim.basler.control.feature_registers import address_of

    command = bench.datagram(0x82, struct.pack(">II", address_of("TriggerSoftware"), 1), request_id=900)
    answers = {bench.camera.port.answer(command, ("127.0.0.1", 40001)) for _ in range(3)}
    assert len(answers) == 1
    bench.frame()
    assert bench.nothing_comes()
    assert bench.get("OvertriggerCount") == 0


def test_25_nothing_is_sent_while_the_channel_is_closed(bench: Any) -> None:
    triggered(bench)
    assert bench.write(Bootstrap.SCP, 0) == OK
    assert bench.set("TriggerSoftware", 1) == OK
    assert bench.nothing_comes()


def test_24_destination_zero_is_the_application_in_control(bench: Any) -> None:
    triggered(bench)
    assert bench.write(Bootstrap.SCDA, 0) == OK
    assert bench.set("TriggerSoftware", 1) == OK
    assert len(bench.frame()) == 5


def test_23_a_test_packet_has_the_size_that_was_written(bench: Any) -> None:
    bench.take_control(stream=True)
    for size in (576, 1500, 9000):
        assert bench.write(Bootstrap.SCPS, 0xC0000000 | size) == OK
        assert len(bench.packets(1)[0]) == size - 28
        assert bench.read(Bootstrap.SCPS) == 0x40000000 | size
    assert bench.nothing_comes()


def test_29_time_stamps_grow_even_when_theatre_time_stands_still(bench: Any) -> None:
    bench.take_control(stream=True)
    bench.small_frames()
    assert bench.set("AcquisitionStart", 1) == OK
    stamps = [stamp(bench.frame()) for _ in range(5)]
    assert np.all(np.diff(stamps) > 0)


def test_free_running_frames_are_one_period_apart(bench: Any) -> None:
    bench.take_control(stream=True)
    bench.small_frames()
    assert bench.set("AcquisitionFrameRateEnable", 1) == OK
    assert bench.set("AcquisitionFrameRateAbs", 40.0) == OK
    assert bench.set("AcquisitionStart", 1) == OK
    stamps = [stamp(bench.frame()) for _ in range(5)]
    assert np.diff(stamps).tolist() == [125_000_000 // 40] * 4


def test_38_after_a_stop_at_most_the_frame_under_way_comes(bench: Any) -> None:
    bench.take_control(stream=True)
    bench.small_frames()
    assert bench.set("AcquisitionStart", 1) == OK
    last = header(bench.frame()[0])[1]
    assert bench.set("AcquisitionStop", 1) == OK
    while (packet := bench.packet_or_none()) is not None:
        last = max(last, header(packet)[1])
    assert last < 20


def test_single_frame_mode_takes_one_frame(bench: Any) -> None:
    bench.take_control(stream=True)
    bench.small_frames()
    assert bench.set("AcquisitionMode", 0) == OK
    for _ in range(2):
        assert bench.set("AcquisitionStart", 1) == OK
        assert header(bench.frame()[0])[1] == 1
        assert bench.nothing_comes()


def test_an_acquisition_start_trigger_permits_a_number_of_frames(bench: Any) -> None:
    bench.take_control(stream=True)
    bench.small_frames()
    assert bench.set("TriggerSelector", 0) == bench.set("TriggerMode", 1) == OK
    assert bench.set("AcquisitionFrameCount", 3) == OK
    assert bench.set("AcquisitionStart", 1) == OK
    assert bench.nothing_comes()
    assert bench.set("TriggerSoftware", 1) == OK
    assert [header(bench.frame()[0])[1] for _ in range(3)] == [1, 2, 3]
    assert bench.nothing_comes()


def test_a_trigger_delay_moves_the_exposure(bench: Any) -> None:
    bench.take_control(stream=True)
    bench.small_frames()
    assert bench.set("TriggerMode", 1) == bench.set("TriggerDelayAbs", 800.0) == OK
    assert bench.set("AcquisitionStart", 1) == OK
    moment_ns = bench.clock.time_ns
    assert bench.set("TriggerSoftware", 1) == OK
    assert stamp(bench.frame()) == (moment_ns + 800_000) // 8


def test_in_lock_step_a_trigger_advances_the_theatre_by_exposure_and_read_out(bench: Any) -> None:
    triggered(bench)
    begun_ns = bench.clock.time_ns
    assert bench.set("TriggerSoftware", 1) == OK
    bench.frame()
    frame = Settings(width=64, height=48).frame()
    assert bench.clock.time_ns - begun_ns == frame.exposure_us * 1000 + round(readout_us(frame) * 1e3)


def test_in_lock_step_a_pair_takes_the_time_of_one_frame(make_bench: Any) -> None:
    left = make_bench()
    right = make_bench("right", "21904412", beside=left)
    for camera in (left, right):
        triggered(camera)
    begun_ns = left.clock.time_ns
    for number in range(3):
        assert left.set("TriggerSoftware", 1) == OK
        first = stamp(left.frame())  # the theatre has advanced before the second trigger comes
        assert right.set("TriggerSoftware", 1) == OK
        second = stamp(right.frame())
        assert 0 <= second - first <= SOFTWARE_TRIGGER_SKEW_NS // 8
        frame = Settings(width=64, height=48).frame()
        one_ns = frame.exposure_us * 1000 + round(readout_us(frame) * 1e3)
        assert left.clock.time_ns - begun_ns <= (number + 1) * (one_ns + SOFTWARE_TRIGGER_SKEW_NS)


def test_35_an_action_command_fires_the_cameras_that_are_meant(make_bench: Any) -> None:
    left = make_bench()
    right = make_bench("right", "21904412", beside=left)
    for camera, mask in ((left, 1), (right, 3)):
        camera.take_control(stream=True)
        camera.small_frames()
        for name, value in (
            ("ActionDeviceKey", 0xABCD),
            ("ActionGroupKey", 7),
            ("ActionGroupMask", mask),
            ("TriggerSource", 2),
            ("TriggerMode", 1),
            ("AcquisitionStart", 1),
        ):
            assert camera.set(name, value) == OK

    def act(camera: Any, device: int, group: int, mask: int) -> bytes | None:
        datagram = camera.datagram(ACTION, struct.pack(">III", device, group, mask))
        answer: bytes | None = camera.camera.port.answer(datagram, ("127.0.0.1", 50000))
        return answer

    for keys in ((0xABCE, 7, 3), (0xABCD, 8, 3), (0xABCD, 7, 4)):
        assert act(left, *keys) is None
    for camera in (left, right):
        answer = act(camera, 0xABCD, 7, 1)
        assert answer is not None
        assert answer[:4] == bytes((0, 0, 1, 1))
        assert header(camera.frame()[0])[1] == 1
        assert camera.nothing_comes()
    assert act(left, 0xABCD, 7, 2) is None
    assert act(right, 0xABCD, 7, 2) is not None


def test_35_a_scheduled_action_is_refused_without_a_common_clock(bench: Any) -> None:
    bench.take_control()
    status, _, _ = bench.ask(ACTION, struct.pack(">IIIQ", 0, 0, 0, 5), flags=0x81)
    assert status == 0x8013


def test_31_packets_are_repeated_byte_for_byte(bench: Any) -> None:
    triggered(bench)
    frames = []
    for _ in range(KEPT_BLOCKS):
        assert bench.set("TriggerSoftware", 1) == OK
        frames.append(bench.frame())
    assert KEPT_BLOCKS >= 16
    for frame in (frames[0], frames[-1]):
        block = header(frame[0])[1]
        request = bench.datagram(RESEND, struct.pack(">HHII", 0, block, 0, 0xFFFFFF), flags=0)
        # the receiver asks from the port of its stream socket
        assert bench.camera.port.answer(request, bench.receiver.getsockname()) is None
        again = bench.packets(len(frame))
        assert [packet[2:] for packet in again] == [packet[2:] for packet in frame]
        assert {header(packet)[0] for packet in again} == {0x0100}


def test_31_a_range_of_packets_is_repeated_and_nothing_else(bench: Any) -> None:
    triggered(bench)
    assert bench.set("TriggerSoftware", 1) == OK
    frame = bench.frame()
    for flags, payload in (
        (0, struct.pack(">HHII", 0, 1, 1, 2)),
        (0x10, struct.pack(">HHIIQ", 0, 0, 1, 2, 1)),
    ):
        bench.camera.port.answer(bench.datagram(RESEND, payload, flags=flags), ("127.0.0.1", 1))
        assert [packet[2:] for packet in bench.packets(2)] == [packet[2:] for packet in frame[1:3]]
        assert bench.nothing_comes()


def test_32_what_is_gone_is_answered_by_a_header_that_says_so(bench: Any) -> None:
    triggered(bench)
    for _ in range(KEPT_BLOCKS + 1):
        assert bench.set("TriggerSoftware", 1) == OK
        bench.frame()
    for block, packet in ((1, 2), (999, 1), (KEPT_BLOCKS + 1, 700)):
        request = bench.datagram(RESEND, struct.pack(">HHII", 0, block, packet, packet), flags=0)
        bench.camera.port.answer(request, ("127.0.0.1", 1))
        (answer,) = bench.packets(1)
        assert len(answer) == 8
        assert header(answer) == (0x800C, block, PAYLOAD, packet)


def test_nobody_else_can_ask_for_packets(bench: Any) -> None:
    triggered(bench)
    assert bench.set("TriggerSoftware", 1) == OK
    bench.frame()
    request = bench.datagram(RESEND, struct.pack(">HHII", 0, 1, 1, 1), flags=0)
    bench.camera.port.answer(request, ("127.0.0.9", 1))
    assert bench.nothing_comes()


def test_losing_control_ends_the_stream_and_the_next_client_starts_afresh(bench: Any) -> None:
    triggered(bench)
    assert bench.write(Bootstrap.CCP, 0) == OK
    assert bench.read(Bootstrap.SCP) == 0
    assert not bench.camera.acquiring
    triggered(bench)
    assert bench.set("TriggerSoftware", 1) == OK
    assert header(bench.frame()[0])[1] == 1

"""The control protocol of the simulated camera, beyond the cases of the conformance suite."""

from __future__ import annotations

import random
import struct
from typing import Any

import pytest
from hostile_clients import camera_commands

from ronna_hw.wire.gige_vision import Bootstrap, PixelFormat
from sim.basler.control.bootstrap import CAPABILITIES, XML_ADDRESS
from sim.basler.control.feature_table import address_of

CLIENT, OTHER = ("127.0.0.1", 40001), ("127.0.0.1", 40002)
READREG, WRITEREG, READMEM, WRITEMEM, DISCOVERY, FORCEIP = 0x80, 0x82, 0x84, 0x86, 0x02, 0x04
OK, INVALID_PARAMETER, WRITE_PROTECT = 0, 0x8002, 0x8004
BAD_ALIGNMENT, ACCESS_DENIED, BUSY = 0x8005, 0x8006, 0x8007


def read_memory(bench: Any, address: int, count: int) -> tuple[int, bytes]:
    status, _, content = bench.ask(READMEM, struct.pack(">IHH", address, 0, count))
    return status, content[4:]


def test_a_command_with_a_wrong_length_or_without_a_request_id_is_ignored(bench: Any) -> None:
    whole = bench.datagram(READREG, struct.pack(">I", 0))
    assert bench.camera.port.answer(whole[:-1], CLIENT) is None
    assert bench.camera.port.answer(whole + b"\0", CLIENT) is None
    assert bench.camera.port.answer(whole[:6] + b"\0\0" + whole[8:], CLIENT) is None


def test_a_command_without_the_acknowledge_flag_is_executed_but_not_answered(bench: Any) -> None:
    bench.take_control()
    datagram = bench.datagram(WRITEREG, struct.pack(">II", address_of("GainRaw"), 100), flags=0)
    assert bench.camera.port.answer(datagram, CLIENT) is None
    assert bench.get("GainRaw") == 100


def test_memory_reads_are_limited_to_536_bytes_and_whole_words(bench: Any) -> None:
    assert read_memory(bench, XML_ADDRESS, 540)[0] == INVALID_PARAMETER
    assert read_memory(bench, XML_ADDRESS, 6)[0] == BAD_ALIGNMENT


def test_nothing_can_be_written_while_another_client_has_control(bench: Any) -> None:
    bench.take_control()
    assert bench.write(address_of("GainRaw"), 100, peer=OTHER) == ACCESS_DENIED
    assert bench.write(Bootstrap.CCP, 0, peer=OTHER) == ACCESS_DENIED
    assert bench.ask(WRITEMEM, struct.pack(">II", Bootstrap.SCP, 9), peer=OTHER)[0] == ACCESS_DENIED
    assert bench.get("GainRaw") == 36


def test_control_can_also_be_taken_by_a_memory_write(bench: Any) -> None:
    assert bench.ask(WRITEMEM, struct.pack(">II", Bootstrap.CCP, 2))[0] == OK
    bench.put(GainRaw=40)


def test_exclusive_control_blocks_memory_reads_by_others_but_not_discovery(bench: Any) -> None:
    assert bench.write(Bootstrap.CCP, 1) == OK
    assert bench.ask(READMEM, struct.pack(">IHH", 0, 0, 4), peer=OTHER)[0] == ACCESS_DENIED
    assert bench.ask(DISCOVERY, peer=OTHER)[0] == OK


def test_a_silent_owner_loses_control_stream_and_acquisition(bench: Any) -> None:
    bench.take_control(stream=True)
    assert bench.write(Bootstrap.HEARTBEAT_TIMEOUT_MS, 1000) == OK
    bench.put(TriggerMode=1, AcquisitionStart=1)
    bench.host_s.now += 0.95
    bench.camera.privilege.expire()
    assert bench.camera.acquisition.running
    bench.host_s.now += 0.1
    bench.camera.privilege.expire()
    assert not bench.camera.acquisition.running
    assert bench.read(Bootstrap.CCP) == bench.read(Bootstrap.SCP) == 0
    assert bench.read(Bootstrap.HEARTBEAT_TIMEOUT_MS) == 3000


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("Width", (0, 8, 1000, 2064)),
        ("Height", (0, 1089)),
        ("GainRaw", (0, 35, 513, 0xFFFFFFFF)),
        ("ExposureTimeRaw", (23, 1_000_001)),
        ("ExposureTimeAbs", (23.0, 2e6, float("nan"), float("inf"), -1.0)),
        ("PixelFormat", (0, 0x01080002)),
        ("TriggerSelector", (2,)),
        ("GevSCPSPacketSize", (219, 1502, 20000)),
    ],
)
def test_values_out_of_range_are_refused_and_not_stored(
    bench: Any, name: str, values: tuple[int | float, ...]
) -> None:
    bench.take_control()
    before = bench.get(name)
    for value in values:
        assert bench.set(name, value) == INVALID_PARAMETER
    assert bench.get(name) == before


def test_acquisition_locks_the_packet_size_but_not_exposure_and_offset(bench: Any) -> None:
    bench.stream(TriggerMode=1, AcquisitionStart=1)
    assert bench.set("GevSCPSPacketSize", 8000) == BUSY
    assert bench.write(Bootstrap.SCPS, 8000) == BUSY
    bench.put(ExposureTimeRaw=9000, OffsetX=160, AcquisitionStop=1, Width=128)


def test_a_repeated_command_gets_the_same_answer(bench: Any) -> None:
    bench.take_control()
    datagram = bench.datagram(WRITEREG, struct.pack(">II", address_of("GainRaw"), 100), request_id=77)
    first = bench.camera.port.answer(datagram, CLIENT)
    bench.put(GainRaw=200)
    assert bench.camera.port.answer(datagram, CLIENT) == first
    # the last command of the client was another one by now, so this is a new command with an old id
    assert bench.get("GainRaw") == 100
    again = bench.camera.port.answer(datagram, CLIENT)
    assert bench.camera.port.answer(datagram, CLIENT) == again


def test_user_sets_keep_and_restore_settings(bench: Any) -> None:
    bench.take_control()
    bench.put(Width=640, GainRaw=77)
    assert bench.set("UserSetSave", 1) == WRITE_PROTECT  # Default
    bench.put(UserSetSelector=1, UserSetSave=1)
    bench.put(UserSetSelector=0, UserSetLoad=1)
    assert (bench.get("Width"), bench.get("GainRaw")) == (2048, 36)
    bench.put(UserSetSelector=1, UserSetLoad=1)
    assert (bench.get("Width"), bench.get("GainRaw")) == (640, 77)


def test_the_user_can_name_the_camera(bench: Any) -> None:
    bench.take_control()
    assert (
        bench.ask(WRITEMEM, struct.pack(">I", Bootstrap.USER_DEFINED_NAME) + b"above".ljust(16, b"\0"))[0]
        == OK
    )
    assert bench.ask(DISCOVERY)[2][0xE8:].startswith(b"above\0")


def test_exposure_is_one_value_under_two_names(bench: Any) -> None:
    bench.take_control()
    bench.put(ExposureTimeAbs=2500.4)
    assert bench.get("ExposureTimeRaw") == 2500
    bench.put(ExposureTimeRaw=60_000)
    assert bench.get_float("ExposureTimeAbs") == 60_000.0
    assert bench.get_float("ResultingFrameRateAbs") == pytest.approx(1e6 / 60_000)


def test_the_link_limits_the_rate_of_twelve_bit_frames(bench: Any) -> None:
    bench.take_control()
    assert bench.get_float("ResultingFrameRateAbs") == pytest.approx(50.0)
    bench.put(PixelFormat=PixelFormat.MONO12)
    assert 25.0 < bench.get_float("ResultingFrameRateAbs") < 27.0
    bench.put(AcquisitionFrameRateEnable=1, AcquisitionFrameRateAbs=10.0)
    assert bench.get_float("ResultingFrameRateAbs") == pytest.approx(10.0)


def test_each_trigger_has_its_own_settings(bench: Any) -> None:
    bench.take_control()
    bench.put(TriggerSelector=1, TriggerMode=1)
    bench.put(TriggerSelector=0)
    assert bench.get("TriggerMode") == 0
    bench.put(TriggerSelector=1)
    assert bench.get("TriggerMode") == 1


def test_force_ip_is_answered_only_by_the_addressed_camera(bench: Any) -> None:
    def force(mac: bytes, address: bytes) -> bytes:
        payload = bytearray(56)
        payload[2:8], payload[20:24] = mac, address
        return bytes(payload)

    own = bench.camera.identity.mac
    other = bench.datagram(FORCEIP, force(b"\0\x30\x53\1\2\3", bytes(4)))
    assert bench.camera.port.answer(other, CLIENT) is None
    assert bench.ask(FORCEIP, force(own, bytes([127, 0, 0, 1])))[0] == OK
    assert bench.ask(FORCEIP, force(own, bytes([10, 0, 0, 1])))[0] == 0x8008
    bench.take_control()
    assert bench.ask(FORCEIP, force(own, bytes([127, 0, 0, 1])))[0] == ACCESS_DENIED


def test_the_capability_registers_list_the_supported_features(bench: Any) -> None:
    assert bench.read(Bootstrap.GVCP_CAPABILITY) == CAPABILITIES
    assert bench.read(Bootstrap.MESSAGE_CHANNELS) == 1
    assert bench.read(Bootstrap.MESSAGE_CHANNEL_CAPABILITY) == 0x8000_0000
    assert bench.read(Bootstrap.MCSP) == bench.camera.messages.source_port
    assert CAPABILITIES & 0b111000 == 0b011000  # events with and without data, no PENDING


def test_no_hostile_datagram_breaks_the_camera(bench: Any) -> None:
    bench.take_control()
    chosen = random.Random(5)
    for datagram in camera_commands(chosen, 10_000):
        answer = bench.camera.port.answer(datagram, chosen.choice((CLIENT, OTHER)))
        if answer is not None:
            assert struct.unpack_from(">H", answer, 4)[0] == len(answer) - 8
            assert answer[6:8] == datagram[6:8]
    assert bench.ask(DISCOVERY)[0] == OK

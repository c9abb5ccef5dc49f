"""The control protocol, command by command; numbers in the names are lines of the conformance checklist."""

from __future__ import annotations

import random
import struct
from typing import Any

import pytest

from ronna_hw.wire.gige_vision import Bootstrap, PixelFormat
from sim.basler.control.bootstrap import CAPABILITIES, XML_ADDRESS
from sim.basler.control.feature_registers import address_of

CLIENT, OTHER = ("127.0.0.1", 40001), ("127.0.0.1", 40002)
READREG, WRITEREG, READMEM, WRITEMEM, DISCOVERY, FORCEIP = 0x80, 0x82, 0x84, 0x86, 0x02, 0x04
OK, NOT_IMPLEMENTED, INVALID_PARAMETER, INVALID_ADDRESS = 0, 0x8001, 0x8002, 0x8003
WRITE_PROTECT, BAD_ALIGNMENT, ACCESS_DENIED, BUSY = 0x8004, 0x8005, 0x8006, 0x8007


def read_memory(bench: Any, address: int, count: int) -> tuple[int, bytes]:
    status, _, content = bench.ask(READMEM, struct.pack(">IHH", address, 0, count))
    return status, content[4:]


def test_02_discovery_gives_the_first_248_bytes_of_memory(bench: Any) -> None:
    status, code, content = bench.ask(DISCOVERY)
    assert (status, code, len(content)) == (OK, 0x0003, 248)
    assert content == read_memory(bench, 0, 248)[1]
    assert content[0x48:].startswith(b"Basler\0")
    assert content[0x68:].startswith(b"acA2000-50gmNIR\0")
    assert content[0xD8:].startswith(b"21904411\0")
    assert content[0x24:0x28] == bytes([127, 0, 0, 1])


def test_03_discovery_is_answered_under_the_exclusive_control_of_another(bench: Any) -> None:
    assert bench.write(Bootstrap.CCP, 1) == OK
    assert bench.ask(DISCOVERY, peer=OTHER)[0] == OK


@pytest.mark.parametrize("datagram", [b"", b"\x42", b"\x43" + bytes(7), b"\x42\x01\x00\x02\x00\x00\x00"])
def test_04_datagrams_that_are_no_commands_are_ignored(bench: Any, datagram: bytes) -> None:
    assert bench.camera.port.answer(datagram, CLIENT) is None


def test_04_a_command_whose_length_is_wrong_is_ignored(bench: Any) -> None:
    whole = bench.datagram(READREG, struct.pack(">I", 0))
    assert bench.camera.port.answer(whole[:-1], CLIENT) is None
    assert bench.camera.port.answer(whole + b"\0", CLIENT) is None
    assert bench.camera.port.answer(whole[:6] + b"\0\0" + whole[8:], CLIENT) is None  # request id 0


def test_05_unknown_commands_are_not_implemented(bench: Any) -> None:
    assert bench.ask(0x1234)[0] == NOT_IMPLEMENTED


def test_05_without_the_acknowledge_flag_nothing_is_answered_but_done(bench: Any) -> None:
    bench.take_control()
    datagram = bench.datagram(WRITEREG, struct.pack(">II", address_of("GainRaw"), 100), flags=0)
    assert bench.camera.port.answer(datagram, CLIENT) is None
    assert bench.get("GainRaw") == 100


def test_06_lists_of_registers_are_read_in_order(bench: Any) -> None:
    addresses = [Bootstrap.TICK_FREQUENCY_LOW, Bootstrap.VERSION, Bootstrap.STREAM_CHANNELS]
    _, _, content = bench.ask(READREG, struct.pack(">3I", *addresses))
    assert struct.unpack(">3I", content) == (125_000_000, 0x00010002, 1)


def test_07_memory_is_read_in_pieces_of_up_to_536_bytes(bench: Any) -> None:
    assert len(read_memory(bench, XML_ADDRESS, 536)[1]) == 536
    assert read_memory(bench, XML_ADDRESS, 540)[0] == INVALID_PARAMETER
    assert read_memory(bench, XML_ADDRESS + 2, 4)[0] == BAD_ALIGNMENT
    assert read_memory(bench, XML_ADDRESS, 6)[0] == BAD_ALIGNMENT


def test_08_absent_addresses_are_refused_by_every_command(bench: Any) -> None:
    bench.take_control()
    absent = 0x9FF0
    assert bench.ask(READREG, struct.pack(">I", absent))[0] == INVALID_ADDRESS
    assert read_memory(bench, absent, 4)[0] == INVALID_ADDRESS
    assert bench.write(absent, 1) == INVALID_ADDRESS
    assert bench.ask(WRITEMEM, struct.pack(">II", absent, 1))[0] == INVALID_ADDRESS


def test_09_identity_cannot_be_written(bench: Any) -> None:
    bench.take_control()
    for address in (Bootstrap.VERSION, Bootstrap.MAC_LOW, Bootstrap.GVCP_CAPABILITY, XML_ADDRESS):
        assert bench.write(address, 1) == WRITE_PROTECT
    assert bench.set("PayloadSize", 5) == WRITE_PROTECT


def test_10_without_control_nothing_can_be_written(bench: Any) -> None:
    assert bench.set("GainRaw", 100) == ACCESS_DENIED
    bench.take_control()
    assert bench.write(address_of("GainRaw"), 100, peer=OTHER) == ACCESS_DENIED
    assert bench.ask(WRITEMEM, struct.pack(">II", Bootstrap.SCP, 9), peer=OTHER)[0] == ACCESS_DENIED
    assert bench.get("GainRaw") == 36


def test_11_a_list_of_writes_stops_at_the_first_refusal_and_tells_its_index(bench: Any) -> None:
    bench.take_control()
    gain, exposure = address_of("GainRaw"), address_of("ExposureTimeRaw")
    pairs = struct.pack(">6I", exposure, 500, gain, 9999, exposure, 700)
    status, _, content = bench.ask(WRITEREG, pairs)
    assert status == INVALID_PARAMETER
    assert struct.unpack(">HH", content) == (0, 1)
    assert bench.get("ExposureTimeRaw") == 500


def test_12_control_is_taken_refused_and_released(bench: Any) -> None:
    assert bench.write(Bootstrap.CCP, 2) == OK
    assert bench.read(Bootstrap.CCP, peer=OTHER) == 2
    assert bench.write(Bootstrap.CCP, 2, peer=OTHER) == ACCESS_DENIED
    assert bench.write(Bootstrap.CCP, 0, peer=OTHER) == ACCESS_DENIED
    assert bench.write(Bootstrap.CCP, 0) == OK
    assert bench.write(Bootstrap.CCP, 2, peer=OTHER) == OK


def test_12_control_may_be_taken_by_a_memory_write_too(bench: Any) -> None:
    assert bench.ask(WRITEMEM, struct.pack(">II", Bootstrap.CCP, 2))[0] == OK
    assert bench.set("GainRaw", 40) == OK


def test_13_exclusive_control_keeps_others_from_reading(bench: Any) -> None:
    bench.take_control()
    assert bench.ask(READREG, struct.pack(">I", 0), peer=OTHER)[0] == OK
    assert bench.write(Bootstrap.CCP, 1) == OK
    assert bench.ask(READREG, struct.pack(">I", 0), peer=OTHER)[0] == ACCESS_DENIED
    assert bench.ask(READMEM, struct.pack(">IHH", 0, 0, 4), peer=OTHER)[0] == ACCESS_DENIED


def test_14_every_command_of_the_owner_is_a_heartbeat_and_no_other(bench: Any) -> None:
    bench.take_control()
    for _ in range(5):
        bench.host_s.now += 2.0
        bench.camera.privilege.expire()
        bench.read(0x0000)
    assert bench.camera.privilege.owner == CLIENT
    for _ in range(2):
        bench.host_s.now += 2.0
        bench.read(0x0000, peer=OTHER)
        bench.camera.privilege.expire()
    assert bench.camera.privilege.owner is None


def test_15_a_silent_owner_loses_control_stream_and_acquisition(bench: Any) -> None:
    bench.take_control(stream=True)
    assert bench.write(Bootstrap.HEARTBEAT_TIMEOUT_MS, 1000) == OK
    assert bench.set("TriggerMode", 1) == OK
    assert bench.set("AcquisitionStart", 1) == OK
    bench.host_s.now += 0.95
    bench.camera.privilege.expire()
    assert bench.camera.acquiring
    bench.host_s.now += 0.1
    bench.camera.privilege.expire()
    assert not bench.camera.acquiring
    assert bench.read(Bootstrap.CCP) == bench.read(Bootstrap.SCP) == 0
    assert bench.read(Bootstrap.HEARTBEAT_TIMEOUT_MS) == 3000


def test_16_short_heartbeats_are_raised(bench: Any) -> None:
    bench.take_control()
    assert bench.write(Bootstrap.HEARTBEAT_TIMEOUT_MS, 20) == OK
    assert bench.read(Bootstrap.HEARTBEAT_TIMEOUT_MS) == 500


def test_19_the_payload_size_follows_area_and_format(bench: Any) -> None:
    bench.take_control()
    assert bench.get("PayloadSize") == 2048 * 1088
    for width, height, pixel_format, size in (
        (1024, 1024, PixelFormat.MONO8, 1024 * 1024),
        (1024, 1024, PixelFormat.MONO12, 1024 * 1024 * 2),
        (1024, 1023, PixelFormat.MONO12_PACKED, 1024 * 1023 * 3 // 2),
    ):
        assert bench.set("Width", width) == bench.set("Height", height) == OK
        assert bench.set("PixelFormat", pixel_format) == OK
        assert bench.get("PayloadSize") == size


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
def test_20_values_out_of_range_are_refused_and_not_stored(
    bench: Any, name: str, values: tuple[int | float, ...]
) -> None:
    bench.take_control()
    before = bench.get(name)
    for value in values:
        assert bench.set(name, value) == INVALID_PARAMETER
    assert bench.get(name) == before


def test_21_the_area_never_leaves_the_sensor(bench: Any) -> None:
    bench.take_control()
    assert bench.set("OffsetX", 16) == INVALID_PARAMETER
    assert bench.set("Width", 1024) == OK
    assert bench.set("OffsetX", 1024) == OK
    assert bench.set("OffsetX", 1040) == INVALID_PARAMETER
    assert bench.set("Width", 1040) == INVALID_PARAMETER
    assert bench.set("Height", 1000) == OK
    assert bench.set("OffsetY", 88) == OK
    assert bench.set("OffsetY", 89) == INVALID_PARAMETER


def test_22_geometry_and_format_are_locked_while_acquiring(bench: Any) -> None:
    bench.take_control(stream=True)
    bench.small_frames()
    assert bench.set("TriggerMode", 1) == OK
    assert bench.set("AcquisitionStart", 1) == OK
    assert bench.set("Width", 128) == BUSY
    assert bench.set("PixelFormat", PixelFormat.MONO12) == BUSY
    assert bench.set("GevSCPSPacketSize", 8000) == BUSY
    assert bench.write(Bootstrap.SCPS, 8000) == BUSY
    assert bench.set("ExposureTimeRaw", 9000) == OK
    assert bench.set("OffsetX", 160) == OK
    assert bench.set("AcquisitionStop", 1) == OK
    assert bench.set("Width", 128) == OK


def test_30_time_stamps_are_latched_and_reset(bench: Any) -> None:
    bench.take_control()
    bench.clock.time_ns = 40_000_000_000
    assert bench.write(Bootstrap.TIMESTAMP_CONTROL, 2) == OK
    high, low = bench.read(Bootstrap.TIMESTAMP_HIGH), bench.read(Bootstrap.TIMESTAMP_LOW)
    assert (high << 32 | low) == 40 * 125_000_000
    assert bench.write(Bootstrap.TIMESTAMP_CONTROL, 1) == OK
    bench.clock.time_ns += 8_000
    assert bench.write(Bootstrap.TIMESTAMP_CONTROL, 2) == OK
    assert bench.read(Bootstrap.TIMESTAMP_LOW) == 1000


def test_34_a_repeated_command_is_answered_but_not_done_again(bench: Any) -> None:
    bench.take_control()
    datagram = bench.datagram(WRITEREG, struct.pack(">II", address_of("GainRaw"), 100), request_id=77)
    first = bench.camera.port.answer(datagram, CLIENT)
    assert bench.set("GainRaw", 200) == OK
    assert bench.camera.port.answer(datagram, CLIENT) == first
    # the last command of the client was another one by now, so this is a new command with an old id
    assert bench.get("GainRaw") == 100
    again = bench.camera.port.answer(datagram, CLIENT)
    assert bench.camera.port.answer(datagram, CLIENT) == again


def test_39_user_sets_keep_and_restore_settings(bench: Any) -> None:
    bench.take_control()
    assert bench.set("Width", 640) == bench.set("GainRaw", 77) == OK
    assert bench.set("UserSetSave", 1) == WRITE_PROTECT  # Default
    assert bench.set("UserSetSelector", 1) == bench.set("UserSetSave", 1) == OK
    assert bench.set("UserSetSelector", 0) == bench.set("UserSetLoad", 1) == OK
    assert (bench.get("Width"), bench.get("GainRaw")) == (2048, 36)
    assert bench.set("UserSetSelector", 1) == bench.set("UserSetLoad", 1) == OK
    assert (bench.get("Width"), bench.get("GainRaw")) == (640, 77)


def test_two_cameras_have_their_own_identity(make_bench: Any) -> None:
    left, right = make_bench(), make_bench("right", "21904412")
    answers = [each.ask(DISCOVERY)[2] for each in (left, right)]
    assert answers[0][0x0A:0x10] != answers[1][0x0A:0x10]
    assert answers[0][0x0A:0x0D] == bytes((0x00, 0x30, 0x53))
    assert answers[0][0xD8:0xE8] != answers[1][0xD8:0xE8]


def test_the_user_may_name_the_camera(bench: Any) -> None:
    bench.take_control()
    assert (
        bench.ask(WRITEMEM, struct.pack(">I", Bootstrap.USER_DEFINED_NAME) + b"above".ljust(16, b"\0"))[0]
        == OK
    )
    assert bench.ask(DISCOVERY)[2][0xE8:].startswith(b"above\0")


def test_exposure_is_one_value_under_two_names(bench: Any) -> None:
    bench.take_control()
    assert bench.set("ExposureTimeAbs", 2500.4) == OK
    assert bench.get("ExposureTimeRaw") == 2500
    assert bench.set("ExposureTimeRaw", 60_000) == OK
    assert bench.get_float("ExposureTimeAbs") == 60_000.0
    assert bench.get_float("ResultingFrameRateAbs") == pytest.approx(1e6 / 60_000)


def test_37_the_link_limits_twelve_bit_frames(bench: Any) -> None:
    bench.take_control()
    assert bench.get_float("ResultingFrameRateAbs") == pytest.approx(50.0)
    assert bench.set("PixelFormat", PixelFormat.MONO12) == OK
    assert 25.0 < bench.get_float("ResultingFrameRateAbs") < 27.0
    assert bench.set("AcquisitionFrameRateEnable", 1) == OK
    assert bench.set("AcquisitionFrameRateAbs", 10.0) == OK
    assert bench.get_float("ResultingFrameRateAbs") == pytest.approx(10.0)


def test_each_trigger_has_settings_of_its_own(bench: Any) -> None:
    bench.take_control()
    assert bench.set("TriggerSelector", 1) == bench.set("TriggerMode", 1) == OK
    assert bench.set("TriggerSelector", 0) == OK
    assert bench.get("TriggerMode") == 0
    assert bench.set("TriggerSelector", 1) == OK
    assert bench.get("TriggerMode") == 1


def test_force_ip_is_answered_only_by_the_camera_that_is_meant(bench: Any) -> None:
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


def test_capabilities_name_what_is_there(bench: Any) -> None:
    assert bench.read(Bootstrap.GVCP_CAPABILITY) == CAPABILITIES
    assert bench.read(Bootstrap.MESSAGE_CHANNELS) == 1
    assert CAPABILITIES & 0b111000 == 0b011000  # events with and without data, no PENDING


def test_no_datagram_whatever_breaks_the_camera(bench: Any) -> None:
    bench.take_control()
    chance = random.Random(5)
    commands = (READREG, WRITEREG, READMEM, WRITEMEM, DISCOVERY, FORCEIP, 0x40, 0x100, 0x89, 0xFFFF)
    addresses = [0x0, 0xA00, 0xD04, 0x938, 0x100000, *range(0x20000, 0x20400, 16)]
    for number in range(30_000):
        if number % 3:
            payload = chance.randbytes(chance.randrange(0, 24))
        else:
            payload = struct.pack(
                ">II", chance.choice(addresses), chance.getrandbits(chance.randrange(1, 33))
            )
        datagram = bench.datagram(chance.choice(commands), payload, flags=chance.randrange(256))
        if number % 50 == 0:
            datagram = chance.randbytes(chance.randrange(0, 40))
        answer = bench.camera.port.answer(datagram, chance.choice((CLIENT, OTHER)))
        if answer is not None:
            assert struct.unpack_from(">H", answer, 4)[0] == len(answer) - 8
            assert answer[6:8] == datagram[6:8]
    assert bench.ask(DISCOVERY)[0] == OK

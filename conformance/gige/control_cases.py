"""Cases for the registers and control channel of a GigE Vision camera, bypassing the driver.

The number of a case is G and a line of the protocol's checklist. Every case runs on each camera and leaves it
uncontrolled.
"""

from __future__ import annotations

import socket
import struct
import time
from typing import Protocol, runtime_checkable

from conformance.case import HOST_TIME, CaseList, NotShown, check
from conformance.device_under_test import DeviceUnderTest
from conformance.gige.client import GigeFeatures, GigeLink, camera_control, cameras
from conformance.gige.stream import GigeStream, start_acquisition
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.sensors import StereoPair
from ronna_hw.wire.gige_vision import (
    CCP_CONTROL,
    CCP_EXCLUSIVE,
    CCP_OPEN,
    DISCOVERY_BYTES,
    GVCP_KEY,
    GVCP_PORT,
    HEARTBEAT_MINIMUM_MS,
    READMEM_LIMIT,
    REGISTER_BYTES,
    TEXT_BYTES,
    Bootstrap,
    GevStatus,
    GvcpCommand,
)

UNKNOWN_COMMAND = 0x0F00
ABSENT_ADDRESS = 0xFFFF_FF00
PAIRS = 5

CASES = CaseList()
case = CASES.case
on_camera = CASES.with_each(cameras)


@runtime_checkable
class ReportsBlockIds(StereoPair, Protocol):
    """Camera pair that reports the block ids of its last images."""

    @property
    def block_ids(self) -> tuple[int | None, int | None]:
        """Left and right block ids; None for a missing image."""
        ...


@on_camera("G02", "discovery returns the bootstrap memory, with the request id of the command")
def discovery_is_bootstrap_memory(camera: GigeLink) -> None:
    answer = camera.exchange(GvcpCommand.DISCOVERY)
    camera.expect(answer, GevStatus.SUCCESS, "discovery")
    check(answer.code == GvcpCommand.DISCOVERY_ACK, "a discovery answer", hex(answer.code))
    check(len(answer.payload) == DISCOVERY_BYTES, f"{DISCOVERY_BYTES} bytes", len(answer.payload))
    check(answer.payload == camera.memory(0, DISCOVERY_BYTES), "what READMEM returns from address 0")


@on_camera("G03", "discovery is answered while another application has control")
def discovery_beside_a_controller(camera: GigeLink) -> None:
    with camera_control(camera), GigeLink(camera.address) as other:
        other.expect(other.exchange(GvcpCommand.DISCOVERY), GevStatus.SUCCESS, "discovery")


@on_camera("G04", "datagrams that are not commands get no answer")
def invalid_datagrams(camera: GigeLink) -> None:
    for datagram in (b"", b"\x42\x01\x00", struct.pack(">BBHHH", GVCP_KEY + 1, 1, 2, 0, 9)):
        check(camera.is_silent_after(datagram), "no answer to a datagram that is not a command")
    camera.expect(camera.exchange(GvcpCommand.DISCOVERY), GevStatus.SUCCESS, "discovery afterwards")


@on_camera(
    "G05", "an unknown command returns NOT_IMPLEMENTED; without the acknowledge flag there is no answer"
)
def unknown_commands(camera: GigeLink) -> None:
    answer = camera.exchange(UNKNOWN_COMMAND)
    camera.expect(answer, GevStatus.NOT_IMPLEMENTED, "an unknown command")
    quiet = struct.pack(">BBHHHI", GVCP_KEY, 0, GvcpCommand.READREG, 4, 77, Bootstrap.VERSION)
    check(camera.is_silent_after(quiet), "no answer without the acknowledge flag")


@on_camera("G06", "several registers can be read in one command, in order")
def registers_in_order(camera: GigeLink) -> None:
    wanted = (Bootstrap.TICK_FREQUENCY_LOW, Bootstrap.CCP, Bootstrap.VERSION)
    single = [camera.read_registers(address)[0] for address in wanted]
    check(camera.read_registers(*wanted) == single, f"the values {single}", camera.read_registers(*wanted))


@on_camera("G07", "memory can be read in blocks of up to 536 bytes, at multiples of 4")
def memory_pieces(camera: GigeLink) -> None:
    camera.memory(Bootstrap.FIRST_URL, READMEM_LIMIT - READMEM_LIMIT % 4)
    answer = camera.exchange(GvcpCommand.READMEM, struct.pack(">IHH", Bootstrap.FIRST_URL + 2, 0, 8))
    camera.expect(answer, GevStatus.BAD_ALIGNMENT, "a misaligned address")


@on_camera("G08", "nonexistent addresses are invalid, for reading and writing")
def absent_addresses(camera: GigeLink) -> None:
    absent = struct.pack(">I", ABSENT_ADDRESS)
    with camera_control(camera):
        for command, payload in (
            (GvcpCommand.READREG, absent),
            (GvcpCommand.READMEM, absent + struct.pack(">HH", 0, 4)),
            (GvcpCommand.WRITEREG, absent + bytes(4)),
            (GvcpCommand.WRITEMEM, absent + bytes(4)),
        ):
            answer = camera.exchange(command, payload)
            camera.expect(answer, GevStatus.INVALID_ADDRESS, f"{command.name} of a nonexistent address")


@on_camera("G09", "read-only registers are write-protected")
def read_only_registers(camera: GigeLink) -> None:
    with camera_control(camera):
        status = camera.write(Bootstrap.VERSION, 0)
        check(status == GevStatus.WRITE_PROTECT, "write protect", hex(status))


@on_camera("G10", "nothing can be written without control")
def no_write_without_control(camera: GigeLink) -> None:
    for status in (
        camera.write(Bootstrap.SCPD, 1),
        camera.write_memory(Bootstrap.USER_DEFINED_NAME, b"seized\0\0"),
    ):
        check(status == GevStatus.ACCESS_DENIED, "access denied", hex(status))


@on_camera("G12", "a second application is refused control, but may read")
def second_applicant(camera: GigeLink) -> None:
    with camera_control(camera), GigeLink(camera.address) as other:
        status = other.write(Bootstrap.CCP, CCP_CONTROL)
        check(status == GevStatus.ACCESS_DENIED, "access denied", hex(status))
        check(other.read_registers(Bootstrap.CCP) == [CCP_CONTROL], "control of the first application")


@on_camera("G16", "a heartbeat time-out below the minimum is raised to the minimum")
def shortest_heartbeat(camera: GigeLink) -> None:
    with camera_control(camera):
        (before,) = camera.read_registers(Bootstrap.HEARTBEAT_TIMEOUT_MS)
        camera.write(Bootstrap.HEARTBEAT_TIMEOUT_MS, HEARTBEAT_MINIMUM_MS // 5)
        (found,) = camera.read_registers(Bootstrap.HEARTBEAT_TIMEOUT_MS)
        camera.write(Bootstrap.HEARTBEAT_TIMEOUT_MS, before)
        check(found == HEARTBEAT_MINIMUM_MS, f"{HEARTBEAT_MINIMUM_MS} ms", found)


@on_camera("G17", "the description is XML of the length that its URL says")
def description_is_xml(camera: GigeLink) -> None:
    root = GigeFeatures(camera).description
    check(root.tag.endswith("RegisterDescription"), "a RegisterDescription", root.tag)


@case("G27", "block ids start at 1 and increase by 1")
def block_ids_step_by_one(dut: DeviceUnderTest) -> None:
    pair = dut.at(Lifecycle.CONFIGURED)
    if not isinstance(pair, ReportsBlockIds):
        raise NotShown("the driver does not expose block ids")
    pair.activate()
    for number in range(1, PAIRS + 1):
        pair.grab_pair()
        check(pair.block_ids == (number, number), f"block {number} from both", pair.block_ids)


@case("G36", "the cameras differ in MAC address, serial number and IP address")
def cameras_differ(dut: DeviceUnderTest) -> None:
    memories = [camera.memory(0, DISCOVERY_BYTES) for camera in cameras(dut)]
    for begin, count, what in (
        (Bootstrap.MAC_HIGH, 8, "MAC address"),
        (Bootstrap.SERIAL_NUMBER, TEXT_BYTES[Bootstrap.SERIAL_NUMBER], "serial number"),
        (Bootstrap.CURRENT_ADDRESS, REGISTER_BYTES, "IP address"),
    ):
        values = {memory[begin : begin + count] for memory in memories}
        check(len(values) == len(memories), f"a different {what} for each", len(values))


BROADCAST = "255.255.255.255"
FOUND_LIMIT_S = 2.0
BEATS, BEAT_S = 8, 0.2  # three times the shortest heartbeat time-out
HEARTBEAT_SLACK = 0.1  # of the set time, plus a margin for a busy computer
BUSY_S = 0.4
POLL_S = 0.02


@on_camera("G01", "every camera answers a broadcast discovery from its own address")
def broadcast_discovery(camera: GigeLink) -> None:
    question = struct.pack(">BBHHH", GVCP_KEY, 1, GvcpCommand.DISCOVERY, 0, 11)
    found: set[str] = set()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as caller:
        caller.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        caller.settimeout(FOUND_LIMIT_S)
        caller.bind((camera.local_address, 0))  # the camera's network interface
        try:
            caller.sendto(question, (BROADCAST, GVCP_PORT))
            while camera.address not in found:
                found.add(caller.recvfrom(1024)[1][0])
        except TimeoutError:
            check(False, f"an answer from {camera.address}", ", ".join(sorted(found)) or "none")
        except OSError as error:
            raise NotShown(f"{camera.local_address} cannot broadcast: {error.strerror}") from error


@on_camera("G11", "the first failure of several writes ends the command, with its index")
def several_writes(camera: GigeLink) -> None:
    pairs = ((Bootstrap.SCPD, 7), (Bootstrap.VERSION, 1), (Bootstrap.SCPD, 9))
    with camera_control(camera):
        (before,) = camera.read_registers(Bootstrap.SCPD)
        payload = b"".join(struct.pack(">II", *pair) for pair in pairs)
        answer = camera.exchange(GvcpCommand.WRITEREG, payload)
        camera.expect(answer, GevStatus.WRITE_PROTECT, "the second of three writes")
        index = struct.unpack(">HH", answer.payload)[1] if len(answer.payload) == 4 else None
        check(index == 1, "index 1", index)
        check(camera.read_registers(Bootstrap.SCPD) == [7], "only the first write carried out")
        camera.write(Bootstrap.SCPD, before)


@on_camera("G13", "others may read under control access, but not under exclusive access")
def exclusive_access(camera: GigeLink) -> None:
    with GigeLink(camera.address) as other:
        with camera_control(camera):
            check(other.read_registers(Bootstrap.VERSION) != [], "a value for another reader")
        check(camera.write(Bootstrap.CCP, CCP_EXCLUSIVE) == GevStatus.SUCCESS, "exclusive access")
        try:
            answer = other.exchange(GvcpCommand.READREG, struct.pack(">I", Bootstrap.VERSION))
            other.expect(answer, GevStatus.ACCESS_DENIED, "reading under exclusive access of another")
        finally:
            camera.write(Bootstrap.CCP, CCP_OPEN)


@on_camera("G14", "every command of the controller restarts the heartbeat timer", needs=(HOST_TIME,))
def every_command_is_life(camera: GigeLink) -> None:
    with camera_control(camera):
        camera.write(Bootstrap.HEARTBEAT_TIMEOUT_MS, HEARTBEAT_MINIMUM_MS)
        for _ in range(BEATS):
            time.sleep(BEAT_S)
            camera.read_registers(Bootstrap.VERSION)
        check(camera.read_registers(Bootstrap.CCP) == [CCP_CONTROL], "control, kept by reading")


@on_camera(
    "G15", "a silent controller loses control and its stream after the heartbeat time-out", needs=(HOST_TIME,)
)
def silence_ends_control(camera: GigeLink) -> None:
    limit_s = HEARTBEAT_MINIMUM_MS / 1000.0
    with GigeLink(camera.address) as silent, GigeStream(silent) as stream:
        check(silent.write(Bootstrap.CCP, CCP_CONTROL) == GevStatus.SUCCESS, "control")
        stream.configure_small_frames(TriggerMode="Off")
        stream.open_channel()
        start_acquisition(stream).frame()
        silent.write(Bootstrap.HEARTBEAT_TIMEOUT_MS, HEARTBEAT_MINIMUM_MS)
        began_s = time.monotonic()
        while camera.read_registers(Bootstrap.CCP) != [CCP_OPEN]:
            waited_s = time.monotonic() - began_s
            latest_s = limit_s * (1 + HEARTBEAT_SLACK) + BUSY_S
            check(waited_s < latest_s, f"release after {limit_s} s", waited_s)
            time.sleep(POLL_S)
        waited_s = time.monotonic() - began_s
        check(waited_s > limit_s * (1 - HEARTBEAT_SLACK), f"control for {limit_s} s", waited_s)
        check(camera.read_registers(Bootstrap.SCP) == [0], "the channel closed")
        stream.drain_packets()
    with camera_control(camera), GigeStream(camera) as after:
        after.open_channel()
        check(after.silent(), "no acquisition without its controller")
        after.features.execute("UserSetLoad")

"""Cases for a camera's control channel: broadcast discovery, multiple writes, privileges, heartbeat."""

from __future__ import annotations

import socket
import struct
import time

from conformance.case import HOST_TIME, CaseList, NotShown, check
from conformance.device_under_test import DeviceUnderTest
from conformance.gige.link import GigeLink, cameras, controlled
from conformance.gige.stream import GigeStream, started
from ronna_hw.wire.gige_vision import (
    CCP_CONTROL,
    CCP_EXCLUSIVE,
    CCP_OPEN,
    GVCP_KEY,
    GVCP_PORT,
    HEARTBEAT_MINIMUM_MS,
    Bootstrap,
    GevStatus,
    GvcpCommand,
)

BROADCAST = "255.255.255.255"
FOUND_LIMIT_S = 2.0
BEATS, BEAT_S = 8, 0.2  # three times the shortest heartbeat time-out
HEARTBEAT_SLACK = 0.1  # of the set time, plus a margin for a busy computer
BUSY_S = 0.4
POLL_S = 0.02

CASES = CaseList()
case = CASES.case


@case("G01", "every camera answers a broadcast discovery from its own address")
def broadcast_discovery(dut: DeviceUnderTest) -> None:
    question = struct.pack(">BBHHH", GVCP_KEY, 1, GvcpCommand.DISCOVERY, 0, 11)
    for camera in cameras(dut):
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


@case("G11", "the first failure of several writes ends the command, with its index")
def several_writes(dut: DeviceUnderTest) -> None:
    pairs = ((Bootstrap.SCPD, 7), (Bootstrap.VERSION, 1), (Bootstrap.SCPD, 9))
    for camera in cameras(dut):
        with controlled(camera):
            (before,) = camera.registers(Bootstrap.SCPD)
            payload = b"".join(struct.pack(">II", *pair) for pair in pairs)
            answer = camera.exchange(GvcpCommand.WRITEREG, payload)
            camera.expect(answer, GevStatus.WRITE_PROTECT, "the second of three writes")
            index = struct.unpack(">HH", answer.payload)[1] if len(answer.payload) == 4 else None
            check(index == 1, "index 1", index)
            check(camera.registers(Bootstrap.SCPD) == [7], "only the first write carried out")
            camera.write(Bootstrap.SCPD, before)


@case("G13", "others may read under control access, but not under exclusive access")
def exclusive_access(dut: DeviceUnderTest) -> None:
    for camera in cameras(dut):
        with GigeLink(camera.address) as other:
            with controlled(camera):
                check(other.registers(Bootstrap.VERSION) != [], "a value for another reader")
            check(camera.write(Bootstrap.CCP, CCP_EXCLUSIVE) == GevStatus.SUCCESS, "exclusive access")
            try:
                answer = other.exchange(GvcpCommand.READREG, struct.pack(">I", Bootstrap.VERSION))
                other.expect(answer, GevStatus.ACCESS_DENIED, "reading under exclusive access of another")
            finally:
                camera.write(Bootstrap.CCP, CCP_OPEN)


@case("G14", "every command of the controller restarts the heartbeat timer", needs=(HOST_TIME,))
def every_command_is_life(dut: DeviceUnderTest) -> None:
    for camera in cameras(dut):
        with controlled(camera):
            camera.write(Bootstrap.HEARTBEAT_TIMEOUT_MS, HEARTBEAT_MINIMUM_MS)
            for _ in range(BEATS):
                time.sleep(BEAT_S)
                camera.registers(Bootstrap.VERSION)
            check(camera.registers(Bootstrap.CCP) == [CCP_CONTROL], "control, kept by reading")


@case(
    "G15",
    "a silent controller loses control and its stream after the heartbeat time-out",
    needs=(HOST_TIME,),
)
def silence_ends_control(dut: DeviceUnderTest) -> None:
    limit_s = HEARTBEAT_MINIMUM_MS / 1000.0
    for camera in cameras(dut):
        with GigeLink(camera.address) as silent, GigeStream(silent) as stream:
            check(silent.write(Bootstrap.CCP, CCP_CONTROL) == GevStatus.SUCCESS, "control")
            stream.small_frames(TriggerMode="Off")
            stream.open_channel()
            started(stream).frame()
            silent.write(Bootstrap.HEARTBEAT_TIMEOUT_MS, HEARTBEAT_MINIMUM_MS)
            began_s = time.monotonic()
            while camera.registers(Bootstrap.CCP) != [CCP_OPEN]:
                waited_s = time.monotonic() - began_s
                latest_s = limit_s * (1 + HEARTBEAT_SLACK) + BUSY_S
                check(waited_s < latest_s, f"release after {limit_s} s", waited_s)
                time.sleep(POLL_S)
            waited_s = time.monotonic() - began_s
            check(waited_s > limit_s * (1 - HEARTBEAT_SLACK), f"control for {limit_s} s", waited_s)
            check(camera.registers(Bootstrap.SCP) == [0], "the channel closed")
            stream.last_packets()
        with controlled(camera), GigeStream(camera) as after:
            after.open_channel()
            check(after.silent(), "no acquisition without its controller")
            after.features.execute("UserSetLoad")

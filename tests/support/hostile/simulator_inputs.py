"""What clients send to the simulators, and what takes it there, in process and without sockets to clients."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Iterator
from itertools import count
from xml.etree import ElementTree

from good_inputs import CONTROLLER_COMMANDS, CONTROLLER_REQUESTS, Take
from hostile_clients import loading, with_right_checksum

from ronna_hw.bounded_input import InputRefused, parse_xml
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.wire.gige_vision import (
    GVCP_ACK_HEADER,
    GVCP_COMMAND_HEADER,
    GVCP_HEADER_BYTES,
    GVCP_KEY,
    READMEM_COMMAND,
    READREG_ITEM,
    WRITEMEM_HEAD,
    WRITEREG_ITEM,
    Bootstrap,
    GvcpCommand,
)
from ronna_hw.wire.kuka_context import load_context
from ronna_hw.wire.polaris import BX_START, crc16
from sim.basler.control.bootstrap import Identity
from sim.basler.control.feature_table import address_of
from sim.basler.device import SimulatedCamera
from sim.basler.settings import FrameSettings, TriggerMoments
from sim.kuka.autostart import Autostart
from sim.kuka.controller import Controller
from sim.kuka.controller_parameters import ControllerParameters
from sim.kuka.eki.project_channel import ProjectChannel
from sim.kuka.eki.sdk_channel import SdkChannel
from sim.kuka.eki.server import BUFFER_LIMIT_BYTES, EkiServer, split_requests
from sim.kuka.manipulator import Manipulator
from sim.polaris.line.interpreter import CommandInterpreter
from sim.polaris.tracker_unit import SimulatedUnit
from sim.polaris.unit.framing import LineBuffer
from sim.polaris.unit.tool_definition import BadDefinition, parse_definition, write_definition
from sim.world.scene.named_scenes import draw_scene, robot_frame
from sim.world.world import World

LONGEST_HOST_LINE = 1024
PIECE_BYTES = 50
CYCLES = 20  # of the controller after a conversation: what it began goes on
PEER = ("127.0.0.1", 40001)
RECORD = struct.Struct(">BHH")  # flags, command and length of the payload, before the payload
TRACKED = (b"PENA 01D", b"TSTART ", b"BX 1801", b"TX 1801", b"TSTOP ", b"PHINF 01007F")


def simulator_parsers() -> dict[str, tuple[tuple[bytes, ...], Take]]:
    """What each takes when all is well, and what takes it."""
    bench = World.create(draw_scene("bench"), paced=False)
    rom = write_definition(robot_frame())
    return {
        "simulated camera": (_camera_conversations(), _camera(bench)),
        "simulated tracker": (
            (b"\r".join((b"VER 4", b"GET *", b"INIT ", *loading(rom), *TRACKED, b"BEEP 1", b"")),),
            lambda data: _told(bench, data),
        ),
        "simulated tracker .rom": ((rom,), lambda data: _loaded(bench, data)),
        "EKI request": ((b"".join(CONTROLLER_COMMANDS),), _channel(ProjectChannel)),
        "EKI SDK request": ((b"".join(CONTROLLER_REQUESTS),), _channel(SdkChannel)),
    }


# -- tracker


def _told(world: World, data: bytes) -> None:
    interpreter, lines = CommandInterpreter(SimulatedUnit(world)), LineBuffer(LONGEST_HOST_LINE)
    for begin in range(0, len(data), PIECE_BYTES):
        for line in lines.feed(data[begin : begin + PIECE_BYTES], 0.0):
            _well_formed(interpreter.reply(line))
        interpreter.unsolicited_bytes()


def _loaded(world: World, data: bytes) -> None:
    for definition in (data, with_right_checksum(data)):
        with contextlib.suppress(BadDefinition):
            parse_definition(definition)
            _told(world, b"\r".join((b"INIT ", *loading(definition), *TRACKED, b"")))


def _well_formed(reply: bytes) -> None:
    if reply.startswith(struct.pack("<H", BX_START)):
        assert len(reply) == int.from_bytes(reply[2:4], "little") + 8
        assert crc16(reply[:6]) == crc16(reply[6:]) == 0
    elif reply:
        assert reply.endswith(b"%04X\r" % crc16(reply[:-5]))


# -- controller


class _Told(EkiServer):
    """An EKI server with a client that reads whatever is sent, which must be whole telegrams."""

    def __init__(self) -> None:
        super().__init__(parse_endpoint("tcp://127.0.0.1:0", listening=True))
        self.close()  # nobody connects

    @property
    def connected(self) -> bool:
        return True

    def send(self, text: str) -> None:
        ElementTree.fromstring(text)

    def drop(self) -> None:
        pass


def _channel(kind: type[ProjectChannel] | type[SdkChannel]) -> Take:
    scene, context, parameters = draw_scene("mini"), load_context(), ControllerParameters()
    server = _Told()

    def take(data: bytes) -> None:
        requests, rest = split_requests(data)
        assert sum(map(len, requests)) + len(rest) <= len(data)
        arm = Manipulator(scene.arm, scene.seed, lambda _state: None, parameters)
        controller = Controller(context, arm, lambda: 1, parameters)
        channel = kind(server, controller, Autostart(controller, is_requested=False))
        for number, request in enumerate(requests):
            with contextlib.suppress(InputRefused):
                channel.request(parse_xml(request, BUFFER_LIMIT_BYTES))
            _cycle(controller)
            channel.tick(float(number))
        for _ in range(CYCLES):
            _cycle(controller)

    return take


def _cycle(controller: Controller) -> None:
    if controller.run is None:
        controller.settle()
    else:
        controller.run.telegram(controller.arm.reported_frame, controller.arm.reported_deg)
        controller.finish_cycle(None)


# -- camera


class _PlainImages:
    def place(self) -> bytes | None:
        return None

    def triggered(self, frame: FrameSettings, _number: int) -> bytes:
        return bytes(frame.payload_bytes)

    def running(self, frame: FrameSettings, _number: int) -> tuple[FrameSettings, bytes]:
        return frame, bytes(frame.payload_bytes)


def _camera(world: World) -> Take:
    """Every record becomes a command with a right header, of the application in control."""
    moments = TriggerMoments(world.clock)

    def take(data: bytes) -> None:
        camera = SimulatedCamera(
            Identity("127.0.0.1", "21904411", "left"), _PlainImages(), world.clock, moments
        )
        numbers = count(1)
        try:
            for flags, command, payload in _records(data):
                head = struct.pack(
                    GVCP_COMMAND_HEADER, GVCP_KEY, flags, command, len(payload), next(numbers) % 0xFFFF + 1
                )
                _acknowledges(camera.port.answer(head + payload, PEER))
            _acknowledges(camera.port.answer(data, PEER))
        finally:
            camera.close()
            camera.channel.close()
            camera.messages.close()

    return take


def _acknowledges(answer: bytes | None) -> None:
    if answer is not None:
        assert struct.unpack_from(GVCP_ACK_HEADER, answer)[2] == len(answer) - GVCP_HEADER_BYTES


def _records(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    while len(data) >= RECORD.size:
        flags, command, length = RECORD.unpack_from(data)
        payload, data = data[RECORD.size :][:length], data[RECORD.size + length :]
        yield flags, command, payload


def _camera_conversations() -> tuple[bytes, ...]:
    def record(command: GvcpCommand, payload: bytes = b"") -> bytes:
        return RECORD.pack(1, command, len(payload)) + payload

    def write(address: int, value: int) -> bytes:
        return record(GvcpCommand.WRITEREG, struct.pack(WRITEREG_ITEM, address, value))

    control = write(Bootstrap.CCP, 2)
    small = write(address_of("Width"), 64) + write(address_of("Height"), 48)
    stream = write(Bootstrap.SCDA, 0x7F000001) + write(Bootstrap.SCP, 9)
    rate = struct.unpack(">I", struct.pack(">f", 20.0))[0]
    return (
        record(GvcpCommand.DISCOVERY)
        + control
        + small
        + write(address_of("AcquisitionFrameRateAbs"), rate)
        + record(GvcpCommand.READREG, struct.pack(READREG_ITEM, address_of("PayloadSize"))),
        control
        + small
        + stream
        + write(address_of("AcquisitionStart"), 1)
        + write(Bootstrap.SCPS, 0x800005DC),
        control
        + record(GvcpCommand.WRITEMEM, struct.pack(WRITEMEM_HEAD, 0xE8) + b"left".ljust(16, b"\0"))
        + record(GvcpCommand.READMEM, struct.pack(READMEM_COMMAND, Bootstrap.FIRST_URL, 0, 512))
        + write(address_of("UserSetSelector"), 1)
        + write(address_of("UserSetSave"), 1)
        + write(Bootstrap.CCP, 0),
    )

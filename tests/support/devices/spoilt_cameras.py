"""Simulated cameras in this process, and single mistakes to make in one of them."""

from __future__ import annotations

import io
import struct
import threading
import zipfile
from collections.abc import Callable
from typing import Any

import pytest

from conformance.case import OUTPUT
from conformance.gige.protocol import PROTOCOL
from conformance.report import CaseResult, run_case
from conformance.target import build_device_under_test
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.wire.gige_vision import TEXT_BYTES, Bootstrap, GevStatus, GvcpCommand
from sim.basler.control.bootstrap import XML_ADDRESS
from sim.basler.control.feature_table import address_of
from sim.basler.control.port import Actions
from sim.basler.control.registers import Memory, RegisterRefusal, RegisterWord
from sim.basler.device import SimulatedCamera
from sim.basler.faults import NoFaults
from sim.basler.server import CameraPair
from sim.basler.stream_channel import Block, StreamChannel
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World

SERVE_LIMIT_S = 10.0
LONG_S = 1.0  # until a controller that should be forgotten will be

Patch = pytest.MonkeyPatch
Mistake = Callable[[SimulatedCamera, Patch], None]


class Stand:
    """Both cameras, served by a thread of this process."""

    def __init__(self, scene: Scene | None = None) -> None:
        self.world = World.create(scene or draw_scene("bench"), paced=True)
        self.pair = CameraPair(self.world)
        self.left, self.right = self.pair._cameras
        self._thread = threading.Thread(target=self.pair.serve)
        self._thread.start()

    def run(self, number: str) -> CaseResult:
        config = DeviceConfig(driver="basler_stereo", endpoints=self.pair.endpoints)
        dut = build_device_under_test("stereo", config, HostClock(), frozenset({OUTPUT.name}))
        try:
            return run_case(next(case for case in PROTOCOL.cases if case.number == number), dut)
        finally:
            dut.release()

    def close(self) -> None:
        self.pair.end()
        self._thread.join(SERVE_LIMIT_S)
        server = self.pair._server
        for key in list(server._selector.get_map().values()):
            key.fileobj.close()  # type: ignore[union-attr]
        server._selector.close()
        server._waker.close()
        for camera in (self.left, self.right):
            camera.channel.close()
            camera.messages.close()


def handle(command: GvcpCommand, change: Callable[[SimulatedCamera, Callable[..., bytes]], Any]) -> Mistake:
    """Another handler of a command, made from the true one."""

    def spoil(camera: SimulatedCamera, _patch: Patch) -> None:
        camera.port._handlers[command] = change(camera, camera.port._handlers[command])

    return spoil


def register(address: int, read: Callable[[SimulatedCamera], int], write: Any = None) -> Mistake:
    """Another register; `write` gets camera and value."""

    def spoil(camera: SimulatedCamera, _patch: Patch) -> None:
        setter = None if write is None else lambda value: write(camera, value)
        camera.registers._words[address] = RegisterWord(lambda: read(camera), setter)

    return spoil


def block(address: int, content: Callable[[bytes], bytes]) -> Mistake:
    """Other content of a block of memory."""

    def spoil(camera: SimulatedCamera, _patch: Patch) -> None:
        blocks = camera.registers._blocks
        (place,) = (n for n, each in enumerate(blocks) if each.address == address)
        altered = content(blocks[place].content())
        blocks[place] = Memory(address, blocks[place].size, lambda: altered)

    return spoil


def member(path: str, make: Callable[[SimulatedCamera, Any], Any]) -> Mistake:
    """Another attribute of the camera or a part of it, made from the true one."""

    def spoil(camera: SimulatedCamera, patch: Patch) -> None:
        *parts, name = path.split(".")
        owner: Any = camera
        for part in parts:
            owner = getattr(owner, part)
        patch.setattr(owner, name, make(camera, getattr(owner, name)))

    return spoil


def does_nothing(*_arguments: Any) -> None:
    return None


def denies_while_controlled(camera: SimulatedCamera, true: Callable[..., bytes]) -> Callable[..., bytes]:
    def discovery(*arguments: Any) -> bytes:
        if camera.privilege.owner is not None:
            raise RegisterRefusal(GevStatus.ACCESS_DENIED)
        return true(*arguments)

    return discovery


def in_reverse(_camera: SimulatedCamera, true: Callable[..., bytes]) -> Callable[..., bytes]:
    def read_registers(*arguments: Any) -> bytes:
        words = struct.iter_unpack("4s", true(*arguments))
        return b"".join(word for (word,) in reversed(list(words)))

    return read_registers


def in_small_pieces(_camera: SimulatedCamera, true: Callable[..., bytes]) -> Callable[..., bytes]:
    def read_memory(payload: bytes, *others: Any) -> bytes:
        if struct.unpack(">IHH", payload)[2] > 512:
            raise RegisterRefusal(GevStatus.INVALID_PARAMETER)
        return true(payload, *others)

    return read_memory


def forgiving(status: GevStatus) -> Callable[[SimulatedCamera, Any], Any]:
    """Registers that keep quiet about one kind of mistake."""

    def make(_camera: SimulatedCamera, true: Callable[..., Any]) -> Callable[..., Any]:
        def access(*arguments: Any) -> Any:
            try:
                return true(*arguments)
            except RegisterRefusal as refusal:
                if refusal.status is not status:
                    raise
                return 0

        return access

    return make


def tells_no_index(_camera: SimulatedCamera, true: Callable[..., bytes]) -> Callable[..., bytes]:
    def write_registers(*arguments: Any) -> bytes:
        try:
            return true(*arguments)
        except RegisterRefusal as refusal:
            raise RegisterRefusal(refusal.status, 0) from refusal

    return write_registers


def gives_way(camera: SimulatedCamera, true: Callable[..., GevStatus]) -> Callable[..., GevStatus]:
    def request(peer: Any, value: int) -> GevStatus:
        if value:
            camera.privilege.owner = None
        return true(peer, value)

    return request


def starts_by_itself(camera: SimulatedCamera, true: Callable[[], None]) -> Callable[[], None]:
    def software_trigger() -> None:
        camera.acquisition.start()
        true()

    return software_trigger


def twice(_camera: SimulatedCamera, true: Callable[..., None]) -> Callable[..., None]:
    def do(*arguments: Any) -> None:
        true(*arguments)
        true(*arguments)

    return do


def no_default_destination(_camera: SimulatedCamera, patch: Patch) -> None:
    true = StreamChannel.receiver
    patch.setattr(
        StreamChannel,
        "receiver",
        property(lambda channel: None if channel.destination == "0.0.0.0" else true.__get__(channel)),
    )


def short_packets(_camera: SimulatedCamera, patch: Patch) -> None:
    true = Block.__init__

    def shorter(self: Block, block_id: int, frame: Any, packet_size: int) -> None:
        true(self, block_id, frame, packet_size - 100)

    patch.setattr(Block, "__init__", shorter)


class ShiftedLeader(NoFaults):
    def active(self, kind: str) -> bool:
        return kind == "shift_area"


def only_known_blocks(camera: SimulatedCamera, true: Actions) -> Actions:
    def resend(block_id: int, first: int, last: int) -> None:
        if any(kept.block_id == block_id for kept in camera.channel._kept):
            true.resend(block_id, first, last)

    return Actions(resend, true.act)


def obeys_every_action(camera: SimulatedCamera, true: Actions) -> Actions:
    def act(*_keys: int) -> bool:
        camera.acquisition.action()
        return True

    return Actions(true.resend, act)


def pack_description(camera: SimulatedCamera, patch: Patch) -> None:
    """Deliver it as real cameras of the family are believed to do."""
    xml = next(each for each in camera.registers._blocks if each.address == XML_ADDRESS).read()
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("camera.xml", xml)
    url = f"Local:camera.zip;{XML_ADDRESS:x};{len(packed.getvalue()):x}"
    block(XML_ADDRESS, lambda _: packed.getvalue())(camera, patch)
    block(Bootstrap.FIRST_URL, lambda _: url.encode())(camera, patch)


def lose_a_register(camera: SimulatedCamera, _patch: Patch) -> None:
    del camera.registers._words[address_of("BlackLevelRaw")]


def know_a_further_command(camera: SimulatedCamera, _patch: Patch) -> None:
    camera.port._handlers[0x0F00] = lambda *_: b""


def serial_of_the_other(content: bytes) -> bytes:
    place = Bootstrap.SERIAL_NUMBER
    other = b"21904412".ljust(TEXT_BYTES[place], b"\0")
    return content[:place] + other


def set_gain(camera: SimulatedCamera, value: int) -> None:
    camera.settings.gain_raw = value


def set_width(camera: SimulatedCamera, value: int) -> None:
    camera.settings.width = value


def store_heartbeat(camera: SimulatedCamera, value: int) -> None:
    camera.privilege._heartbeat_ms = value


def unlocked(_camera: SimulatedCamera, patch: Patch) -> None:
    patch.setattr(SimulatedCamera, "acquiring", property(lambda camera: False))


def always_fifty(_camera: SimulatedCamera, patch: Patch) -> None:
    patch.setattr("sim.basler.camera.acquisition.free_running_period_us", lambda settings: 20_000.0)

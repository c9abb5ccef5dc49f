"""GVCP command processing for one camera, without sockets: each datagram yields at most one answer."""

from __future__ import annotations

import struct
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap, GevStatus, GvcpCommand, GvcpFlag
from sim.basler.control.privilege import Peer, Privilege
from sim.basler.control.registers import RegisterMap, RegisterRefusal

PEERS_KEPT = 16
KEPT_S = 3.0  # clients retry after 0.2 to 0.5 s, up to five times

MAC_BYTES = 6
ADDRESS_BYTES = 4


class CommandIgnored(Exception):
    """The command must not be answered."""


@dataclass(frozen=True)
class Actions:
    """Effects of commands other than register accesses."""

    resend: Callable[[int, int, int], None]
    """Block id, first and last packet."""
    act: Callable[[int, int, int], bool]
    """Device key, group key, group mask; returns True if addressed to this camera."""


class GvcpPort:
    """Control port of one camera, identified by its `mac` and IP `address`."""

    def __init__(
        self,
        registers: RegisterMap,
        privilege: Privilege,
        replay: ReplayCache,
        actions: Actions,
        *,
        mac: bytes,
        address: bytes,
        refreshes_heartbeat: Callable[[], bool] = lambda: True,
    ) -> None:
        self._registers = registers
        self._privilege = privilege
        self._replay = replay
        self._actions = actions
        self._mac = mac
        self._address = address
        self._refreshes_heartbeat = refreshes_heartbeat
        self._handlers: dict[int, Callable[[bytes, Peer, int], bytes]] = {
            GvcpCommand.DISCOVERY: self._discovery,
            GvcpCommand.FORCEIP: self._force_ip,
            GvcpCommand.READREG: self._read_registers,
            GvcpCommand.WRITEREG: self._write_registers,
            GvcpCommand.READMEM: self._read_memory,
            GvcpCommand.WRITEMEM: self._write_memory,
            GvcpCommand.PACKETRESEND: self._packet_resend,
            GvcpCommand.ACTION: self._action,
        }

    def answer(self, datagram: bytes, peer: Peer) -> bytes | None:
        """Execute the command in a datagram and return the answer, or None if none is due."""
        if len(datagram) < gev.GVCP_HEADER_BYTES or datagram[0] != gev.GVCP_KEY:
            return None
        _, flags, command, length, request_id = struct.unpack_from(gev.GVCP_COMMAND_HEADER, datagram)
        payload = datagram[gev.GVCP_HEADER_BYTES :]
        if request_id == 0 or len(payload) != length or length > gev.GVCP_PAYLOAD_LIMIT:
            return None
        if self._refreshes_heartbeat():
            self._privilege.refresh_heartbeat(peer)
        before = self._replay.find(peer, datagram)
        if before is not None:
            return before.answer
        reply = self._execute(command, payload, peer, flags, request_id)
        if not flags & GvcpFlag.ACK_REQUIRED:
            reply = None
        if command in (GvcpCommand.WRITEREG, GvcpCommand.WRITEMEM, GvcpCommand.ACTION):
            self._replay.keep(peer, datagram, reply)
        return reply

    def _execute(self, command: int, payload: bytes, peer: Peer, flags: int, request_id: int) -> bytes | None:
        handler = self._handlers.get(command)
        if handler is None:
            return _acknowledge(command + 1 & 0xFFFF, GevStatus.NOT_IMPLEMENTED, b"", request_id)
        try:
            content, status = handler(payload, peer, flags), GevStatus.SUCCESS
        except CommandIgnored:
            return None
        except RegisterRefusal as refusal:
            status = refusal.status
            # A write command's answer also states how far it got.
            writes = command in (GvcpCommand.WRITEREG, GvcpCommand.WRITEMEM)
            content = struct.pack(gev.WRITE_ACK, 0, refusal.written) if writes else b""
        except struct.error:
            content, status = b"", GevStatus.INVALID_HEADER
        return _acknowledge(command + 1, status, content, request_id)

    def _discovery(self, _payload: bytes, _peer: Peer, _flags: int) -> bytes:
        return self._registers.read(0, gev.DISCOVERY_BYTES)

    def _force_ip(self, payload: bytes, _peer: Peer, _flags: int) -> bytes:
        """Execute FORCEIP, accepting only the present address, to which the camera's socket is bound."""
        if len(payload) != gev.FORCEIP_BYTES:
            raise RegisterRefusal(GevStatus.INVALID_HEADER)
        if payload[gev.FORCEIP_MAC_OFFSET : gev.FORCEIP_MAC_OFFSET + MAC_BYTES] != self._mac:
            raise CommandIgnored
        if self._privilege.owner is not None:
            raise RegisterRefusal(GevStatus.ACCESS_DENIED)
        requested_address = payload[gev.FORCEIP_ADDRESS_OFFSET : gev.FORCEIP_ADDRESS_OFFSET + ADDRESS_BYTES]
        if requested_address not in (self._address, bytes(ADDRESS_BYTES)):
            raise RegisterRefusal(GevStatus.LOCAL_PROBLEM)
        return b""

    def _read_registers(self, payload: bytes, peer: Peer, _flags: int) -> bytes:
        self._check_readable(peer)
        addresses = [address for (address,) in _unpack_items(gev.READREG_ITEM, payload)]
        return b"".join(
            struct.pack(gev.READREG_ACK_ITEM, self._registers.read_word(address)) for address in addresses
        )

    def _write_registers(self, payload: bytes, peer: Peer, _flags: int) -> bytes:
        pairs = _unpack_items(gev.WRITEREG_ITEM, payload)
        for index, (address, value) in enumerate(pairs):
            try:
                self._write_word(address, value, peer)
            except RegisterRefusal as refusal:
                raise RegisterRefusal(refusal.status, index) from refusal
        return struct.pack(gev.WRITE_ACK, 0, len(pairs))

    def _read_memory(self, payload: bytes, peer: Peer, _flags: int) -> bytes:
        self._check_readable(peer)
        address, _, count = struct.unpack(gev.READMEM_COMMAND, payload)
        if not 0 < count <= gev.READMEM_LIMIT:
            raise RegisterRefusal(GevStatus.INVALID_PARAMETER)
        return struct.pack(gev.READMEM_ACK_HEAD, address) + self._registers.read(address, count)

    def _write_memory(self, payload: bytes, peer: Peer, _flags: int) -> bytes:
        (address,) = struct.unpack_from(gev.WRITEMEM_HEAD, payload)
        data = payload[struct.calcsize(gev.WRITEMEM_HEAD) :]
        if not data:
            raise RegisterRefusal(GevStatus.INVALID_PARAMETER)
        if address == Bootstrap.CCP and len(data) == ADDRESS_BYTES:
            self._write_word(address, int.from_bytes(data, "big"), peer)
        elif not self._privilege.may_write(peer):
            raise RegisterRefusal(GevStatus.ACCESS_DENIED)
        else:
            self._registers.write(address, data)
        return struct.pack(gev.WRITE_ACK, 0, len(data))

    def _packet_resend(self, payload: bytes, peer: Peer, flags: int) -> bytes:
        # The stream's receiver requests from a port of its own, so only the address must be the owner's.
        owner = self._privilege.owner
        if owner is None or owner[0] != peer[0]:
            raise CommandIgnored
        if flags & GvcpFlag.EXTENDED_ID:
            _, _, first, last, block_id = struct.unpack(gev.PACKETRESEND_EXTENDED, payload)
        else:
            _, block_id, first, last = struct.unpack(gev.PACKETRESEND_COMMAND, payload)
            first, last = first & gev.GVSP_PACKET_ID_MASK, last & gev.GVSP_PACKET_ID_MASK
        self._actions.resend(block_id, first, last)
        raise CommandIgnored

    def _action(self, payload: bytes, _peer: Peer, flags: int) -> bytes:
        keys = struct.unpack_from(gev.ACTION_COMMAND, payload)
        if flags & GvcpFlag.SCHEDULED:
            raise RegisterRefusal(GevStatus.NO_REFERENCE_TIME)  # no clock is shared with the application
        if self._privilege.owner is None or not self._actions.act(*keys):
            raise CommandIgnored
        return b""

    def _write_word(self, address: int, value: int, peer: Peer) -> None:
        if address == Bootstrap.CCP:
            status = self._privilege.request(peer, value)
            if status is not GevStatus.SUCCESS:
                raise RegisterRefusal(status)
        elif not self._privilege.may_write(peer):
            raise RegisterRefusal(GevStatus.ACCESS_DENIED)
        else:
            self._registers.write_word(address, value)

    def _check_readable(self, peer: Peer) -> None:
        if not self._privilege.may_read(peer):
            raise RegisterRefusal(GevStatus.ACCESS_DENIED)


@dataclass(frozen=True)
class AnsweredCommand:
    """A command with its answer, or None if no answer was required."""

    datagram: bytes
    answer: bytes | None
    at_s: float


class ReplayCache:
    """Caches each application's last modifying command, so that a repeat is answered but not re-executed.

    `now_s` is the host's monotonic clock.
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._last: OrderedDict[Peer, AnsweredCommand] = OrderedDict()

    def find(self, peer: Peer, datagram: bytes) -> AnsweredCommand | None:
        """Return the stored answer if this command (with its request id) was the last one; otherwise None."""
        last = self._last.get(peer)
        if last is None or last.datagram != datagram or self._now_s() - last.at_s > KEPT_S:
            return None
        return last

    def keep(self, peer: Peer, datagram: bytes, answer: bytes | None) -> None:
        """Store the answer to a command."""
        self._last[peer] = AnsweredCommand(datagram, answer, self._now_s())
        self._last.move_to_end(peer)
        while len(self._last) > PEERS_KEPT:
            self._last.popitem(last=False)


def _unpack_items(layout: str, payload: bytes) -> list[tuple[int, ...]]:
    if not payload:
        raise RegisterRefusal(GevStatus.INVALID_PARAMETER)
    return list(struct.iter_unpack(layout, payload))


def _acknowledge(code: int, status: GevStatus, content: bytes, request_id: int) -> bytes:
    return struct.pack(gev.GVCP_ACK_HEADER, status, code, len(content), request_id) + content

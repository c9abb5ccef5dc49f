"""Setup of an RTDE connection: protocol version, recipes; the packages are the real-time process's."""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

from drivers.universal_robots.errors import BAD_BYTES, STREAM_ERRORS, WRONG_VERSION, RegistersInUse
from drivers.universal_robots.realtime.packages import HEADER, INPUT_FIELDS, OUTPUT_FIELDS
from ronna_hw.arm_stream.control_channel import describe, open_connection
from ronna_hw.arm_stream.errors import ControllerLost, MalformedMessage, NoAnswer
from ronna_hw.wire import universal_robots as wire
from ronna_hw.wire.universal_robots import PackageType

PROTOCOL_VERSION = 2
LONGEST_PACKAGE_BYTES = 4096
READ_HZ = 125.0  # every cycle of CB3
SKIPPED_PACKAGES = 100  # messages and data before a reply
_FREQUENCY = struct.Struct(">d")
_VERSION = struct.Struct(">4I")


class Version(NamedTuple):
    """Version of the controller's software."""

    major: int
    minor: int
    bugfix: int
    build: int

    def __str__(self) -> str:
        return ".".join(map(str, self))


class RtdeSetup:
    """Connection to an RTDE server until it is handed over."""

    def __init__(self, host: str, port: int, timeout_s: float) -> None:
        """Connect and agree on version 2 of the protocol; raises URD-002 or URD-004."""
        self.where = f"tcp://{host}:{port}"
        self._deadline = time.monotonic() + timeout_s
        self.socket = open_connection(host, port, timeout_s, STREAM_ERRORS.not_found)
        try:
            accepted = self._ask(PackageType.PROTOCOL_VERSION, struct.pack(">H", PROTOCOL_VERSION))
        except (NoAnswer, ControllerLost, MalformedMessage) as error:
            self.close()
            raise STREAM_ERRORS.not_found(
                f"{self.where} is open, but no RTDE server answers there"
            ) from error
        if accepted[:1] != b"\x01":
            self.close()
            raise WRONG_VERSION(f"{self.where} does not speak version {PROTOCOL_VERSION} of RTDE")

    def close(self) -> None:
        """Close the connection; never raises."""
        with contextlib.suppress(OSError):
            self.socket.close()

    def read_version(self) -> Version:
        """Return the version of the controller's software."""
        reply = self._ask(PackageType.CONTROLLER_VERSION)
        if len(reply) < _VERSION.size:
            raise self._bad("version", reply)
        return Version(*_VERSION.unpack_from(reply))

    def set_up_outputs(self, frequency_hz: float, fields: Sequence[str] = OUTPUT_FIELDS) -> int:
        """Ask for output fields at this frequency and return the recipe; raises URD-004."""
        names = ",".join(fields).encode()
        reply = self._ask(PackageType.SETUP_OUTPUTS, _FREQUENCY.pack(frequency_hz) + names)
        recipe, types = self._split(reply, len(fields))
        for name, kind in zip(fields, types, strict=True):
            self._require_type(name, kind, wire.OUTPUTS[name].name)
        if recipe == wire.NO_RECIPE:
            raise WRONG_VERSION(f"{self.where} gives no recipe for {frequency_hz:g} packages a second")
        return recipe

    def set_up_inputs(self) -> int:
        """Claim our input registers and return the recipe; raises URD-012 if another client has them."""
        reply = self._ask(PackageType.SETUP_INPUTS, ",".join(INPUT_FIELDS).encode())
        recipe, types = self._split(reply, len(INPUT_FIELDS))
        taken = [name for name, kind in zip(INPUT_FIELDS, types, strict=True) if kind == wire.IN_USE]
        if taken:
            raise RegistersInUse(
                f"{self.where}: another client, or a fieldbus, owns {len(taken)} of our registers",
                got=", ".join(taken[:3]) + (" ..." if len(taken) > 3 else ""),
            )
        for name, kind in zip(INPUT_FIELDS, types, strict=True):
            self._require_type(name, kind, wire.INPUTS[name].name)
        if recipe == wire.NO_RECIPE:
            raise WRONG_VERSION(f"{self.where} gives no recipe for our set-points")
        return recipe

    def read_outputs(
        self, fields: Sequence[str], accept: Callable[[tuple[float, ...]], bool]
    ) -> tuple[float, ...]:
        """Return the first values that are accepted, or the last ones before the time limit."""
        recipe = self.set_up_outputs(READ_HZ, fields)
        self._ask(PackageType.START)
        layout = struct.Struct(">B" + "".join(wire.OUTPUTS[name].codes for name in fields))
        values: tuple[float, ...] | None = None
        while values is None or time.monotonic() < self._deadline:
            try:
                package = self._await_package(PackageType.DATA, "for data")
            except NoAnswer:
                if values is None:
                    raise
                break
            if len(package) >= layout.size and package[0] == recipe:
                values = layout.unpack_from(package)[1:]
                if accept(values):
                    break
        return values

    def _split(self, reply: bytes, count: int) -> tuple[int, list[str]]:
        types = reply[1:].decode(errors="replace").split(",")
        if not reply or len(types) != count:
            raise self._bad("recipe", reply)
        return reply[0], types

    def _require_type(self, name: str, kind: str, expected: str) -> None:
        if kind == wire.NOT_FOUND:
            raise WRONG_VERSION(f"{self.where} has no field {name}")
        if kind != expected:
            raise BAD_BYTES(f"{self.where}: field {name} has another type", expected=expected, got=kind)

    def _ask(self, kind: PackageType, payload: bytes = b"") -> bytes:
        """Send a request and return the payload of its reply; messages in between are skipped."""
        try:
            for _ in range(SKIPPED_PACKAGES):  # what has come before the request cannot be its reply
                if not self._has_unread():
                    break
                self._read_package()
            self.socket.settimeout(max(0.0, self._deadline - time.monotonic()))
            self.socket.sendall(HEADER.pack(wire.RTDE_HEADER_BYTES + len(payload), kind) + payload)
        except OSError as error:
            raise STREAM_ERRORS.lost(f"{self.where}: {describe(error)}") from error
        return self._await_package(kind, kind.name)

    def _await_package(self, kind: PackageType, request: str) -> bytes:
        try:
            for _ in range(SKIPPED_PACKAGES):
                answered, reply = self._read_package()
                if answered == kind:
                    return reply
        except TimeoutError as error:
            raise STREAM_ERRORS.no_answer(f"{self.where} does not answer the request {request}") from error
        except OSError as error:
            raise STREAM_ERRORS.lost(f"{self.where}: {describe(error)}") from error
        raise BAD_BYTES(f"{self.where} does not answer the request {request}, but sends other packages")

    def _has_unread(self) -> bool:
        self.socket.settimeout(0.0)
        try:
            return bool(self.socket.recv(1, socket.MSG_PEEK))
        except BlockingIOError:
            return False

    def _read_package(self) -> tuple[int, bytes]:
        """Return kind and payload of the next package, and leave all that follows it to be read."""
        size, kind = HEADER.unpack(self._receive(wire.RTDE_HEADER_BYTES))
        if not wire.RTDE_HEADER_BYTES <= size <= LONGEST_PACKAGE_BYTES:
            raise BAD_BYTES(f"{self.where} sends a package of {size} bytes, which none has")
        return kind, self._receive(size - wire.RTDE_HEADER_BYTES)

    def _receive(self, count: int) -> bytes:
        received = b""
        while len(received) < count:
            # Past the limit it still takes a reply that has come while this program did not run.
            self.socket.settimeout(max(0.0, self._deadline - time.monotonic()))
            try:
                data = self.socket.recv(count - len(received))
            except BlockingIOError:
                raise TimeoutError from None
            if not data:
                raise STREAM_ERRORS.lost(f"{self.where} closed the connection")
            received += data
        return received

    def _bad(self, what: str, reply: bytes) -> MalformedMessage:
        return BAD_BYTES(f"{self.where}: the reply with the {what} cannot be read", wire=reply)

"""One RTDE client: its protocol version, recipes, and the packages that it sends."""

from __future__ import annotations

from collections.abc import Iterable
from struct import Struct, error, pack
from typing import Protocol

from ronna_hw.wire import universal_robots as wire
from ronna_hw.wire.universal_robots import MessageLevel, PackageType
from sim.universal_robots.controller_parameters import ControllerParameters
from sim.universal_robots.model import Model
from sim.universal_robots.rtde.recipes import InputRecipe, OutputRecipe, field_list, type_names

HEADER = Struct(wire.RTDE_HEADER)
SOURCE = "RTDE"
DATA = PackageType.DATA.value


class Exchange(Protocol):
    """Services of the server for each session."""

    parameters: ControllerParameters
    model: Model

    def exists(self, name: str) -> bool:
        """Whether this controller has the field."""

    def is_taken(self, name: str, session: Session) -> bool:
        """Whether another client or a fieldbus owns an input."""

    def take(self, names: Iterable[str], session: Session) -> None:
        """Make a client the owner of inputs."""

    def note_recipes(self) -> None:
        """Look at the output recipes, one of which has changed."""

    def store(self, recipe: InputRecipe, payload: bytes) -> None:
        """Take a package of inputs."""


class BadPackage(Exception):
    """Bytes after which the connection is closed."""


class Session:
    """State of one client, without its socket."""

    def __init__(self, server: Exchange) -> None:
        self._server = server
        self.version = 1
        self.output: OutputRecipe | None = None
        self.inputs: list[InputRecipe] = []
        self.started = False
        self.unread = b""
        self.answers: list[bytes] = []
        self.packages = 0  # of data, so far
        self.sent_cycle = -1  # in which it last got a package of data

    def receive(self, data: bytes) -> None:
        """Take bytes from the client; raises BadPackage."""
        if self.unread:
            data = self.unread + data
        start, end = 0, len(data)
        while end - start >= wire.RTDE_HEADER_BYTES:
            size, kind = HEADER.unpack_from(data, start)
            if size < wire.RTDE_HEADER_BYTES:
                raise BadPackage(f"a package of {size} bytes")
            if end - start < size:
                break
            payload = data[start + wire.RTDE_HEADER_BYTES : start + size]
            start += size
            if kind == DATA:
                self._store(payload)
            else:
                self._answer(kind, payload)
        self.unread = data[start:] if start < end else b""

    def _store(self, payload: bytes) -> None:
        number = payload[0] if payload else wire.NO_RECIPE
        if not 1 <= number <= len(self.inputs):
            self._complain(f"input recipe {number} does not exist")
            return
        recipe = self.inputs[number - 1]
        if len(payload) <= recipe.size_bytes:
            self._handle_short(number, len(payload), recipe)
            return
        self.packages += 1
        self._server.store(recipe, payload)

    def _handle_short(self, number: int, got: int, recipe: InputRecipe) -> None:
        handling = self._server.parameters.short_package
        what = f"package of input recipe {number} has {got} bytes, expected {recipe.size_bytes + 1}"
        if handling == "close":
            raise BadPackage(what)
        if handling == "message":
            self._complain(what)

    def _answer(self, kind: int, payload: bytes) -> None:
        if kind == PackageType.PROTOCOL_VERSION:
            asked = int(self._unpack(">H", payload)[0])
            accepted = 1 <= asked <= int(self._server.parameters.newest_rtde_version)
            if accepted:
                self.version = asked
            self._reply(kind, bytes([accepted]))
        elif kind == PackageType.CONTROLLER_VERSION:
            self._reply(kind, pack(">4I", *self._server.model.version))
        elif kind == PackageType.SETUP_OUTPUTS:
            self._reply(kind, self._set_up_outputs(payload))
        elif kind == PackageType.SETUP_INPUTS:
            self._reply(kind, self._set_up_inputs(payload))
        elif kind == PackageType.START:
            self.started = self.output is not None
            self._reply(kind, bytes([self.started]))
        elif kind == PackageType.PAUSE:
            self.started = False
            self._reply(kind, b"\1")
        elif kind != PackageType.MESSAGE:
            raise BadPackage(f"unknown type {kind}")

    def _set_up_outputs(self, payload: bytes) -> bytes:
        rate = float(self._server.model.rate_hz)
        if self.version > 1:
            (asked_hz,) = self._unpack(">d", payload)
            payload = payload[8:]
            rate = asked_hz if 1.0 <= asked_hz <= rate else rate
        names = self._list(payload)
        known = {name: kind for name, kind in wire.OUTPUTS.items() if self._server.exists(name)}
        types = type_names(names, known)
        valid = bool(names) and wire.NOT_FOUND not in types
        self.output, self.started = None, False
        if valid:
            divider = int(self._server.model.rate_hz / rate)
            self.output = OutputRecipe(1, names, divider, with_number=self.version > 1)
        self._server.note_recipes()
        text = ",".join(types).encode()
        return text if self.version == 1 else bytes([int(valid)]) + text

    def _set_up_inputs(self, payload: bytes) -> bytes:
        names = self._list(payload)
        known = {name: kind for name, kind in wire.INPUTS.items() if self._server.exists(name)}
        types = type_names(names, known)
        types = [
            wire.IN_USE if kind != wire.NOT_FOUND and self._server.is_taken(name, self) else kind
            for name, kind in zip(names, types, strict=True)
        ]
        number = wire.NO_RECIPE
        if names and not {wire.NOT_FOUND, wire.IN_USE} & set(types) and len(self.inputs) < wire.MOST_RECIPES:
            self.inputs.append(InputRecipe(names))
            self._server.take(names, self)
            number = len(self.inputs)
        return bytes([number]) + ",".join(types).encode()

    def _list(self, payload: bytes) -> list[str]:
        if len(payload) > wire.LONGEST_NAME_LIST_BYTES:
            raise BadPackage(f"a list of names of {len(payload)} bytes")
        return field_list(payload)

    def _unpack(self, layout: str, payload: bytes) -> tuple[float, ...]:
        try:
            return Struct(layout).unpack_from(payload)
        except error:
            raise BadPackage(f"a package of {len(payload)} bytes is too short") from None

    def _reply(self, kind: int, payload: bytes) -> None:
        self.answers.append(HEADER.pack(wire.RTDE_HEADER_BYTES + len(payload), kind) + payload)

    def _complain(self, text: str) -> None:
        self.message(text, MessageLevel.WARNING)

    def message(self, text: str, level: MessageLevel) -> None:
        """Send a text message."""
        message = text.encode()[:255]
        if self.version == 1:
            self._reply(PackageType.MESSAGE, bytes([level]) + message)
            return
        source = SOURCE.encode()
        body = bytes([len(message)]) + message + bytes([len(source)]) + source + bytes([level])
        self._reply(PackageType.MESSAGE, body)

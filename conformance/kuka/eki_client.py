"""A plain EKI client of a KUKA controller that bypasses every driver.

It decodes elements independently, following the protocol reference, so that a driver's
misreading cannot hide.
"""

from __future__ import annotations

import re
import socket
import time
from xml.etree import ElementTree

from conformance.case import NotShown, check, read_as
from ronna_hw.bounded_input import parse_xml
from ronna_hw.endpoints import Endpoint

ANSWER_LIMIT_S = 4.0  # as long as the vendor's client waits
MOST_BYTES = 65536
LONGEST_TELEGRAM = 16384  # the default BUFFSIZE of an EKI channel
_ELEMENT = re.compile(rb"<([A-Za-z]\w*)\b[^>]*>.*?</\1>", re.DOTALL)


class EkiLine:
    """One client of one channel. `between` stores the bytes between elements."""

    def __init__(self, endpoint: Endpoint) -> None:
        self.endpoint = endpoint
        self._socket = self._connected()
        self._received = b""
        self._number = 0
        self.between = b""

    def __enter__(self) -> EkiLine:
        return self

    def __exit__(self, *_reason: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()

    def reconnect(self) -> None:
        """Close the connection and connect again."""
        self._socket.close()
        self._received = b""
        self._socket = self._connected()

    def send(self, data: bytes) -> None:
        """Send bytes as they are."""
        self._socket.sendall(data)

    def command(self, name: str, **attributes: object) -> str:
        """Send a command of our channel; returns the identifier in its answers."""
        self._number += 1
        identifier = str(self._number)
        self.send(command(identifier, name, **attributes))
        return identifier

    @read_as("an answer with an integer Code")
    def ask(self, name: str, **attributes: object) -> int:
        """Send a command of our channel and return the code of its acknowledgement."""
        return int(self.answer("Ack", self.command(name, **attributes)).get("Code", "-1"))

    def state(self) -> ElementTree.Element:
        """The answer to STATUS."""
        return self.answer("State", self.command("STATUS"))

    def answer(self, tag: str, identifier: str) -> ElementTree.Element:
        """The element with this tag and identifier; raises Nonconformity if it does not arrive in time."""
        until_s = time.monotonic() + ANSWER_LIMIT_S
        while True:
            while (raw := self._cut_off()) is None:
                left_s = until_s - time.monotonic()
                wanted = f"{tag} {identifier} within {ANSWER_LIMIT_S:g} s"
                room = LONGEST_TELEGRAM - len(self._received)
                check(left_s > 0 and room > 0, wanted, self._received[-80:] or "nothing")
                self._socket.settimeout(left_s)
                try:
                    data = self._socket.recv(room)
                except TimeoutError:
                    continue
                check(bool(data), wanted, "the connection closed by the controller")
                self._received += data
            root = parse_xml(raw, LONGEST_TELEGRAM)
            if root.tag == tag and root.get("Id") == identifier:
                return root

    def closed_by_controller(self, limit_s: float = ANSWER_LIMIT_S) -> bool:
        """Whether the controller closes the connection in time."""
        until_s = time.monotonic() + limit_s
        while (left_s := until_s - time.monotonic()) > 0:
            self._socket.settimeout(left_s)
            try:
                if not self._socket.recv(MOST_BYTES):
                    return True
            except TimeoutError:
                break
            except OSError:
                return True
        return False

    def _cut_off(self) -> bytes | None:
        """The next complete element received."""
        match = _ELEMENT.search(self._received)
        if match is None:
            return None
        self.between += self._received[: match.start()]
        self._received = self._received[match.end() :]
        return match[0]

    def _connected(self) -> socket.socket:
        try:
            opened = socket.create_connection((self.endpoint.host, self.endpoint.port), ANSWER_LIMIT_S)
        except OSError as error:
            raise NotShown(f"no connection to {self.endpoint}: {error.strerror or error}") from error
        opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return opened


def command(identifier: str, name: str, **attributes: object) -> bytes:
    """A command of our channel with a separate end tag."""
    text = "".join(f' {key}="{value}"' for key, value in attributes.items())
    return f'<Cmd Id="{identifier}" Name="{name}"{text}></Cmd>'.encode()

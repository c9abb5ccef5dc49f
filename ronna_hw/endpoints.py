"""Device endpoints. A simulated device differs from a real one only in its endpoint.

udp://127.0.0.1:59152      where the robot's telegrams arrive
tcp://192.168.1.10:54602   a TCP peer
igtl://192.168.1.20:18944  an OpenIGTLink server
serial:///dev/ttyUSB0      a serial line or pseudo-terminal
gev://192.168.3.10         a GigE Vision camera (port 3956 is fixed by the standard)
shm:///proc/1234/fd/5      shared memory, opened as a file
host:                      this machine itself, for the clock
"""

from __future__ import annotations

import os
import socket
from dataclasses import dataclass, replace
from ipaddress import IPv4Address
from urllib.parse import urlsplit

from ronna_hw.errors import ConfigurationError

EXAMPLES = {  # scheme -> an endpoint
    "udp": "udp://192.168.1.5:59152",
    "tcp": "tcp://192.168.1.5:8765",
    "igtl": "igtl://192.168.1.20:18944",
    "serial": "serial:///dev/ttyUSB0",
    "gev": "gev://192.168.1.5",
    "shm": "shm:///proc/1234/fd/5",
    "host": "host:",
}
SCHEMES = tuple(EXAMPLES)


class BadEndpoint(ConfigurationError, ValueError):
    """The text is not an endpoint, or its scheme is not allowed in this context."""

    code = "CFG-002"
    action = (
        "Write it as scheme://address: serial:///dev/ttyUSB0, tcp://192.168.1.5:8765 or gev://192.168.1.5."
    )


@dataclass(frozen=True)
class Endpoint:
    """Parsed endpoint: `host` and `port` for networks, `path` for devices and shared memory."""

    scheme: str
    host: str = ""
    port: int = 0
    path: str = ""

    def __str__(self) -> str:
        if self.scheme == "host":
            return "host:"
        if self.path:
            return f"{self.scheme}://{self.path}"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}" if self.port else f"{self.scheme}://{host}"

    def resolve_names(self) -> Endpoint:
        """Resolve links and host names; unknown names stay unchanged."""
        if self.path:
            return replace(self, path=os.path.realpath(self.path))
        name = self.host.removesuffix(".")
        try:
            found = socket.getaddrinfo(name, None, type=socket.SOCK_STREAM) if name else []
        except (OSError, UnicodeError):
            found = []
        return replace(self, host=min((str(entry[4][0]) for entry in found), default=name))

    def is_same_as(self, other: Endpoint) -> bool:
        """Return whether two endpoints are one, also with `localhost` for its address.

        Other names are not looked up: what a file says must not depend on the network.
        """
        return self._with_own_address() == other._with_own_address()

    def _with_own_address(self) -> Endpoint:
        return replace(self, host="127.0.0.1") if self.host == "localhost" else self

    def require(self, *schemes: str) -> Endpoint:
        """Return the endpoint, or raise CFG-002 if its scheme is not one of `schemes`."""
        if self.scheme not in schemes:
            raise BadEndpoint(
                f"{self} cannot be used here",
                expected=" or ".join(f"{s}:" for s in schemes),
                action=f"Write it as {' or '.join(EXAMPLES[s] for s in schemes)}.",
            )
        return self


def parse_endpoint(text: str, *, listening: bool = False) -> Endpoint:
    """Parse an endpoint; raises CFG-002 with the reason.

    An address to listen on may have port 0, which requests any free one.
    """
    if text == "host:":
        return Endpoint("host")
    try:
        parts = urlsplit(text)
        port = parts.port
    except ValueError as error:
        example = EXAMPLES.get(text.partition(":")[0])
        action = None if example is None else f"Write it as {example}."
        raise BadEndpoint(f"{text!r} is not an endpoint: {error}", action=action) from error
    if parts.scheme not in SCHEMES or parts.scheme == "host":
        raise BadEndpoint(
            f"{text!r} has an unknown scheme", expected=", ".join(SCHEMES), action=_suggest_scheme(text)
        )
    if parts.scheme in ("serial", "shm"):
        if parts.netloc or not parts.path.startswith("/"):
            raise BadEndpoint(f"{text!r} needs an absolute path", expected=f"{parts.scheme}:///path")
        return Endpoint(parts.scheme, path=parts.path)
    if not parts.hostname or parts.path or parts.query:
        raise BadEndpoint(f"{text!r} needs a host", expected=f"{parts.scheme}://host:port")
    if parts.hostname.rpartition(".")[2].isdigit():  # no name ends in a number
        try:
            IPv4Address(parts.hostname)
        except ValueError as error:
            what = f"{text!r}: {parts.hostname} is not an IPv4 address"
            raise BadEndpoint(what, expected="four numbers from 0 to 255") from error
    if parts.scheme == "gev":
        return Endpoint("gev", host=parts.hostname, port=port or 0)
    if port is None or (port == 0 and not listening):
        raise BadEndpoint(f"{text!r} needs a port", expected=f"{parts.scheme}://host:port")
    return Endpoint(parts.scheme, host=parts.hostname, port=port)


def _suggest_scheme(text: str) -> str | None:
    """Suggest how to write a bare address or device file as an endpoint, or None for anything else."""
    if text.startswith("/dev/"):
        return f"For a serial line write serial://{text}."
    host, colon, port = text.partition(":")
    try:
        IPv4Address(host)
    except ValueError:
        return None
    if not colon:
        return f"For a camera write gev://{host}; for another device tcp://{host}:PORT or udp://{host}:PORT."
    return f"Write tcp://{host}:{port} or udp://{host}:{port}, whichever the device speaks."

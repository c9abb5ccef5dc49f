"""Tracker clients for the same unit: our driver, bare ndicapi, scikit-surgerynditracker, and a bare socket.

Each maker loads tools, starts tracking and returns a function that takes one reading; it raises RuntimeError
if the unit returns none. The stack closes everything that it opens.
"""

from __future__ import annotations

import socket
from collections.abc import Callable, Sequence
from contextlib import ExitStack, redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from typing import Any

from drivers.ndi_polaris import PolarisTracker
from drivers.ndi_polaris.replies import FRAME_OPTIONS
from ronna_hw.clock import open_clock
from ronna_hw.config import DeviceConfig

Reader = Callable[[], object]
MakeReader = Callable[[ExitStack, str, Sequence[Path]], Reader]

BX = f"BX:{FRAME_OPTIONS.value:04X}"  # for ndicapi the same request as the driver's
PORT_REQUEST = "PHRQ:*********1****"
ILLUMINATOR_REQUEST = "SET:Param.Tracking.Illuminator Rate=2"  # 60 Hz, as requested by the driver
LONGEST = 4096
BLOCK_BYTES = 64  # of a tool definition, per command
REPLY_FRAME_BYTES = 8  # start, length and two checksums of a BX reply
PARSED_ALTHOUGH = UnicodeDecodeError  # ndicapi converts binary replies to text after parsing them


def driver(stack: ExitStack, endpoint: str, roms: Sequence[Path]) -> Reader:
    """Return a reader that reads whole frames with our driver."""
    tools = [{"name": rom.stem, "rom": str(rom)} for rom in roms]
    config = DeviceConfig(driver="ndi_polaris", endpoint=endpoint, options={"tools": tools, "reply": "BX"})
    tracker = PolarisTracker("tracker", config, open_clock("host:"))
    stack.callback(tracker.close)
    tracker.connect()
    tracker.configure()
    tracker.activate()
    first = roms[0].stem

    def read() -> None:
        if tracker.read_frame().tool(first).position_mm is None:
            raise RuntimeError("the driver does not see the tool")

    return read


def ndicapi(stack: ExitStack, endpoint: str, roms: Sequence[Path]) -> Reader:
    """Return a reader using bare ndicapi: one request, then the pose of the first tool."""
    device, handles = _ndicapi_tracking(stack, endpoint, roms)
    import ndicapy  # type: ignore[import-not-found]

    def read() -> None:
        with suppress(PARSED_ALTHOUGH):
            ndicapy.ndiCommand(device, BX)
        if not isinstance(ndicapy.ndiGetBXTransform(device, handles[0]), tuple):
            raise RuntimeError("ndicapi does not see the tool")

    return read


def ndicapi_replies(stack: ExitStack, endpoint: str, roms: Sequence[Path]) -> Reader:
    """Return a reader for raw replies with all tools and strays, checking one reply beforehand."""
    device, handles = _ndicapi_tracking(stack, endpoint, roms)
    import ndicapy

    def read() -> None:
        with suppress(PARSED_ALTHOUGH):
            ndicapy.ndiCommand(device, BX)

    read()
    if not all(isinstance(ndicapy.ndiGetBXTransform(device, handle), tuple) for handle in handles):
        raise RuntimeError("ndicapi does not see all tools")
    return read


def scikit(stack: ExitStack, endpoint: str, roms: Sequence[Path]) -> Reader:
    """Return a reader using scikit-surgerynditracker's own `get_frame`, without strays."""
    import ndicapy
    from sksurgerynditracker import nditracker  # type: ignore[import-untyped]

    settings: dict[str, Any] = {"romfiles": [str(rom) for rom in roms]}
    if endpoint.startswith("serial://"):
        settings |= {"tracker type": "polaris", "serial port": endpoint.removeprefix("serial://")}
    else:
        settings |= {
            "tracker type": "vega",
            "ip address": "127.0.0.1",
            "port": int(endpoint.rsplit(":", 1)[1]),
        }
        nditracker.call = lambda _arguments: 0  # it first runs the program ping, which need not exist
    with redirect_stdout(StringIO()):
        tracker = nditracker.NDITracker(settings)
    # It chooses TX or BX by the firmware's name; here all clients read BX.
    tracker._get_frame, tracker._get_transform = ndicapy.ndiGetBXFrame, ndicapy.ndiGetBXTransform
    tracker._capture_string = "BX:0801"
    tracker.start_tracking()
    stack.callback(tracker.close)

    def read() -> None:
        _, _, _, poses, _ = tracker.get_frame()
        if not poses[0][3, 3] == 1.0:
            raise RuntimeError("scikit-surgerynditracker does not see the tool")

    return read


def bare_socket(stack: ExitStack, endpoint: str, roms: Sequence[Path]) -> Reader:
    """Return a reader that exchanges bytes over TCP and decodes nothing: the least a Python client needs."""
    link = stack.enter_context(socket.create_connection(("127.0.0.1", int(endpoint.rsplit(":", 1)[1]))))
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def ask(command: str) -> str:
        link.sendall(f"{command}\r".encode("ascii"))  # with a space after its name, it needs no checksum
        reply = b""
        while not reply.endswith(b"\r"):
            reply += link.recv(LONGEST)
        if reply.startswith(b"ERROR"):
            raise RuntimeError(f"{command}: {reply!r}")
        return reply.decode("ascii")

    ask("INIT ")
    ask(ILLUMINATOR_REQUEST.replace(":", " ", 1))
    for rom in roms:
        handle = ask(PORT_REQUEST.replace(":", " "))[:2]
        definition = rom.read_bytes()
        for at in range(0, len(definition), BLOCK_BYTES):
            block = definition[at : at + BLOCK_BYTES].ljust(BLOCK_BYTES, b"\0")
            ask(f"PVWR {handle}{at:04X}{block.hex().upper()}")
        ask(f"PINIT {handle}")
        ask(f"PENA {handle}D")
    ask("TSTART 80")
    request = f"{BX.replace(':', ' ')}\r".encode("ascii")

    def read() -> None:
        link.sendall(request)
        reply = link.recv(LONGEST)
        while len(reply) < REPLY_FRAME_BYTES + int.from_bytes(reply[2:4], "little"):
            reply += link.recv(LONGEST)

    return read


def ndicapi_bare(stack: ExitStack, endpoint: str, _roms: Sequence[Path]) -> Reader:
    """Return a reader for a unit that always sends the same canned reply."""
    device = _open_device(stack, endpoint)
    import ndicapy

    return lambda: ndicapy.ndiCommand(device, BX)


def _open_device(stack: ExitStack, endpoint: str) -> Any:
    import ndicapy

    if endpoint.startswith("serial://"):
        device = ndicapy.ndiOpen(endpoint.removeprefix("serial://"))
        stack.callback(ndicapy.ndiClose, device)
    else:
        device = ndicapy.ndiOpenNetwork("127.0.0.1", int(endpoint.rsplit(":", 1)[1]))
        stack.callback(ndicapy.ndiCloseNetwork, device)
    return device


def _ndicapi_tracking(stack: ExitStack, endpoint: str, roms: Sequence[Path]) -> tuple[Any, list[bytes]]:
    import ndicapy

    device = _open_device(stack, endpoint)
    ndicapy.ndiCommand(device, "INIT:")
    ndicapy.ndiCommand(device, ILLUMINATOR_REQUEST)
    handles = []
    for rom in roms:
        ndicapy.ndiCommand(device, PORT_REQUEST)
        port = ndicapy.ndiGetPHRQHandle(device)
        ndicapy.ndiPVWRFromFile(device, port, str(rom))
        ndicapy.ndiCommand(device, f"PINIT:{port:02X}")
        ndicapy.ndiCommand(device, f"PENA:{port:02X}D")
        handles.append(bytes([port]))
    ndicapy.ndiCommand(device, "TSTART:80")
    return device, handles

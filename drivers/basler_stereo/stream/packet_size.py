"""Finds the largest usable stream packet: the camera sends test packets, the driver checks which arrive."""

from __future__ import annotations

import socket

from drivers.basler_stereo.control.channel import ControlChannel
from drivers.basler_stereo.errors import PacketTooLarge
from drivers.basler_stereo.options import SMALLEST_PACKET_BYTES
from drivers.basler_stereo.stream.stream_socket import probe_arrives
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap

# largest first: jumbo frames of the camera family, ordinary Ethernet, and what every path carries
CANDIDATES_BYTES = (8192, 4000, 1500, SMALLEST_PACKET_BYTES)
DEFAULT_BYTES = 1500  # for a device that sends no test packets: any Ethernet carries it
PROBE_LIMIT_S = 0.1
PROBES = 2  # per size: one may be lost by chance


def choose_packet_bytes(
    control: ControlChannel, stream: socket.socket, wanted_bytes: int | None, deadline_s: float
) -> tuple[int, bool]:
    """The packet size to use, and whether a test packet proved it; sets it in the camera.

    Uses the largest candidate that arrives, or checks the wanted size. For a device that sends
    no test packets, the wanted or the default size is used. Raises GEV-012 when only sizes below
    the wanted one arrive.
    """
    point_stream_to(control, stream, deadline_s)
    try:
        for size in (wanted_bytes,) if wanted_bytes else CANDIDATES_BYTES:
            if _carries(control, stream, size, deadline_s):
                return _accepted(control, size, deadline_s), True
        for size in CANDIDATES_BYTES if wanted_bytes else ():
            if size < (wanted_bytes or 0) and _carries(control, stream, size, deadline_s):
                raise PacketTooLarge(
                    f"packets of {wanted_bytes} bytes from {control.address} do not arrive",
                    expected=f"a test packet within {PROBE_LIMIT_S} s",
                    limit=f"{size} bytes, which do arrive",
                )
        return _accepted(control, wanted_bytes or DEFAULT_BYTES, deadline_s), False
    finally:
        control.write_register(Bootstrap.SCP, 0, deadline_s)


def point_stream_to(control: ControlChannel, stream: socket.socket, deadline_s: float) -> None:
    """Set the camera's stream destination."""
    host, port = stream.getsockname()
    address = int.from_bytes(socket.inet_aton(host), "big")
    control.write_register(Bootstrap.SCDA, address, deadline_s)
    control.write_register(Bootstrap.SCP, port & gev.SCP_PORT_MASK, deadline_s)


def _carries(control: ControlChannel, stream: socket.socket, size: int, deadline_s: float) -> bool:
    fire = size | gev.SCPS_FIRE_TEST | gev.SCPS_DO_NOT_FRAGMENT
    for _ in range(PROBES):
        control.write_register(Bootstrap.SCPS, fire, deadline_s)
        if probe_arrives(stream, control.peer_address, size, PROBE_LIMIT_S):
            return True
    return False


def _accepted(control: ControlChannel, size: int, deadline_s: float) -> int:
    """Set the size and return what the camera accepted."""
    control.write_register(Bootstrap.SCPS, size | gev.SCPS_DO_NOT_FRAGMENT, deadline_s)
    return control.read_register(Bootstrap.SCPS, deadline_s) & gev.SCPS_SIZE_MASK

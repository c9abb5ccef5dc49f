"""Errors of a tracker behind an OpenIGTLink server, IGT-001 to IGT-008."""

from __future__ import annotations

from ronna_hw.devices.errors import ACKNOWLEDGE
from ronna_hw.errors import (
    EXIT_LINK_LOST,
    ConfigurationError,
    ConnectError,
    ErrorCode,
    LinkTimeout,
    ProtocolError,
)

SERVER_UNAVAILABLE = ErrorCode(
    "IGT-001",
    ConnectError,
    "The OpenIGTLink server of the tracker accepts no connection.",
    "Start PlusServer and check its address and port; a firewall may keep this computer out.",
)

NO_SERVER = ErrorCode(
    "IGT-002",
    ConnectError,
    "The connection is open, but no OpenIGTLink message arrives.",
    "Check that the port is that of a PlusOpenIGTLinkServer, and that no other client keeps it: some "
    "servers serve one at a time.",
)

BAD_OPTIONS = ErrorCode(
    "IGT-003",
    ConfigurationError,
    "The options of the OpenIGTLink tracker in the theatre file contain mistakes.",
    "Correct the tracker's options; docs/reference/openigtlink-tracker-options.md lists them.",
)

WRONG_FRAME = ErrorCode(
    "IGT-004",
    ConfigurationError,
    "The server sends a tool's pose in the frame of something other than the tracker.",
    "In the server's configuration, list the transform from the tool to the tracker among its "
    "TransformNames; in the theatre file, name the tracker's frame with the option frame.",
)

NO_MEASUREMENT = ErrorCode(
    "IGT-005",
    LinkTimeout,
    "The server sent no new measurement within the time limit.",
    "Check that the server is acquiring, and that it sends the tools of the theatre file.",
)


class ServerLost(LinkTimeout):
    """The server closed the connection, or has sent nothing at all for too long."""

    code = "IGT-006"
    action = f"Check the server and the network. To reconnect, {ACKNOWLEDGE}."


class StreamGarbled(ProtocolError):
    """The bytes from the server are not OpenIGTLink any more, so no later message can be found."""

    code = "IGT-007"
    action = f"Keep the bytes for a report, and restart the server. To reconnect, {ACKNOWLEDGE}."
    exit_code = EXIT_LINK_LOST


class SharedName(ProtocolError):
    """The server sends two poses of the same moment under one name: one is another tool's."""

    code = "IGT-008"
    action = (
        "Give the tools short names in the server's configuration: servers cut a transform's name after 20 "
        f"characters. To reconnect, {ACKNOWLEDGE}."
    )
    exit_code = EXIT_LINK_LOST

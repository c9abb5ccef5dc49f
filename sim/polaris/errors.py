"""Set-up errors of the simulated tracker; later errors are reported as codes on its line."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError, ConnectError, ErrorCode

BAD_UNIT_PARAMETER = ErrorCode(
    "PSU-001",
    ConfigurationError,
    "The unit parameter does not exist or does not accept the value.",
    "Give --set NAME=VALUE; ronna-sim polaris --list-parameters lists all names.",
)


LINE_UNAVAILABLE = ErrorCode(
    "PSU-003",
    ConnectError,
    "The computer provides no pseudo-terminal, or does not allow watching one.",
    "Stop other simulators, raise fs.inotify.max_user_instances, or use --endpoint tcp://127.0.0.1:0.",
)


BAD_WIRED_TOOL = ErrorCode(
    "PSU-002",
    ConfigurationError,
    "A wired tool cannot be plugged into the unit.",
    "Give --wired a tool definition of 752 bytes, and no more tools than the unit has ports.",
)

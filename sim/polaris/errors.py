"""Set-up errors of the simulated tracker; later errors are reported as codes on its line."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError, ConnectError


class BadUnitParameter(ConfigurationError):
    """The unit parameter does not exist or does not accept the value."""

    code = "PSU-001"
    action = "Give --set NAME=VALUE; ronna-sim polaris --list-parameters lists all names."


class LineUnavailable(ConnectError):
    """The computer provides no pseudo-terminal, or does not allow watching one."""

    code = "PSU-003"
    action = (
        "Stop other simulators, raise fs.inotify.max_user_instances, or use --endpoint tcp://127.0.0.1:0."
    )


class BadWiredTool(ConfigurationError):
    """A wired tool cannot be plugged into the unit."""

    code = "PSU-002"
    action = "Give --wired a tool definition of 752 bytes, and no more tools than the unit has ports."

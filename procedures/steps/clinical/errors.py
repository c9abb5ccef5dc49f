"""What is found wrong with tools and instruments."""

from __future__ import annotations

from ronna_hw.errors import LimitError, RefusedError


class DepthStopWrong(LimitError):
    """The depth stop of the instrument reads differently from what was computed for the trajectory."""

    code = "TOOL-004"
    action = "Set the depth stop to what is expected, then repeat the step; no instrument goes in before."
    exit_code = RefusedError.exit_code


class ToolBesideGauge(LimitError):
    """The mounted guide is beside its record: bent, badly seated, another mandrel, or the arm sags."""

    code = "TOOL-005"
    action = (
        "Mount the guide and its mandrel again (repeat tool_change), then check it again; else calibrate it."
    )
    exit_code = RefusedError.exit_code

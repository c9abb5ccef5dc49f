"""What is found wrong with the cart, with tools and instruments."""

from __future__ import annotations

from ronna_hw.errors import LimitError, RefusedError


class CartNotLocked(RefusedError):
    """Nobody says that the cart is locked, or it rolls when somebody leans on it."""

    code = "PRO-041"
    action = "Close the brakes of every wheel, or set the cart on its feet, then repeat the step."


class CartMisplaced(RefusedError):
    """The cart stands farther from its proposed place than that place may be missed by."""

    code = "PRO-042"
    action = "Push the cart as told and repeat the step, or make a map from here: ronna-plan place."


class DepthStopWrong(LimitError):
    """The depth stop of the instrument reads differently from what was computed for the trajectory."""

    code = "TOOL-004"
    action = "Set the depth stop to what is expected, then repeat the step; no instrument goes in before."
    exit_code = RefusedError.exit_code


class ToolBesideGauge(LimitError):
    """The mounted guide is beside its record: bent, badly seated, another mandrel, or the arm sags."""

    code = "TOOL-005"
    action = (
        "Read the dials again, or seat the guide and its mandrel again on the parked arm, then repeat "
        "tool_check; else calibrate the guide."
    )
    exit_code = RefusedError.exit_code


class ToolSeenElsewhere(LimitError):
    """The tracker does not see the frame of the mounted tool where the tool's record says, or not at all."""

    code = "TOOL-006"
    action = "See that it is the right tool, well seated and in the tracker's sight; repeat tool_check."
    exit_code = RefusedError.exit_code

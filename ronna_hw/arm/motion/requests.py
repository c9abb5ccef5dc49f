"""Requested motions of an arm as values, so that the motion previewed is the motion driven."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ronna_hw.vectors import JointVector

if TYPE_CHECKING:
    from ronna_hw.frames import Transform


@dataclass(frozen=True)
class JointMove:
    """A motion of all joints together, straight to `target_rad`.

    `speed_fraction` is a fraction of the working speed of the driver, 0 < fraction <= 1.
    """

    target_rad: JointVector
    speed_fraction: float = 1.0


@dataclass(frozen=True)
class LineMove:
    """A straight line of the flange to ROBOT <- FLANGE, or of the tool to ROBOT <- TOOL.

    `flange_from_tool` (FLANGE <- TOOL) is given with the latter. `speed_fraction` as in `JointMove`.
    """

    target: Transform
    flange_from_tool: Transform | None = None
    speed_fraction: float = 1.0


Motion = JointMove | LineMove

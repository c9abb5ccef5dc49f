"""Motions in contact: insert an instrument, carry a load, follow a hand.

Small protocols: an arm without a force estimate inserts without a force limit, and follows no hand.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from ronna_hw.arm.motion.limits import REDUCED_SPEED_MM_S
from ronna_hw.devices.readings import ArmReading
from ronna_hw.vectors import JointVector, Vector3

if TYPE_CHECKING:
    from ronna_hw.frames import Transform

# Safety against an instrument that is inserted too fast. Source: proposed requirement DA-5.
INSERTION_SPEED_MM_S = 5.0  # proposed requirement DA-5: slow enough to stop within a fraction of a mm
# Where the bore leads it and its tip is off the skin. At the accelerations of the arms it still stops within
# 0.5 mm, and an arm that senses force watches its limit there as well.
# Safety against an instrument led too fast in the bore (U).
BORE_SPEED_MM_S = 15.0
# Safety against a fast arm in a hand (U).
GUIDED_SPEED_MM_S = REDUCED_SPEED_MM_S / 5.0  # a hand is on the arm


@dataclass(frozen=True)
class DrillLimits:
    """Forces and depths by which an arm feeds a drill, and finds that it has broken through.

    Between `slow_N` and the force limit the feed is slowed, and rests. Beyond `earliest_mm` before the target
    a fall of the force counts, elsewhere only a way on which nothing resists. Without `touch_N` up to
    `bone_by_mm` before the target the feed ends there; from `bone_from_mm` before it on, `free_N` is bone as
    well. All of these go by the force along the axis, less the `friction` that the one across it can make;
    more than `side_N` across it stops the drill.
    """

    slow_N: float
    touch_N: float
    free_N: float
    fall_share: float
    earliest_mm: float
    free_mm: float
    bone_from_mm: float
    bone_by_mm: float
    side_N: float
    friction: float


@dataclass(frozen=True)
class Insertion:
    """Straight, slow motion of an instrument along its own axis, the z axis of TOOL, to the target.

    The target ROBOT <- TOOL is the depth stop: no set-point lies beyond it. With a force limit the arm stops
    when the force on the tool has changed by more since the start, in any direction.

    An arm that is calibrated outside its controller is sent along a line that leads along the axis with the
    arm's errors; its controller has that line beside the z axis of TOOL. It then begins at `start`.
    """

    target: Transform
    flange_from_tool: Transform
    speed_mm_s: float = INSERTION_SPEED_MM_S
    force_limit_N: float | None = None
    start: Transform | None = None
    in_bore: bool = False  # all the way, with the tip off the skin: up to `BORE_SPEED_MM_S`
    drill: DrillLimits | None = None  # it ends where the drill breaks through, at the latest at the target


@dataclass(frozen=True)
class Inserted:
    """End of an insertion that reached its depth."""

    reading: ArmReading
    travel_mm: float  # along the axis, positive in its direction; by the measured joints
    peak_force_N: float | None  # largest change of the force; None if the arm senses none


@dataclass(frozen=True)
class Drilled:
    """Feed of a drill, whichever way it ended."""

    joints_rad: JointVector  # as measured last
    peak_force_N: float  # largest change of the force
    side_force_N: float  # largest change of the force across its axis
    met_bone: bool
    broke_through: bool
    free_mm: float  # way up to its end on which nothing resisted, once bone was met
    drilled_s: float
    slowed_s: float  # of that, with less than the planned feed
    forces_N: tuple[float, ...]  # largest ones along the axis in equal parts of the way to the target

    def after(self, earlier: Drilled) -> Drilled:
        """Return both feeds as one that was halted in between."""
        return replace(
            self,
            peak_force_N=max(self.peak_force_N, earlier.peak_force_N),
            side_force_N=max(self.side_force_N, earlier.side_force_N),
            met_bone=self.met_bone or earlier.met_bone,
            drilled_s=self.drilled_s + earlier.drilled_s,
            slowed_s=self.slowed_s + earlier.slowed_s,
        )


@runtime_checkable
class InsertsInstruments(Protocol):
    """Arm that can insert an instrument."""

    @property
    def senses_force(self) -> bool:
        """Whether the arm estimates the force on its tool, so that a force limit can be watched."""

    def insert(self, insertion: Insertion, *, timeout_s: float = 120.0) -> Inserted:
        """Insert, or withdraw, to rest at the target.

        Raises ARM-012 before motion for a target off the axis or a speed above the limit, ARM-013 for a force
        limit that the arm cannot watch, ARM-014 for a force on the tool at the start, and ARM-015 when the
        force limit stopped it: the arm is then in HOLD where it stopped, and nothing withdraws by itself.
        Otherwise like `RobotArm.move`.
        """


@runtime_checkable
class TellsFeed(Protocol):
    """Arm that tells how it fed a drill."""

    @property
    def drilled(self) -> Drilled | None:
        """Feed of a drill in the last call of `insert`, also one that raised.

        None if nothing was fed, or that is not known.
        """


@runtime_checkable
class StatesForceError(Protocol):
    """Arm that states how well it knows the force on its tool."""

    @property
    def force_error_N(self) -> float:
        """Two standard errors of a change of that force; 0.0 if none is stated."""


@dataclass(frozen=True)
class HandGuidance:
    """Limits within which an arm follows a hand: it shifts its flange without turning it."""

    speed_mm_s: float = GUIDED_SPEED_MM_S
    reach_mm: float = 150.0  # from where it began
    force_limit_N: float = 60.0  # above, the arm stops
    dead_band_N: float = 8.0  # force without effect: above the noise of an estimate from motor currents (U)
    damping_N_s_mm: float = 0.6  # force for each mm/s
    timeout_s: float = 60.0  # of the controller's cycles


class GuidanceEnd(StrEnum):
    """Why an arm no longer follows a hand."""

    RELEASED = "released"  # by the operator
    TIMED_OUT = "timed out"
    AT_LIMIT = "at a limit"  # of a joint's range or speed, or of lost cycles


@dataclass(frozen=True)
class Guided:
    """End of a guidance by hand, with the arm at rest."""

    reading: ArmReading
    end: GuidanceEnd


@runtime_checkable
class FollowsHand(Protocol):
    """Arm that can be guided by hand."""

    def guide_by_hand(self, guidance: HandGuidance, is_held: Callable[[], bool]) -> Guided:
        """Follow the hand's force while `is_held`, the operator's enabling switch, says so.

        Raises ARM-012 for limits that no person may be exposed to, ARM-014 if a force acts at the start,
        ARM-015 when the force limit stopped it (then in HOLD), and otherwise like `RobotArm.move`.
        """


@dataclass(frozen=True)
class ToolLoad:
    """Mass of the tool, its centre of gravity and tip in the flange frame, as the controller needs them."""

    mass_kg: float
    centre_mm: Vector3 = (0.0, 0.0, 0.0)  # centre of gravity
    tip_mm: Vector3 = (0.0, 0.0, 0.0)  # tool centre point


@runtime_checkable
class CarriesLoad(Protocol):
    """Arm whose controller takes the load from the driver."""

    def set_tool_load(self, load: ToolLoad, timeout_s: float = 2.0) -> ToolLoad:
        """Set mass and tool centre point, and return them as read back; raises if they are not as set."""

    def read_tool_load(self, timeout_s: float = 2.0) -> ToolLoad:
        """Read what the controller presently assumes. Allowed from CONNECTED."""

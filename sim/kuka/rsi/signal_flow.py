"""RSI signal flow: from the ETHERNET object through wiring and corrections to a joint command."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import degrees
from typing import Literal

import numpy as np

from ronna_hw.wire.kuka_context import (
    AXISCORR_DEFAULT_LIMIT_DEG,
    AXISCORRMON_DEFAULT_MAX_DEG,
    INTERNAL,
    POSCORRMON_DEFAULT_MAX_ROTATION_DEG,
    POSCORRMON_DEFAULT_MAX_TRANSLATION_MM,
    SOFTWARE_END_SWITCHES,
    AxisCorrection,
    AxisMonitor,
    PositionCorrection,
    PositionMonitor,
    RsiContext,
)
from sim.kuka.pendant import PendantMessage, near_singularity, out_of_range
from sim.kuka.rsi.telegrams import AXIS, FRAME
from sim.world.nominal_arm import AXES, RobotDescription, pose_of_frame
from sim.world.rigid import Matrix, rotation_from_vector, twice_sine_axis

# Stat of AXISCORR: bit n for axis n at a limit; of POSCORR: bits 1 to 3 for X, Y, Z, bit 4 for the rotation.
ACTIVE_BIT = 1
ROTATION_BIT = 16
TOOL_REFERENCE = "Tool"

TRUE_LIMIT = 0.5  # a BOOL may arrive as a decimal number


class AxisCorrector:
    """AXISCORR and AXISCORRMON of one run: clamped and monitored axis corrections, in degrees from RSI_ON."""

    def __init__(
        self,
        arm: RobotDescription,
        base_deg: Sequence[float],
        correction: AxisCorrection | None,
        monitor: AxisMonitor | None,
        *,
        relative: bool,
    ) -> None:
        down = [joint.lower_deg - base for joint, base in zip(arm.joints, base_deg, strict=True)]
        up = [joint.upper_deg - base for joint, base in zip(arm.joints, base_deg, strict=True)]
        widest = [max(abs(low), abs(high)) for low, high in zip(down, up, strict=True)]
        self._lower_deg: Sequence[float] = (-AXISCORR_DEFAULT_LIMIT_DEG,) * AXES
        self._upper_deg: Sequence[float] = (AXISCORR_DEFAULT_LIMIT_DEG,) * AXES
        if correction is not None:
            explicit = correction.limits != SOFTWARE_END_SWITCHES
            self._lower_deg = correction.lower_deg if explicit else down
            self._upper_deg = correction.upper_deg if explicit else up
        self._largest_deg: Sequence[float] = (AXISCORRMON_DEFAULT_MAX_DEG,) * AXES
        if monitor is not None:
            self._largest_deg = widest if monitor.limits == SOFTWARE_END_SWITCHES else monitor.max_deg
        self._limits = (self._lower_deg, self._upper_deg)
        self._within_deg: float | None = None
        self._axes = [joint.name for joint in arm.joints]
        self._relative = relative
        self.totals_deg: list[float] = [0.0] * AXES
        self.stat = 0

    def narrow(self, within_deg: float | None) -> bool:
        """Clamp to `within_deg` of the present totals (None: context limits); return whether changed."""
        if within_deg == self._within_deg:
            return False
        self._within_deg = within_deg
        self._lower_deg, self._upper_deg = self._limits
        if within_deg is not None:
            self._lower_deg = [
                max(low, total - within_deg)
                for low, total in zip(self._lower_deg, self.totals_deg, strict=True)
            ]
            self._upper_deg = [
                min(high, total + within_deg)
                for high, total in zip(self._upper_deg, self.totals_deg, strict=True)
            ]
        return True

    def apply(self, inputs_deg: Sequence[float]) -> PendantMessage | None:
        """Add one cycle's inputs and return the monitor's message if a total exceeds its limit."""
        wanted = (
            [total + step for total, step in zip(self.totals_deg, inputs_deg, strict=True)]
            if self._relative
            else list(inputs_deg)
        )
        self.stat = ACTIVE_BIT
        for value, lower, upper, largest in zip(
            wanted, self._lower_deg, self._upper_deg, self._largest_deg, strict=True
        ):
            if not (lower <= value <= upper and -largest <= value <= largest):
                break
        else:
            self.totals_deg = wanted
            return None
        beyond = None
        for axis, (value, lower, upper, largest) in enumerate(
            zip(wanted, self._lower_deg, self._upper_deg, self._largest_deg, strict=True)
        ):
            clamped = value
            if value < lower or value > upper:
                clamped = wanted[axis] = lower if value < lower else upper
                self.stat |= ACTIVE_BIT << (axis + 1)
            if (clamped > largest or clamped < -largest) and beyond is None:
                beyond = out_of_range("AXISCORRMON", self._axes[axis], clamped, largest)
        self.totals_deg = wanted
        return beyond


class PositionCorrector:
    """POSCORR and POSCORRMON of one run: clamped and monitored tool pose corrections.

    `start` is the pose (4, 4) of the tool centre point at RSI_ON and `reference` the rotation (3, 3) of the
    correction system, both in $ROBROOT. `inverse` finds joints (deg) for a pose, near given joints.
    """

    def __init__(
        self,
        start: Matrix,
        reference: Matrix,
        base_deg: Sequence[float],
        inverse: Callable[[Matrix, Sequence[float]], list[float] | None],
        correction: PositionCorrection | None,
        monitor: PositionMonitor | None,
        *,
        relative: bool,
    ) -> None:
        self._limits = correction or PositionCorrection()
        self._largest_mm = monitor.max_translation_mm if monitor else POSCORRMON_DEFAULT_MAX_TRANSLATION_MM
        self._largest_deg = monitor.max_rotation_deg if monitor else POSCORRMON_DEFAULT_MAX_ROTATION_DEG
        self._start = start
        self._reference = start[:3, :3] if self._limits.reference == TOOL_REFERENCE else reference
        self._inverse = inverse
        self._relative = relative
        self._shift_mm = np.zeros(3)
        self._turn = np.eye(3)
        self._base_deg = list(base_deg)
        self.joints_deg: list[float] = self._base_deg
        self.stat = 0

    def apply(self, inputs: Sequence[float]) -> PendantMessage | None:
        """Apply one cycle's X Y Z (mm) A B C (deg) and return the message for a stop, or None."""
        step = pose_of_frame(inputs)
        shift_mm = step[:3, 3] + self._shift_mm if self._relative else step[:3, 3]
        turn = step[:3, :3] @ self._turn if self._relative else step[:3, :3]
        self._shift_mm = np.clip(shift_mm, self._limits.lower_mm, self._limits.upper_mm)
        self._turn = self._limit_turn(turn)
        self.stat = ACTIVE_BIT
        for number in range(3):
            if self._shift_mm[number] != shift_mm[number]:
                self.stat |= 2 << number
        if self._turn is not turn:
            self.stat |= ROTATION_BIT
        distance_mm = float(np.linalg.norm(self._shift_mm))
        if distance_mm > self._largest_mm:
            return out_of_range("POSCORRMON", "translation", distance_mm, self._largest_mm)
        angle_deg = degrees(_angle(self._turn))
        if angle_deg > self._largest_deg:
            return out_of_range("POSCORRMON", "rotation", angle_deg, self._largest_deg)
        if distance_mm == 0.0 and angle_deg == 0.0:
            self.joints_deg = self._base_deg  # exact, unlike the result of an iteration
            return None
        goal = self._start.copy()
        goal[:3, 3] += self._reference @ self._shift_mm
        goal[:3, :3] = self._reference @ self._turn @ self._reference.T @ goal[:3, :3]
        joints = self._inverse(goal, self.joints_deg)
        if joints is None:
            return near_singularity()
        self.joints_deg = joints
        return None

    def _limit_turn(self, turn: Matrix) -> Matrix:
        angle_deg = degrees(_angle(turn))
        if angle_deg <= self._limits.max_rotation_deg:
            return turn
        vector = twice_sine_axis(turn)
        unit = vector / np.linalg.norm(vector)
        return rotation_from_vector(unit * np.radians(self._limits.max_rotation_deg))


def _angle(rotation: Matrix) -> float:
    """Return the angle of a rotation matrix in rad, accurate even near zero."""
    return float(np.arctan2(np.linalg.norm(twice_sine_axis(rotation)), np.trace(rotation) - 1.0))


class EthernetOutputs:
    """Outputs of the ETHERNET object: the last values, held or reset to zero as set by HOLDON."""

    def __init__(
        self, context: RsiContext, missing_element: Literal["holdon", "kept", "zero"] = "holdon"
    ) -> None:
        """Treat elements missing from a reply as specified by `missing_element`."""
        self._hold = [bool(element.holdon) for element in context.receive]
        self._keep = (
            self._hold if missing_element == "holdon" else [missing_element == "kept"] * len(self._hold)
        )
        self.values: list[float] = [0.0] * len(self._hold)
        self._all_missing: tuple[None, ...] = (None,) * len(self._hold)

    def update(self, values: Sequence[float | None] | None) -> list[float]:
        """Apply the values of a reply, or None for a cycle without a reply."""
        if values is not None and None not in values:
            self.values = list(values)  # type: ignore[arg-type]
            return self.values
        received, holds = (self._all_missing, self._hold) if values is None else (values, self._keep)
        self.values = [
            new if new is not None else (old if hold else 0.0)
            for new, old, hold in zip(received, self.values, holds, strict=True)
        ]
        return self.values


@dataclass(frozen=True)
class Inputs:
    """Indices into the received elements for each object's inputs, with None for an unwired input."""

    axes: tuple[int | None, ...] | None
    frame: tuple[int | None, ...] | None
    stop: int | None


def resolve_inputs(context: RsiContext) -> Inputs:
    """Resolve a context's wiring to indices into the received elements."""
    position = {element.indx: n for n, element in enumerate(context.receive) if element.indx != INTERNAL}
    fed: dict[tuple[str, str], int] = {
        (wire.object, wire.input): position[wire.indx] for wire in context.wiring
    }

    def resolve_six(name: str, inputs: Sequence[str]) -> tuple[int | None, ...] | None:
        places = tuple(fed.get((name, item)) for item in inputs)
        return places if any(place is not None for place in places) else None

    return Inputs(resolve_six("AXISCORR", AXIS), resolve_six("POSCORR", FRAME), fed.get(("STOP", "In1")))


class SignalFlow:
    """Signal flow of one run, from the outputs of ETHERNET to the commanded joint angles (deg)."""

    def __init__(
        self,
        inputs: Inputs,
        base_deg: list[float],
        axis: AxisCorrector | None,
        position: PositionCorrector | None,
        *,
        relative: bool,
        share: float = 1.0,
    ) -> None:
        """Apply only the fraction `share` of each correction, below 1 if the override scales corrections."""
        self._inputs = inputs
        self._relative = relative
        self._share = share
        self._axis = axis
        self._position = position
        self._last: list[float] | None = None
        self._stop_before = False
        self.command_deg: list[float] = base_deg  # the drives' own list: an arm at rest stays at rest
        self._base_deg = self.command_deg

    def stop_rises(self, values: list[float]) -> bool:
        """Return whether STOP's input became True in this cycle."""
        place = self._inputs.stop
        if place is None:
            return False
        now = values[place] > TRUE_LIMIT
        rises = now and not self._stop_before
        self._stop_before = now
        return rises

    def correct(self, values: list[float]) -> PendantMessage | None:
        """Apply one cycle's corrections, keeping the same `command_deg` object if nothing changes."""
        if values == self._last and not self._relative:
            return None
        self._last = values
        joints_deg, changed = self._base_deg, False
        if self._position is not None and self._inputs.frame is not None:
            frame_inputs = self._pick_values(values, self._inputs.frame)
            if any(frame_inputs) or not self._relative:
                changed = True
                message = self._position.apply(frame_inputs)
                if message is not None:
                    return message
            joints_deg = self._position.joints_deg
        if self._axis is not None and self._inputs.axes is not None:
            frame_inputs = self._pick_values(values, self._inputs.axes)
            if any(frame_inputs) or not self._relative:
                changed = True
                message = self._axis.apply(frame_inputs)
                if message is not None:
                    return message
            joints_deg = [a + b for a, b in zip(joints_deg, self._axis.totals_deg, strict=True)]
        if changed and joints_deg != self.command_deg:
            self.command_deg = joints_deg
        return None

    def narrow(self, within_deg: float | None) -> None:
        """Clamp axis corrections to `within_deg` of their present values, or unclamp them if None."""
        if self._axis is not None and self._axis.narrow(within_deg):
            self._last = None

    @property
    def stats(self) -> tuple[int, int]:
        """Stat outputs of AXISCORR and POSCORR."""
        return (
            self._axis.stat if self._axis is not None else 0,
            self._position.stat if self._position is not None else 0,
        )

    def _pick_values(self, values: list[float], places: tuple[int | None, ...]) -> list[float]:
        frame_inputs = [0.0 if place is None else values[place] for place in places]
        return frame_inputs if self._share == 1.0 else [self._share * value for value in frame_inputs]

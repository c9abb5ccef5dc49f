"""AXISCORR and AXISCORRMON: corrections added to joint angles, clamped and monitored."""

from __future__ import annotations

from collections.abc import Sequence

from ronna_hw.wire.kuka_context import (
    AXISCORR_DEFAULT_LIMIT_DEG,
    AXISCORRMON_DEFAULT_MAX_DEG,
    SOFTWARE_END_SWITCHES,
    AxisCorrection,
    AxisMonitor,
)
from sim.kuka.controller.messages import Message, out_of_range
from sim.world.nominal_arm import AXES, RobotDescription

ACTIVE_BIT = 1  # bit 0 of Stat; bit n means that axis n is at a limit


class AxisCorrector:
    """The two objects of one run, from RSI_ON on. Degrees, relative to the pose at RSI_ON."""

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
        """Clamp this close to the present totals; None: only by the context's limits. True if changed."""
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

    def take(self, inputs_deg: Sequence[float]) -> Message | None:
        """Add one cycle's inputs; the monitor's message if the total exceeds its limit."""
        wanted = (
            [total + step for total, step in zip(self.totals_deg, inputs_deg, strict=True)]
            if self._relative
            else list(inputs_deg)
        )
        self.stat = ACTIVE_BIT
        beyond = None
        for axis, (value, lower, upper, largest) in enumerate(
            zip(wanted, self._lower_deg, self._upper_deg, self._largest_deg, strict=True)
        ):
            taken = value
            if value < lower or value > upper:
                taken = wanted[axis] = lower if value < lower else upper
                self.stat |= ACTIVE_BIT << (axis + 1)
            if (taken > largest or taken < -largest) and beyond is None:
                beyond = out_of_range("AXISCORRMON", self._axes[axis], taken, largest)
        self.totals_deg = wanted
        return beyond

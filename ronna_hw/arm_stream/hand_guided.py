"""Arm that follows a hand, by its own estimate of the force and through its stream of set-points."""

from __future__ import annotations

from collections.abc import Callable

from ronna_hw.arm.errors import INSERTION_INVALID, ForceLimitExceeded
from ronna_hw.arm_stream.arm import StreamedArm
from ronna_hw.arm_stream.control_channel import S
from ronna_hw.arm_stream.guided import GuideLimits
from ronna_hw.devices.contact import GUIDED_SPEED_MM_S, Guided, HandGuidance
from ronna_hw.devices.lifecycle import Lifecycle

# Safety against a hand-guided arm that goes far (U).
LARGEST_REACH_MM = 300.0
# Safety against a hand that is clamped. Source: ISO/TS 15066.
LARGEST_FORCE_N = 100.0  # below 140 N, what ISO/TS 15066 permits for a hand that is clamped
# Safety against a hand-guided arm that runs away, or is forgotten (U).
LEAST_DAMPING_N_S_MM = 0.1  # less is felt as an arm that runs away
LONGEST_S = 600.0


class HandGuidedArm(StreamedArm[S]):
    """Streamed arm that can be guided by hand, by its controller's estimate of the tool force."""

    senses_force = True

    def guide_by_hand(self, guidance: HandGuidance, is_held: Callable[[], bool]) -> Guided:
        guide = guide_limits(guidance, self.limits(self._stream_mode()).cycle_s)
        self._watch.raise_new()
        stop_count = self.connections.link.stop_number  # before the state is checked: see `stop`
        self._guard.require("guide_by_hand", (Lifecycle.ACTIVE,))
        self._await_tare()
        self.connections.link.surround(self._planner.surroundings)
        try:
            state, end = self._follower.follow_hand(guide, guidance.force_limit_N, stop_count, is_held)
        except ForceLimitExceeded:
            self._guard.exchange(Lifecycle.ACTIVE, Lifecycle.HOLD)
            raise
        return Guided(self._readings.from_stream(state), end)


def guide_limits(guidance: HandGuidance, cycle_s: float) -> GuideLimits:
    """Return the limits as plain numbers; raises ARM-012 for those that no person may be exposed to."""
    checked = (
        ("speed", guidance.speed_mm_s, 0.0, GUIDED_SPEED_MM_S, "mm/s"),
        ("reach", guidance.reach_mm, 0.0, LARGEST_REACH_MM, "mm"),
        ("force limit", guidance.force_limit_N, guidance.dead_band_N, LARGEST_FORCE_N, "N"),
        ("dead band", guidance.dead_band_N, 0.0, LARGEST_FORCE_N, "N"),
        ("damping", guidance.damping_N_s_mm, LEAST_DAMPING_N_S_MM, float("inf"), "N s/mm"),
        ("time", guidance.timeout_s, 0.0, LONGEST_S, "s"),
    )
    for name, value, low, high, unit in checked:
        if not low < value <= high:
            raise INSERTION_INVALID(
                f"the {name} of a guidance by hand",
                limit=f"above {low:g} to {high:g} {unit}",
                got=f"{value:g} {unit}",
            )
    return GuideLimits(
        guidance.speed_mm_s,
        guidance.reach_mm,
        guidance.dead_band_N,
        guidance.damping_N_s_mm,
        round(guidance.timeout_s / cycle_s),
    )

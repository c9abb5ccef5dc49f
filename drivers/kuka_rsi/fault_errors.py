"""Errors for faults of the real-time process that need RSI's words."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees

from drivers.kuka_rsi.eki.telegrams import ControllerState
from drivers.kuka_rsi.errors import CONTROLLER_RESTARTED, NO_TELEGRAM, POSE_DISAGREES
from drivers.kuka_rsi.options import KukaOptions
from drivers.kuka_rsi.realtime.link_health import AXES_AGREE_DEG
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm_stream.faults import StreamFaults
from ronna_hw.arm_stream.records import NOTHING_AROUND, LinkFault, LinkState
from ronna_hw.errors import RonnaError
from ronna_hw.vectors import JointVector


@dataclass(frozen=True)
class RsiFaults(StreamFaults):
    """Errors of one arm's RSI stream."""

    options: KukaOptions

    def error(
        self,
        state: LinkState,
        mode: str,
        surroundings: Surroundings = NOTHING_AROUND,
        reported: ControllerState | None = None,
    ) -> RonnaError | None:
        """Build the error for a latched fault, if any; silence may have left a message on the controller."""
        match state.fault:
            case LinkFault.SILENCE if reported is not None and reported.error:
                return self.silence_error(state, f"; the controller shows message {reported.error}")
            case LinkFault.RESTARTED:
                sender = f" from {state.foreign_host}" if state.foreign else ""
                return CONTROLLER_RESTARTED(
                    f"{self.name}: after {state.cycles} cycles received telegrams of another run{sender}",
                    got=f"IPOC {state.device_clock}",
                )
            case LinkFault.BASE:
                return POSE_DISAGREES(
                    f"{self.name}: the first telegram's axes are outside the joint ranges",
                    got=self.axes_text(state),
                )
        return super().error(state, mode, surroundings)

    def start_error(self, state: LinkState, axes_deg: JointVector, timeout_s: float) -> RonnaError:
        """Build the error for a stream that received no matching telegram, with counts of all others."""
        last = f", the last from {state.foreign_host}" if state.foreign_host else ""
        counts = (
            (state.disagreeing, "reported other axes"),
            (state.foreign, "came from elsewhere"),
            (state.rejected, "were malformed or of another Type"),
        )
        sender_counts = ", ".join(f"{count} {what}" for count, what in counts if count)
        others = f"; {sender_counts}{last}" if sender_counts else ""
        limit = f"{timeout_s:g} s"
        if not state.disagreeing:
            return NO_TELEGRAM(
                f"{self.name}: the RSI program runs, but none of its telegrams arrive here{others}",
                expected=f"telegrams of {host}" if (host := self.options.controller_host) else None,
                limit=limit,
            )
        pairs = [(by_eki, degrees(angle)) for by_eki, angle in zip(axes_deg, state.measured_rad, strict=True)]
        axis = max(range(len(pairs)), key=lambda k: abs(pairs[k][0] - pairs[k][1]))
        by_eki, by_rsi = pairs[axis]
        return POSE_DISAGREES(
            f"{self.name}: A{axis + 1} is {by_eki:.3f} deg by EKI and {by_rsi:.3f} by RSI{others}",
            expected=f"a telegram within {AXES_AGREE_DEG} deg of the axes by EKI",
            limit=limit,
        )

"""Independent monitor that checks every set-point before it is sent, and every measured pose.

It shares no code with the generators: it compares plain numbers with limits given at the start. It knows only
set-points that were sent, and those that the receiver reported as not accepted.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import radians

from ronna_hw.arm.clearance.live_watch import LiveWatch, Violation, ViolationKind
from ronna_hw.arm.kinematics import JointRanges
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.vectors import JointVector, joint_vector

# Safety against set-points beyond the limits, and an arm that does not follow them (U).
SPEED_MARGIN = 1.05  # over the working limits, so that rounding and the end of a ramp do not trip it
ACCELERATION_MARGIN = 2.0  # differences over one cycle include jerk
JERK_MARGIN = 4.0
FOLLOWING_TIME_S = 0.25  # how late an arm may be at a set-point: dead time and servo lag stay below 0.1 s
FOLLOWING_RAD = radians(0.1)  # off the range of set-points of that time; servo overshoot is not published

RANGE_ROUNDING_RAD = 2e-6  # half a digit of the wire

History = tuple[JointVector, JointVector, JointVector, JointVector]


@dataclass(frozen=True)
class MonitorLimits:
    """Per-axis monitor limits with a margin, expressed as differences over one cycle of `cycle_s`.

    The corrections limit the distance from the pose at RSI_ON. `following_cycles`: the arm has to be where a
    set-point of these last cycles was, within `FOLLOWING_RAD`.
    """

    limits: MotionLimits
    cycle_s: float
    lower_rad: JointVector
    upper_rad: JointVector
    step_rad: JointVector
    second_difference_rad: JointVector
    third_difference_rad: JointVector
    correction_lower_rad: JointVector
    correction_upper_rad: JointVector
    following_cycles: int


def monitor_limits(
    arm: JointRanges, limits: MotionLimits, cycle_s: float, start_rad: JointVector
) -> MonitorLimits:
    """Build the monitor limits for a stream that started at `start_rad`.

    The total correction is limited by the end switches minus the start pose, as in the context of the
    controller.
    """

    def times(values: JointVector, factor: float) -> JointVector:
        return joint_vector(value * factor for value in values)

    def minus_start(values: JointVector) -> JointVector:
        return joint_vector(value - start for value, start in zip(values, start_rad, strict=True))

    lower_rad, upper_rad = limits.ranges(arm, start_rad)
    return MonitorLimits(
        limits=limits,
        cycle_s=cycle_s,
        lower_rad=lower_rad,
        upper_rad=upper_rad,
        step_rad=times(limits.speed_rad_s, SPEED_MARGIN * cycle_s),
        second_difference_rad=times(limits.acceleration_rad_s2, ACCELERATION_MARGIN * cycle_s**2),
        third_difference_rad=times(limits.jerk_rad_s3, JERK_MARGIN * cycle_s**3),
        correction_lower_rad=minus_start(arm.lower_rad),
        correction_upper_rad=minus_start(arm.upper_rad),
        following_cycles=round(FOLLOWING_TIME_S / cycle_s),
    )


class Monitor:
    """Monitor for a single stream of set-points.

    `check` changes nothing; `sent` and the methods after it record what happened.
    """

    def __init__(self, limits: MonitorLimits, start_rad: JointVector) -> None:
        self.limits = limits
        self._start = start_rad
        # What range and total correction both allow, narrower by rounding: beyond it each is compared.
        lows = zip(limits.lower_rad, start_rad, limits.correction_lower_rad, strict=True)
        self._lower_rad = [max(low, start + least) - RANGE_ROUNDING_RAD / 2 for low, start, least in lows]
        highs = zip(limits.upper_rad, start_rad, limits.correction_upper_rad, strict=True)
        self._upper_rad = [min(high, start + most) + RANGE_ROUNDING_RAD / 2 for high, start, most in highs]
        # Newest first: the arm starts at rest.
        self._last: History = (start_rad, start_rad, start_rad, start_rad)
        self._followed_rad = start_rad
        self._recent = deque([start_rad], maxlen=limits.following_cycles)  # set-points, one a cycle
        self._still_cycles = 0  # since `_recent` last changed
        self._checked_rad: JointVector | None = None  # measured angles without a violation since then
        self._watch: LiveWatch | None = None

    def watch(self, watch: LiveWatch | None) -> None:
        """Set the clearance watch; None removes it. Call only while the arm is at rest."""
        self._watch = watch

    @property
    def last_rad(self) -> JointVector:
        """The last set-point sent."""
        return self._last[0]

    @property
    def history_rad(self) -> History:
        """The last four set-points sent, newest first."""
        return self._last

    @property
    def held_rad(self) -> JointVector:
        """Set-point that the arm follows: the last one sent, unless it was not accepted."""
        return self._followed_rad

    def check(self, joints_rad: JointVector) -> Violation | None:
        """Return the first limit violation that sending this set-point next would cause, or None."""
        limits = self.limits
        for angle, low, high, latest, previous, earlier, farthest, bent, twisted in zip(
            joints_rad,
            self._lower_rad,
            self._upper_rad,
            *self._last[:3],
            limits.step_rad,
            limits.second_difference_rad,
            limits.third_difference_rad,
            strict=True,
        ):
            step, before = angle - latest, latest - previous
            bend = step - before
            if not (
                low <= angle <= high
                and -farthest <= step <= farthest
                and -bent <= bend <= bent
                and -twisted <= bend - before + previous - earlier <= twisted
            ):  # NaN fails here
                if (found := self._find_axis_violation(joints_rad)) is not None:
                    return found
                break
        return None if self._watch is None else self._watch.check(joints_rad)

    def _find_axis_violation(self, joints_rad: JointVector) -> Violation | None:
        limits = self.limits
        latest, previous, earlier, _ = self._last
        for i in range(len(joints_rad)):
            angle = joints_rad[i]
            low, high = limits.lower_rad[i] - RANGE_ROUNDING_RAD, limits.upper_rad[i] + RANGE_ROUNDING_RAD
            if not low <= angle <= high:  # NaN fails here
                limit = limits.lower_rad[i] if angle < low else limits.upper_rad[i]
                return Violation(ViolationKind.RANGE, i + 1, angle, limit)
            total = angle - self._start[i]
            least, most = limits.correction_lower_rad[i], limits.correction_upper_rad[i]
            if not least - RANGE_ROUNDING_RAD <= total <= most + RANGE_ROUNDING_RAD:
                limit = least if total < least else most
                return Violation(ViolationKind.TOTAL_CORRECTION, i + 1, total, limit)
            step = angle - latest[i]
            if abs(step) > limits.step_rad[i]:
                return self._build_speed_violation(i, step)
            before = latest[i] - previous[i]
            bend = step - before
            if abs(bend) > limits.second_difference_rad[i]:
                most = limits.limits.acceleration_rad_s2[i]
                return Violation(ViolationKind.ACCELERATION, i + 1, bend / limits.cycle_s**2, most)
            twist = bend - before + previous[i] - earlier[i]
            if abs(twist) > limits.third_difference_rad[i]:
                most = limits.limits.jerk_rad_s3[i]
                return Violation(ViolationKind.JERK, i + 1, twist / limits.cycle_s**3, most)
        return None

    def sent(self, joints_rad: JointVector) -> None:
        """Record a set-point as sent."""
        latest, previous, earlier, _ = self._last
        self._last = (joints_rad, latest, previous, earlier)
        self._followed_rad = joints_rad
        self._add_recent(joints_rad)
        if self._watch is not None:
            self._watch.sent(joints_rad)

    def mark_not_accepted(self) -> Violation | None:
        """Record that the last set-point was not accepted and the previous one applies; recheck the step."""
        held = self._followed_rad = self._last[1]
        for i in range(len(held)):
            step = self._last[0][i] - held[i]
            if not abs(step) <= self.limits.step_rad[i]:
                return self._build_speed_violation(i, step)
        return None

    def _build_speed_violation(self, index: int, step_rad: float) -> Violation:
        most = self.limits.limits.speed_rad_s[index]
        return Violation(ViolationKind.SPEED, index + 1, step_rad / self.limits.cycle_s, most)

    def mark_sent_again(self) -> None:
        """Record a repeat of the last set-point. The next one is checked as if there had been no pause."""
        self._followed_rad = self._last[0]
        self._add_recent(self._followed_rad)

    def mark_at_rest(self) -> None:
        """Record that the arm is at rest at the held set-point, and that this set-point was sent."""
        self._last = (self._followed_rad, self._followed_rad, self._followed_rad, self._followed_rad)
        self._add_recent(self._followed_rad)
        if self._watch is not None:
            self._watch.sent(self._followed_rad)

    def check_measured(self, measured_rad: JointVector) -> Violation | None:
        """Check that each measured axis lies between its set-points of the last `FOLLOWING_TIME_S`.

        An arm at rest must be where it was sent, a moving one where it was sent a moment ago. A clamped,
        sticking or braked arm is noticed at every speed. The value is the distance from the nearest
        set-point.
        """
        if measured_rad == self._checked_rad:
            return None
        oldest, newest = self._recent[0], self._recent[-1]
        for i in range(len(measured_rad)):
            angle = measured_rad[i]
            low, high = (oldest[i], newest[i]) if oldest[i] < newest[i] else (newest[i], oldest[i])
            if low - FOLLOWING_RAD <= angle <= high + FOLLOWING_RAD:
                continue
            axis_angles = [sent[i] for sent in self._recent]  # the axis may have turned back meanwhile
            low, high = min(axis_angles), max(axis_angles)
            if not low - FOLLOWING_RAD <= angle <= high + FOLLOWING_RAD:  # NaN fails here
                error = angle - (high if angle > high else low)
                return Violation(ViolationKind.FOLLOWING_ERROR, i + 1, error, FOLLOWING_RAD)
        self._checked_rad = measured_rad if self._still_cycles >= self.limits.following_cycles else None
        return None

    def _add_recent(self, joints_rad: JointVector) -> None:
        if joints_rad is self._recent[-1]:
            self._still_cycles += 1
        else:
            self._still_cycles, self._checked_rad = 0, None
        self._recent.append(joints_rad)

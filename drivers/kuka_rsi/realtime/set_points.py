"""Set-points of a stream, computed and checked between telegrams.

Generator and monitor meet only here. If the monitor rejects the path's own stop, another one replaces it,
computed only from the points sent: onwards along the arm's present motion.
"""

from __future__ import annotations

from math import degrees
from typing import NamedTuple

from drivers.kuka_rsi.realtime.link_state import Choice, LinkSettings
from drivers.kuka_rsi.realtime.telegram import REPLY_TAIL, ReplyWriter
from ronna_hw.arm.clearance.bodies import Bodies, Surroundings
from ronna_hw.arm.clearance.live_watch import LiveWatch, Violation
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.monitor import Monitor, monitor_limits
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.motion.planning import MotionPlan
from ronna_hw.arm.motion.set_points import PathMotion, StopMotion, state_from_history
from ronna_hw.errors import RonnaError
from ronna_hw.vectors import JointVector

NO_AXES: JointVector = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class SetPoints:
    """Candidate points for the next reply: call `prepare`, then `commit` the choice sent."""

    def __init__(
        self, kinematics: Kinematics, limits: MotionLimits, cycle_s: float, start_rad: JointVector
    ) -> None:
        self._kinematics = kinematics
        self._bodies = Bodies(kinematics, Surroundings())
        self._limits = limits
        self._cycle_s = cycle_s
        self.monitor = Monitor(monitor_limits(kinematics, limits, cycle_s, start_rad), start_rad)
        self._motion: PathMotion | StopMotion | None = None
        self._joint_stop: StopMotion | None = None
        self.go_rad = start_rad
        self.stop_rad = start_rad
        self.violation: Violation | None = None  # why continuing is not allowed
        self.path_failed = False
        self.was_stopped_early = False  # of the last motion

    @property
    def last_rad(self) -> JointVector:
        """Point sent last."""
        return self.monitor.last_rad

    @property
    def held_rad(self) -> JointVector:
        """Point that the controller currently holds, according to its last report."""
        return self.monitor.held_rad

    @property
    def moving(self) -> bool:
        """Whether a motion is in progress."""
        return self._motion is not None

    def start(self, plan: MotionPlan, speed: float, surroundings: Surroundings | None = None) -> None:
        """Start a motion from rest, scaled to `speed`; raises the errors of the path and of ruckig.

        From here on the monitor also checks the clearance of these surroundings' bodies.
        """
        self.was_stopped_early = False
        if plan.is_standstill:
            return
        motion = PathMotion(
            plan.path(self._kinematics), plan.start_rad, plan.limits, self._cycle_s, plan.speed_steps
        )
        if surroundings is not None:
            if surroundings is not self._bodies.surroundings:
                self._bodies = Bodies(self._kinematics, surroundings)
            speed_mm_s = self._limits.body_speed_mm_s
            self.monitor.watch(LiveWatch(self._bodies, self._cycle_s, self.last_rad, speed_mm_s))
        if speed < 1.0:
            motion.limit_speed(speed)
        self._motion = motion

    def limit_speed(self, speed: float) -> None:
        """Limit the motion to a fraction of the planned speed."""
        if isinstance(self._motion, PathMotion):
            self._motion.limit_speed(speed)

    def prepare(self) -> None:
        """Compute and check the points for continuing and for stopping."""
        self._joint_stop = None
        motion = self._motion
        if motion is None:
            self.go_rad = self.stop_rad = self.last_rad
            return
        try:
            self.go_rad, self.stop_rad = motion.prepare()
        except RonnaError:
            self.path_failed = True
            self._use_joint_stop()
            self.go_rad = self.stop_rad
            return
        go_violation = self.monitor.check(self.go_rad)
        if self.stop_rad is self.go_rad:
            stop_violation = go_violation
        else:
            stop_violation = self.monitor.check(self.stop_rad)
        if go_violation is not None and self.violation is None:
            self.violation = go_violation
        if stop_violation is not None and not isinstance(motion, StopMotion):
            self._use_joint_stop()

    def commit(self, choice: Choice) -> None:
        """Advance the motion by the point that was sent."""
        if choice is Choice.GO:
            if self._motion is not None:
                self._motion.take_go()
            self.monitor.sent(self.go_rad)
        elif choice is Choice.STOP:
            if self._joint_stop is not None:
                self._motion = self._joint_stop
            if self._motion is not None:
                self._motion.take_stop()
            self.monitor.sent(self.stop_rad)
        elif choice is Choice.REPEAT:
            self.monitor.mark_sent_again()
        else:
            self._rest_here()
        if self._motion is not None and self._motion.is_finished:
            self.was_stopped_early = (
                not isinstance(self._motion, PathMotion) or self._motion.was_stopped_early
            )
            self._motion = None

    def abandon(self) -> None:
        """Abandon the motion after the arm has come to rest at the last point."""
        if self._motion is not None:
            self.was_stopped_early = True
        self._motion = None
        self.monitor.mark_at_rest()

    def _rest_here(self) -> None:
        one_back = self.held_rad is not self.last_rad
        self.monitor.mark_at_rest()
        if isinstance(self._motion, PathMotion):
            self._motion.restart_from_rest(one_back=one_back)
        elif self._motion is not None:
            self._motion = None
            self.was_stopped_early = True

    def _use_joint_stop(self) -> None:
        state = state_from_history(self.monitor.history_rad, self._cycle_s)
        self._joint_stop = StopMotion(state, self._limits, self._cycle_s)
        self.stop_rad = self._joint_stop.prepare().stop_rad


class PreparedReply(NamedTuple):
    """Complete reply to the next telegram, valid if the telegram contains nothing unexpected."""

    delay_and_ipoc: tuple[bytes, bytes]  # the controller's count unchanged, the next cycle
    stop_word: int  # no new stop
    choice: Choice
    reply: bytes


class Replies:
    """Reply encoder for one stream, with corrections relative to the joint angles of `begin`."""

    def __init__(self, settings: LinkSettings) -> None:
        self._writer = ReplyWriter(
            settings.sentype, settings.receive_tags, settings.axis_tags, settings.stop_tag
        )
        self._cycle_ms = settings.cycle_ms
        self._base_deg = NO_AXES
        self._points = (NO_AXES, NO_AXES)  # to continue and to stop
        self._ending = False
        self._last_head: tuple[JointVector, bool, bytes] | None = None

    def begin(self, base_deg: JointVector) -> None:
        """Start a run with these joint angles as the origin of corrections."""
        self._base_deg = base_deg
        self._last_head = None

    def prepare(self, points: SetPoints, *, ending: bool) -> None:
        """Take over the prepared points; with `ending`, also Stop once at rest."""
        moving = points.moving
        self._points = (points.go_rad, points.stop_rad) if moving else (points.last_rad, points.last_rad)
        self._ending = ending and not moving

    def head_for(self, choice: Choice) -> bytes:
        """Encode a reply up to its IPOC for the prepared point to continue or to stop."""
        return self.head(self._points[choice], self._ending)

    def complete(
        self, choice: Choice, *, last_ipoc: int, reported_late: int, stop_word: int
    ) -> PreparedReply:
        """Build the complete reply to the next expected telegram."""
        ipoc = str(last_ipoc + self._cycle_ms).encode()
        delay = str(reported_late).encode() if reported_late >= 0 else b""
        return PreparedReply((delay, ipoc), stop_word, choice, self.head_for(choice) + ipoc + REPLY_TAIL)

    def head(self, joints_rad: JointVector, stop: bool) -> bytes:
        """Encode a reply up to its IPOC; corrections in deg with six decimals."""
        last = self._last_head
        if last is not None and last[0] is joints_rad and last[1] is stop:
            return last[2]
        base = self._base_deg
        a, b, c, d, e, f = joints_rad
        head = self._writer.head(
            (
                degrees(a) - base[0],
                degrees(b) - base[1],
                degrees(c) - base[2],
                degrees(d) - base[3],
                degrees(e) - base[4],
                degrees(f) - base[5],
            ),
            stop,
        )
        self._last_head = (joints_rad, stop, head)
        return head

"""Set-points of a stream, computed and checked between telegrams.

Generator and monitor meet only here. If the monitor rejects the path's own stop, another one replaces it,
computed only from the points sent: onwards along the arm's present motion.
"""

from __future__ import annotations

from ronna_hw.arm.clearance.bodies import Bodies, Surroundings
from ronna_hw.arm.clearance.live_watch import LiveWatch, Violation
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.monitor import Monitor, monitor_limits
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.motion.planning import MotionPlan
from ronna_hw.arm.motion.set_points import PathMotion, StopMotion, state_from_history
from ronna_hw.arm_stream.guided import GuidedMotion, GuideLimits
from ronna_hw.arm_stream.records import Choice
from ronna_hw.errors import RonnaError
from ronna_hw.vectors import JointVector, Vector3


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
        self._motion: PathMotion | GuidedMotion | StopMotion | None = None
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

    @property
    def progress(self) -> float:
        """Share of the path that the motion in progress has left behind; 1.0 without one."""
        return self._motion.progress if isinstance(self._motion, PathMotion) else 1.0

    def at(self, choice: Choice) -> JointVector:
        """Return the point that a choice sends."""
        if choice is Choice.GO:
            return self.go_rad
        if choice is Choice.STOP:
            return self.stop_rad
        return self.last_rad if choice is Choice.REPEAT else self.held_rad

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
            self._watch_clearance(surroundings)
        if speed < 1.0:
            motion.limit_speed(speed)
        self._motion = motion

    def guide(self, guide: GuideLimits, speed: float, surroundings: Surroundings) -> None:
        """Follow a hand from rest until stopped; raises the errors of the kinematics."""
        self.was_stopped_early = False
        motion = GuidedMotion(self._kinematics, self.last_rad, guide, self._limits, self._cycle_s)
        motion.limit_speed(speed)
        self._watch_clearance(surroundings)
        self._motion = motion

    def push(self, force_N: Vector3) -> bool:
        """Pass on the force of a hand, if one is followed; True if that must end."""
        motion = self._motion
        if not isinstance(motion, GuidedMotion):
            return False
        motion.push(force_N)
        return motion.is_over

    def limit_speed(self, speed: float) -> None:
        """Limit the motion to a fraction of the planned speed."""
        if isinstance(self._motion, PathMotion | GuidedMotion):
            self._motion.limit_speed(speed)

    def _watch_clearance(self, surroundings: Surroundings) -> None:
        if surroundings is not self._bodies.surroundings:
            self._bodies = Bodies(self._kinematics, surroundings)
        speed_mm_s = self._limits.body_speed_mm_s
        self.monitor.watch(LiveWatch(self._bodies, self._cycle_s, self.last_rad, speed_mm_s))

    def prepare(self) -> None:
        """Compute and check the points for continuing and for stopping."""
        self._joint_stop = None
        if (motion := self._motion) is None:
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
        stop_violation = go_violation if self.stop_rad is self.go_rad else self.monitor.check(self.stop_rad)
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
            ended, self._motion = self._motion, None
            self.was_stopped_early = not isinstance(ended, PathMotion) or ended.was_stopped_early

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

"""Checkpoint, confirmation and journal entries for every motion of an arm.

The intent is on disk before a motion begins; its result follows once the arm rests. A motion that was
stopped from outside is asked about and re-planned from where the arm then is. The first motion after a stop
or after the end of the stream is confirmed by the operator.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence

from procedures.journal.errors import JournalNotWritable
from procedures.journal.journal import Entry, JournalValue
from procedures.operator.checkpoint import Checkpoint
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import YES, Question, Topic
from procedures.workcell.arm_history import ArmLog, MotionKind
from procedures.workcell.arms import Arms
from procedures.workcell.errors import BothArmsHalted
from procedures.workcell.motions import AnnouncedMotions, PlannedMotion, describe_motions, motion_facts
from ronna_hw.arm.errors import NotClear
from ronna_hw.devices import Lifecycle, Motion, RobotArm
from ronna_hw.devices.errors import MotionInterrupted, WrongState
from ronna_hw.devices.lifecycle import RUNNING
from ronna_hw.devices.readings import ArmReading
from ronna_hw.devices.robot import ConfirmedStart
from ronna_hw.errors import RonnaError

MOTION_DESCRIPTIONS = {
    MotionKind.GO: "to the next pose, via home if necessary",
    MotionKind.HOME: "home",
    MotionKind.BACK: "back the way the arm came",
    MotionKind.STEP: "directly to the next pose",
    MotionKind.SETTLE: "to the next pose, each joint arriving from its own side",
    MotionKind.LINE: "in a straight line",
    MotionKind.INSERT: "along the axis to where the guide is held",
    MotionKind.WITHDRAW: "out along the axis",
}
REPLANNED = "re-plans it from the arm's present position"
COVERS = (
    "a yes also covers every later motion without a question of its own, until the arm is stopped or its "
    "stream ends"
)
OPERATOR = "the operator of the case"  # the journal names the person, with the answer


class SupervisedMotion:
    """Supervised motions of one arm, numbered as in the journal.

    `ended` is the kind of the last motion if it ended where it was to, None if somebody stopped or jogged the
    arm since, or another program moved it.
    """

    def __init__(
        self,
        name: str,
        role: str,
        log: ArmLog,
        arms: Arms,
        require_allowed: Callable[[PlannedMotion], None],
        drive_leg: Callable[[Motion, PlannedMotion], ArmReading],
    ) -> None:
        """Supervise the arm of a role; `name` is that of messages.

        `require_allowed` raises if a motion must not be made now, `drive_leg` makes a leg of a motion.
        """
        self._name, self._role, self._log, self._arms = name, role, log, arms
        self._require_allowed, self._drive_leg = require_allowed, drive_leg
        self.ended: MotionKind | None = None
        self._checkpoint: Checkpoint | None = None
        self._ask: Callable[[Question], str] | None = None
        self._confirmed = False  # the first motion
        self._held = False  # the arm, by ourselves or when a motion was last asked about
        self._announced: AnnouncedMotions | None = None

    @property
    def _arm(self) -> RobotArm:
        return self._arms[self._role]

    @contextlib.contextmanager
    def announce_step_motions(self, announced: AnnouncedMotions | None) -> Iterator[None]:
        """Within the block, include all motions of the step when asking to confirm the first one."""
        self._announced = announced
        try:
            yield
        finally:
            self._announced = None

    def ask_before(self, checkpoint: Checkpoint, ask: Callable[[Question], str]) -> None:
        """From now on, pass this checkpoint before every motion and ask before the first one."""
        self._checkpoint, self._ask = checkpoint, ask

    def reset_confirmation(self) -> None:
        """Require confirmation of the next motion, as after a stop of the arm or the end of its stream."""
        self._confirmed = False

    def note_hold(self) -> None:
        """Note a stop between two motions of a step, so that the next one needs no confirmation."""
        self._held = True

    def confirm(
        self,
        topic: Topic,
        subject: str,
        motions: Sequence[PlannedMotion],
        trajectory: str | None = None,
        announced: AnnouncedMotions | None = None,
        covers: str = "",
    ) -> None:
        """Ask a person to confirm motions in two steps. Raises PRO-002 unless the answer is yes.

        `announced` motions and what `covers` says are confirmed by the same answer. Nobody is asked about
        motions that would be refused: raises ARM-007 for those.
        """
        if motions:
            self._arms.look_around(self._role)
        facts = motion_facts(self._arm, motions) if motions else []
        for fact in facts:
            fact.require_clear()
        question = Question(
            topic,
            subject,
            describe_motions(facts, announced, covers),
            trajectory=trajectory,
            read_back=facts[0].read_back if facts else None,
        )
        self._held = self._arm.state is Lifecycle.HOLD
        self._confirmed = self._require_yes(question) or self._confirmed

    def start(self) -> None:
        """Activate the arm, if it is configured.

        A driver may require a confirmation before it starts its arm, and may then move it out and back. The
        operator is asked, and the start is journalled as a motion. Raises PRO-002 unless the answer is yes.
        """
        arm = self._arm
        if arm.state is not Lifecycle.CONFIGURED:
            return
        if isinstance(arm, ConfirmedStart) and (words := arm.to_confirm) is not None:
            self._confirmed = False
            if self._require_yes(Question(Topic.UNVERIFIED, f"start the {self._name}", words)):
                arm.confirm_start(OPERATOR)
                self._drive_journalled(
                    {"what": MotionKind.START, "to": [], "trajectory": None}, self._activate
                )
                return
        arm.activate()

    def _activate(self) -> ArmReading:
        self._arm.activate()
        return self._arm.read_state()

    def _require_yes(self, question: Question) -> bool:
        """Ask a question. Return False without an operator; raise PRO-002 unless the answer is yes."""
        if self._ask is None:
            return False
        if self._ask(question) != YES:
            raise NotConfirmed(f"the operator did not confirm '{question.subject}'", got=question.value_line)
        return True

    def carry_out_with_detour(self, motion: PlannedMotion) -> ArmReading:
        """Carry out a motion or, if its path is not clear, the replacement motions. Raises as `carry_out`."""
        try:
            return self.carry_out(motion)
        except NotClear:
            if not motion.replacement:
                raise
            return [self.carry_out(one) for one in motion.replacement][-1]

    def carry_out(self, motion: PlannedMotion) -> ArmReading:
        """Carry out a motion; if it is stopped, replan it once the operator agrees.

        Whether it is allowed is checked first, and again right before the arm moves. Raises PRO-002, PRO-003,
        PRO-004, findings of guards and watches, the reason against the motion, and the errors of the arm.
        """
        if motion.what is MotionKind.HOME:
            self.ended = None
        self._require_allowed(motion)
        checkpoint = self._checkpoint
        if checkpoint is None:
            raise NotConfirmed(
                f"the motion '{motion.what}' cannot be confirmed: the case is closed", expected="an open case"
            )
        named = f"the motion '{motion.what}' ({MOTION_DESCRIPTIONS[motion.what]})"

        def drive() -> ArmReading:
            with checkpoint.watching(named, motion.what):
                self._require_allowed(motion)
                return [self._drive_leg(leg, motion) for leg in motion.legs][-1]

        while True:
            checkpoint.here(f"before {named}")
            if not self._confirmed:
                self.confirm(
                    Topic.FIRST_MOTION,
                    f"May the {self._name} move: first {MOTION_DESCRIPTIONS[motion.what]}, then as listed?",
                    [motion],
                    motion.trajectory,
                    self._announced,
                    COVERS,
                )
                if checkpoint.wanted:  # such as a stop while the question stood
                    self._confirmed = False
                continue  # the question may have stood for minutes: ask the guards again
            if not checkpoint.wanted and self._arm.state is Lifecycle.HOLD:
                if not self._held:  # stopped from outside
                    self._confirmed = False
                    checkpoint.rest_after_stop(f"the {self._name}, before {named},", REPLANNED)
                    continue
                self._arm.resume()  # moves nothing
                self._held = False
            if checkpoint.wanted:  # since the checkpoint
                self._confirmed = False
                continue
            self.ended = None
            try:
                reached = self._drive_journalled(motion.as_intent(), drive)
            except (MotionInterrupted, WrongState) as error:
                # A stop right before the motion, or between its legs, puts the arm into HOLD: it refuses.
                if isinstance(error, WrongState) and self._arm.state is not Lifecycle.HOLD:
                    raise
                self._confirmed = False
                checkpoint.rest_after_stop(named, REPLANNED)
                continue
            except BothArmsHalted:
                self._confirmed = False
                if not self._arms.release_held(OPERATOR):  # a fault, which a named person acknowledges
                    raise
                checkpoint.rest_after_stop(named, REPLANNED)
                continue
            self.ended = motion.what
            return reached

    def _drive_journalled(
        self, intent: dict[str, JournalValue], drive: Callable[[], ArmReading]
    ) -> ArmReading:
        """Drive a motion between its two journal lines and return the last reading."""
        number = self._log.history.motions + 1
        self._log.write(Entry.MOTION, number=number, **intent)
        try:
            reached = drive()
        except BaseException as error:  # also an interruption: every intent has its result
            code = error.code if isinstance(error, RonnaError) else type(error).__name__
            at_home = self._rests_at_home() if isinstance(error, RonnaError) else None
            with contextlib.suppress(JournalNotWritable):  # the error that ended the motion is reported
                self._log.note(Entry.MOVED, number=number, error=code, at_home=at_home)
            raise
        joints_rad = reached.joints_rad
        at_home = self._log.is_home(joints_rad)
        self._log.note(Entry.MOVED, number=number, joints_rad=list(joints_rad), at_home=at_home)
        return reached

    def _rests_at_home(self) -> bool | None:
        """Return whether a failed motion left the arm at home, or None if its joints cannot be read."""
        with contextlib.suppress(RonnaError):
            if self._arm.state in RUNNING:
                return self._log.is_home(self._arm.read_state().joints_rad)
        return None

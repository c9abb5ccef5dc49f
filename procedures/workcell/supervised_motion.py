"""Around every motion: a checkpoint before it, its intent and its result in the journal.

The intent is on disk before the motion begins, the result follows when the arm rests. A motion that someone
else stopped is asked about, and re-planned from the arm's present position. The first motion since the arm
was last stopped or its stream ended is confirmed by the operator.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence

from procedures.journal.errors import JournalNotWritable
from procedures.journal.journal import Entry, JournalValue
from procedures.operator.checkpoint import Checkpoint
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import YES, Question, Topic
from procedures.workcell.arm_log import ArmLog
from procedures.workcell.cell_motion import CellMotion, MotionName
from procedures.workcell.motion_facts import in_a_question, motion_facts
from ronna_hw.devices import Lifecycle, RobotArm
from ronna_hw.devices.errors import MotionInterrupted, WrongState
from ronna_hw.devices.lifecycle import RUNNING
from ronna_hw.devices.readings import ArmReading, JointVector
from ronna_hw.errors import RonnaError

IN_WORDS = {
    MotionName.GO: "to the next pose, via home if necessary",
    MotionName.HOME: "home",
    MotionName.BACK: "back the way the arm came",
    MotionName.STEP: "directly to the next pose",
    MotionName.SETTLE: "to the next pose, each joint arriving from its own side",
    MotionName.LINE: "in a straight line",
    MotionName.INSERT: "along the axis to where the guide is held",
    MotionName.WITHDRAW: "out along the axis",
}
REPLANNED = "re-plans it from the arm's present position"
COVERS = (
    "; a yes also covers every later motion without a question of its own, until the arm is stopped or its "
    "stream ends{}"
)


class SupervisedMotion:
    """Carries motions of one arm out one after the other, numbered as they are in the journal."""

    def __init__(
        self,
        log: ArmLog,
        arm: Callable[[], RobotArm],
        is_home: Callable[[JointVector], bool | None],
        require: Callable[[CellMotion], None],
    ) -> None:
        """`is_home` compares joints with those of home; `require` raises what forbids a motion."""
        self._log = log
        self._arm = arm
        self._is_home = is_home
        self._require = require
        self._checkpoint: Checkpoint | None = None
        self._ask: Callable[[Question], str] | None = None
        self._confirmed = False  # the first motion
        self._held = False  # the arm, by ourselves or when a motion was last asked about
        self._course = ""

    @contextlib.contextmanager
    def leading(self, course: str) -> Iterator[None]:
        """Within, a confirmation of the first motion also says what all motions of the step come to."""
        self._course = course
        try:
            yield
        finally:
            self._course = ""

    def ask_before(self, checkpoint: Checkpoint, ask: Callable[[Question], str]) -> None:
        """From now on every motion meets that checkpoint, and the first one is asked about."""
        self._checkpoint, self._ask = checkpoint, ask

    def begin_anew(self) -> None:
        """The arm was stopped or its stream ended: the next motion is a first one again."""
        self._confirmed = False

    def is_held(self) -> None:
        """The arm was stopped between two motions of a step: the next one leads on."""
        self._held = True

    def confirm(
        self,
        topic: Topic,
        subject: str,
        motions: Sequence[CellMotion],
        trajectory: str | None = None,
        covers: str = "",
    ) -> None:
        """Have motions confirmed, in two steps where a person answers; raises PRO-002 unless it is a yes.

        `covers` says what else is confirmed with them.
        """
        facts = motion_facts(self._arm(), motions) if motions else []
        read_back = facts[0].read_back if facts else None
        question = Question(
            topic,
            subject,
            in_a_question(facts) + covers,
            trajectory=trajectory,
            read_back=read_back,
        )
        self._held = self._arm().state is Lifecycle.HOLD
        self._confirmed = self._require_yes(question) or self._confirmed

    def confirm_start(self, words: str) -> bool:
        """Have confirmed what a driver asks before the arm starts; False when there is nobody to ask.

        Raises PRO-002 unless the answer is yes.
        """
        self._confirmed = False
        return self._require_yes(Question(Topic.UNVERIFIED, "start the arm", words))

    def start(self, activate: Callable[[], None]) -> None:
        """Start the arm as confirmed: its driver may move it out and back. Raises what `activate` raises."""

        def drive() -> ArmReading:
            activate()
            return self._arm().read_state()

        self._recorded({"what": MotionName.START, "to": [], "trajectory": None}, drive)

    def _require_yes(self, question: Question) -> bool:
        """False when there is nobody to ask; raises PRO-002 unless the answer is yes."""
        if self._ask is None:
            return False
        if self._ask(question) != YES:
            raise NotConfirmed(f"the operator did not confirm: {question.subject}", got=question.value)
        return True

    def carry_out(self, motion: CellMotion) -> ArmReading:
        """Carry out a motion; re-planned after a stop if the operator says so.

        What forbids it is asked first, and each time right before it is driven. Raises PRO-002, PRO-003,
        PRO-004, what a guard or a watch found, and what `require` and the motion raise.
        """
        self._require(motion)
        checkpoint = self._checkpoint
        if checkpoint is None:
            raise NotConfirmed(
                f"the motion '{motion.what}' cannot be confirmed: the case is closed", expected="an open case"
            )
        named = f"the motion '{motion.what}' ({IN_WORDS[motion.what]})"

        def drive() -> ArmReading:
            with checkpoint.watching(named, True):
                self._require(motion)
                return motion.drive(self._arm())

        while True:
            checkpoint.here(f"before {named}")
            if not self._confirmed:
                self.confirm(
                    Topic.FIRST_MOTION,
                    f"first motion: {IN_WORDS[motion.what]}",
                    [motion],
                    motion.trajectory,
                    COVERS.format(f", here {self._course}" if self._course else ""),
                )
                if checkpoint.wanted:  # such as a stop while the question stood
                    self._confirmed = False
                continue  # the question may have stood for minutes: the guards are asked again
            if not checkpoint.wanted and self._arm().state is Lifecycle.HOLD:
                if not self._held:  # somebody else has stopped it
                    self._confirmed = False
                    checkpoint.stopped(f"the arm, before {named},", REPLANNED)
                    continue
                self._arm().resume()  # moves nothing
                self._held = False
            if checkpoint.wanted:  # since the checkpoint
                self._confirmed = False
                continue
            try:
                intent: dict[str, JournalValue] = {"what": motion.what, "to": list(motion.to)}
                intent["trajectory"] = motion.trajectory
                if motion.axis is not None:
                    intent["axis"] = motion.axis.as_plain()
                return self._recorded(intent, drive)
            except (MotionInterrupted, WrongState) as error:
                # A stop right before the motion, or between its legs, puts the arm into HOLD: it refuses.
                if isinstance(error, WrongState) and self._arm().state is not Lifecycle.HOLD:
                    raise
                self._confirmed = False
                checkpoint.stopped(named, REPLANNED)

    def _recorded(self, intent: dict[str, JournalValue], drive: Callable[[], ArmReading]) -> ArmReading:
        """The last reading of a motion that is written down before and after."""
        number = self._log.history.motions + 1
        self._log.write(Entry.MOTION, number=number, **intent)
        try:
            reached = drive()
        except BaseException as error:  # also an interruption: every intent has its result
            code = error.code if isinstance(error, RonnaError) else type(error).__name__
            at_home = self._rests_at_home() if isinstance(error, RonnaError) else None
            with contextlib.suppress(JournalNotWritable):  # what ended the motion is told
                self._log.note(Entry.MOVED, number=number, error=code, at_home=at_home)
            raise
        A, at_home = reached.joints_rad, self._is_home(reached.joints_rad)
        self._log.note(Entry.MOVED, number=number, joints_rad=list(A), at_home=at_home)
        return reached

    def _rests_at_home(self) -> bool | None:
        """Where a motion that failed left the arm; None if its joints cannot be read."""
        with contextlib.suppress(RonnaError):
            if self._arm().state in RUNNING:
                return self._is_home(self._arm().read_state().joints_rad)
        return None

"""Failure branches and operator decisions of a case: event, detection, action and ending.

The only such table: steps take their questions from it, the page of the state chart shows it, and a test
reaches every row. No branch moves the arm again unasked.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from procedures.calibration.errors import PlatformMoved
from procedures.engine.questions import INSIDE, IS_OUT
from procedures.guards.errors import BaseShifted, FrameSlipped, PatientMoved, RoomUndecided
from procedures.journal.errors import GateFailed
from procedures.operator.checkpoint import CONTINUE, LEAVE, WAIT
from procedures.operator.errors import GuardUnmet, NotConfirmed, OperatorAborted
from procedures.operator.question import NO, YES, Question, Topic
from procedures.planning.errors import NotReachable, WrongMarkerCount
from procedures.planning.free_angle import BY_ACCURACY
from procedures.registration.errors import DUPLICATE_POINTS, NO_UNIQUE_MATCH, HeadElsewhere
from procedures.registration.surface.errors import (
    CARRIED_DIFFERS,
    FAR_FROM_START,
    HEAD_MOVED,
    LITTLE_COVERAGE,
    MIRRORED_HEAD,
    MUCH_EXCLUDED,
    NO_STATIONS,
    NOTHING_LIT,
    OTHER_HEAD,
    POORLY_DETERMINED,
    SKIN_CHANGED,
    SPHERE_MOVED,
    SPHERE_UNSEEN,
    TWO_POSES,
)
from procedures.relocalization.errors import SERVO_DIVERGES, SERVO_EXHAUSTED, Saturated
from procedures.steps.errors import CART_NOT_LOCKED, CART_OUT_OF_PLACE, DEPTH_STOP_WRONG, ToolBesideGauge
from procedures.workcell.errors import SPHERE_NOT_FOUND, WrongTool
from ronna_hw.errors import AnyCode, RonnaError
from ronna_hw.wire.room_tasks import DRILL, DURA, INSERT, SKIN

GO_ON, LEAVE_OUT, FOLLOW, HOLD = "go on", "leave it out", "follow", "hold"
HOLD_GUIDE = "hold the guide"
# What an answer that decides nothing does, in the words of its question.
HOLDING = {
    HOLD: "nothing moves, the step ends, and every result is kept",
    HOLD_GUIDE: "nothing moves and the step ends; repeat it to go on, "
    "or take the instrument out and drive home",
}
FINISHED = "finished"  # all that was to be done through the guide was done before
AGAIN, AS_IT_STANDS = "placed again", "as it stands"
FEWEST_SPHERES = 4  # that must remain: with three, a moved one cannot be identified
SETTINGS = 3  # of a depth stop, before the case is held
PLACINGS = 3  # of the cart, before the case is held
MOUNTINGS = 3  # of a tool that is not the right one, before the case is held


class BranchEnding(StrEnum):
    """How a failure branch ends."""

    HOLD = "hold"  # the step fails with an error: arm at rest, every result stands
    ASK = "ask"  # the operator decides; without agreement it holds
    ABORT = "abort"  # the case ends
    RECORDED = "recorded"  # no motion depends on it: the case continues, the record shows it


@dataclass(frozen=True)
class Branch:
    """A failure branch. `errors` hold the case, immediately or if the operator disagrees."""

    event: str
    detected_by: str
    steps: tuple[str, ...]  # in which it can happen; none for any
    action: str
    errors: tuple[AnyCode[RonnaError], ...] = ()
    topic: Topic | None = None  # of the question, if the operator decides
    answers: tuple[str, ...] = ()
    ending_unasked: BranchEnding = BranchEnding.HOLD

    @property
    def ending(self) -> BranchEnding:
        return self.ending_unasked if self.topic is None else BranchEnding.ASK

    def question(
        self, subject: str, value: str, trajectory: str | None = None, answers: tuple[str, ...] | None = None
    ) -> Question:
        """Build the branch's question, by default with all answers. Raises ValueError without a topic.

        Its value ends with what holding does, where that can be answered.
        """
        if self.topic is None:
            raise ValueError(f"no question is defined for: {self.event}")
        answers = answers or self.answers
        return Question(self.topic, subject, value + tell_holding(answers), answers, trajectory)


def tell_holding(answers: tuple[str, ...]) -> str:
    """Return the lines that say what holding does, to follow the value of a question with these answers."""
    return "".join(f"\n{word}: {does}" for word, does in HOLDING.items() if word in answers)


def strategy_answer(strategy: str) -> str:
    """Return the answer that agrees to another strategy."""
    return f"use {strategy}"


def stage_answer(task: str) -> str:
    """Return the answer for resuming the work through the guide at a given stage."""
    return f"from {task}"


SPHERE_COUNT = Branch(
    "the CT shows more or fewer spheres than were implanted",
    "number of spheres found against the plan",
    ("plan_check",),
    f"all candidates are shown; fewer are accepted only if {FEWEST_SPHERES} remain",
    (WrongMarkerCount,),
    Topic.SPHERE_COUNT,
    (GO_ON, HOLD),
)
CT_DISAGREEMENT = Branch(
    "the two estimates of a sphere in the CT differ by more than 0.06 mm",
    "distance between the two centres",
    ("fiducial_localization",),
    "the sphere is flagged and weighted less: its covariance grows by the difference",
    ending_unasked=BranchEnding.RECORDED,
)
SIGHT_LOST = Branch(
    "the tracker loses sight of the reference frame",
    "frames that lack it, or are partial, disturbed or stale",
    ("global_localization",),
    "nothing moves; the step is repeated once the line of sight is clear",
    (GateFailed,),
)
GUARD_UNMET = Branch(
    "a guard's condition is not met: line of sight, reference, age of data",
    "the guards at every checkpoint",
    (),
    "the case is suspended and waits; then the operator keeps waiting or leaves the step",
    (GuardUnmet,),
    Topic.GUARD,
    (WAIT, LEAVE),
)
HEAD_UNSEEN = Branch(
    "a guide is near a head that the tracker has not seen for 10 s",
    "theatre time since three known spheres were last seen in place, during motions and at the target",
    ("positioning", "at_target"),
    "the arm stops and the case is suspended until the head is seen; or the operator continues without "
    "it for as long again, or leaves the step",
    (GuardUnmet,),
    Topic.HEAD_UNSEEN,
    (WAIT, CONTINUE, LEAVE),
)
AMBIGUOUS = Branch(
    "the spheres of CT and room match in several ways, or not at all",
    "log-likelihood over the runner-up below ln 10,000",
    ("correspondence",),
    "both pairings are shown; neither is used",
    (NO_UNIQUE_MATCH,),
)
MIRRORED_CT = Branch(
    "a mirrored CT would match as well, and the head is not where the match has it",
    "the match of the mirrored spheres in view of the tracker; then a point of the head, touched and read",
    ("correspondence",),
    "the point is named with how far away it was read, and toward which side; nothing is localized further",
    (HeadElsewhere,),
)
UNMATCHED_SPHERE = Branch(
    "a sphere is missing in the room, on the wrong screw, or far from its position",
    "ignoring the count, the CT matches in exactly one way, with fewer spheres than were implanted",
    ("correspondence",),
    f"it is named; the case continues with the others if {FEWEST_SPHERES} remain and the operator agrees",
    (NO_UNIQUE_MATCH,),
    Topic.UNMATCHED_SPHERE,
    (LEAVE_OUT, HOLD),
)
SPHERE_FAILED = Branch(
    "the stereo head cannot measure a sphere: out of the field of view, hidden, too dark, "
    "servo does not converge",
    "three search rings of 5 mm, other exposures, 15 servo steps",
    ("relocalization",),
    f"left out if {FEWEST_SPHERES} remain and the operator agrees; the head backs off along its axis",
    (SPHERE_NOT_FOUND, SERVO_DIVERGES, SERVO_EXHAUSTED, Saturated),
    Topic.SPHERE,
    (LEAVE_OUT, HOLD),
)
WRONG_SPHERE = Branch(
    "a sphere is not where the tracker saw it",
    "fine against coarse position, 3 mm",
    ("relocalization", "surface_scan"),
    "wrong sphere, or the patient moved: localize with the tracker again",
    (GateFailed,),
)
CART_MISPLACED = Branch(
    "the cart is not where `ronna-plan place` proposed",
    "place.json of the case against the frame on the arm and the spheres, both as seen by the tracker",
    ("cart_lock",),
    f"the correction is shown; the cart is placed again, {PLACINGS} times at most, or stays if the "
    "operator says so: the path check judges the actual position",
    (CART_OUT_OF_PLACE,),
    Topic.CART_PLACE,
    (AGAIN, AS_IT_STANDS, HOLD),
)
CART_UNLOCKED = Branch(
    "the cart is not locked",
    "nobody confirms it, or the frame on the arm moves against the spheres while someone "
    "leans on the cart; 0.3 mm",
    ("cart_lock",),
    "nothing is localized and nothing moves; it is locked and leaned on again",
    (CART_NOT_LOCKED,),
)
REFERENCE_MOVED = Branch(
    "the patient's reference has moved: head, cart or tracker",
    "known spheres and the frame on the arm, at rest before and after motions; the spheres also while the "
    "guide moves and while it is at its target",
    ("relocalization", "surface_scan", "tool_change", "positioning", "at_target", "retreat", "confirmation"),
    "the arm stops; the localization is void: the arm goes home, the stereo head is mounted again and "
    "the tracker localizes again. After a small move with the guide mounted, only the registrations "
    "are void, and may follow the move",
    (BaseShifted, PatientMoved, FrameSlipped),
)
REFERENCE_UNDECIDED = Branch(
    "the head with its clamp, or the tracker, was moved while the arm was in a pose not seen before",
    "the patient's frame on the clamp and the spheres, which have moved as one; the frame on the arm tells "
    "which it was only where the arm has rested before",
    ("relocalization", "surface_scan", "positioning", "retreat"),
    "the arm stops and nothing is void; from home, the next look follows a pushed tracker, or names the "
    "head that has moved",
    (RoomUndecided,),
)
CART_MOVED = Branch(
    "a cart or the tracker has moved; whatever depends on its position is void",
    "the frame on the arm according to tracker and arm, as above; during motions with the guide and at the "
    "target from 10 mm on",
    (
        *("relocalization", "surface_scan", "tool_change", "tool_check", "positioning", "at_target"),
        *("retreat", "confirmation"),
    ),
    "if the operator agrees, the arm goes home, the cart is locked again and the case continues from "
    "the global localization; CT, plan and finished targets remain valid. If all are finished, the arm "
    "goes home and the case ends. While an instrument is or may be inside, nobody is asked and nothing moves",
    (BaseShifted, PlatformMoved),
    Topic.CART_MOVED,
    (GO_ON, HOLD),
)
MOVE_FOLLOWED = Branch(
    "with the guide mounted, the head has moved by up to 5 mm and 2 degrees as a rigid body, and is at rest",
    "60 tracker frames, arm at home, frame on the arm unmoved",
    ("registration",),
    "if the operator agrees, the registration follows the measured move and the prediction includes "
    "its error; otherwise the localization is void",
    (PatientMoved,),
    Topic.MOVE_FOLLOWED,
    (FOLLOW, HOLD),
)
MOVED_SPHERE = Branch(
    "the fit disagrees with its own error budget, and one sphere alone explains it",
    "chi-square gate, then leaving out one sphere at a time",
    ("registration",),
    "the sphere is named; registration without it if the operator agrees",
    (GateFailed,),
    Topic.MOVED_SPHERE,
    (LEAVE_OUT, HOLD),
)
FIT_DISAGREES = Branch(
    "the fit disagrees with its own error budget, and no single sphere explains it",
    "chi-square gate, then leaving out one sphere at a time",
    ("registration",),
    "localize again",
    (GateFailed,),
)
CORRECTION_BEYOND = Branch(
    "the looks ask for a correction of the arm that its stated errors do not make believable",
    "length of the learned correction against 99.9 % of the arm's errors there at the learned size",
    ("registration",),
    "arm, stereo head and guide are checked against their calibrations; localize again",
    (GateFailed,),
)
BEYOND_MARGIN = Branch(
    "the predicted error at a target exceeds the plan's margin",
    "propagation of all errors to the target",
    ("registration", "surface_registration"),
    "the trajectory is refused; the others continue without it if the operator agrees",
    (GateFailed,),
    Topic.MARGIN,
    (LEAVE_OUT, HOLD),
)
UNLIKE_LANDMARKS = Branch(
    "nose and ears, as touched or measured, do not fit the head in the CT, or put it elsewhere than planned, "
    "or than its clamp",
    "rms of the landmarks about their fit; the place of the head it gives, against the plan and the frame on "
    "the clamp",
    ("head_measurement", "surface_start"),
    "the one that fits worst is named, or those that were exchanged; they are read again",
    (GateFailed, HeadElsewhere, DUPLICATE_POINTS),
)
HEAD_NOT_FOUND = Branch(
    "first looks do not find the head where it was measured",
    "number of looks in reach, of lines, and the pose by them against the measured one and the plan",
    ("surface_start",),
    "what was measured is void: nose and ears are measured again before the arm goes there again",
    (
        *(NO_STATIONS, NOTHING_LIT, LITTLE_COVERAGE, MUCH_EXCLUDED, POORLY_DETERMINED),
        *(TWO_POSES, OTHER_HEAD, FAR_FROM_START, HeadElsewhere),
    ),
)
MIRRORED_SKIN = Branch(
    "left and right of the CT are exchanged",
    "the mark of an entry, touched; then the mirror image of the scan, which must not fit better",
    ("surface_start", "surface_registration"),
    "nothing moves; patient, CT and its export are compared",
    (MIRRORED_HEAD,),
)
UNPAIRED_BESIDE_SKIN = Branch(
    "a sphere beside the skin is not seen by the tracker, or two could be exchanged",
    "readings near the places where nose and ears put the spheres",
    ("surface_start",),
    "the sphere is named; view and landmarks are checked, and the tracker localizes again",
    (SPHERE_UNSEEN,),
)
FEW_LOOKS = Branch(
    "the arm can look at few places on the skin",
    "number of looks in reach, with clear ways",
    ("path_check",),
    "nothing moves; the head is turned, or the cart placed elsewhere",
    (NO_STATIONS,),
)
DARK_SCAN = Branch(
    "no look at the skin shows the line of light, or none any more",
    "pairs of pictures with the light and without",
    ("surface_scan",),
    "nothing is registered; projector, light and cameras are checked, and the looks without a line are taken "
    "again",
    (NOTHING_LIT,),
)
UNMEASURED_BESIDE_SKIN = Branch(
    "the stereo head cannot measure a sphere beside the skin",
    SPHERE_FAILED.detected_by,
    ("surface_scan",),
    "the sphere is named; with so few none is left out. A new run can register on the skin alone",
    SPHERE_FAILED.errors,
)
LITTLE_SKIN = Branch(
    "the scan covers too little bare skin, leaves a target undetermined, or fits in two poses",
    "share of the head above the jaw, of hair and other bodies; predicted error; the second best pose",
    ("surface_registration",),
    "the scan is void, or the start if two poses fit: more of the head is bared or turned into view, and "
    "scanned again",
    (LITTLE_COVERAGE, MUCH_EXCLUDED, POORLY_DETERMINED, TWO_POSES),
)
UNLIKE_SKIN = Branch(
    "the scan does not have the shape of the head in the CT, or puts its landmarks elsewhere",
    "distance of the scan from the skin, and of the landmarks from where they were touched",
    ("surface_registration",),
    "patient, CT, drapes and landmarks are checked; the scan is void, or the start with its landmarks, and "
    "the skin is scanned again",
    (OTHER_HEAD, FAR_FROM_START),
)
LOOKS_DISAGREE = Branch(
    "the head moved while it was scanned",
    "looks before against looks after, each moved rigidly, against what skin explains",
    ("surface_registration",),
    "the look is named; clamp and brakes are checked; the scan is void, and the skin is scanned again",
    (HEAD_MOVED,),
)
SKIN_MOVED = Branch(
    "the skin is not where it was in the CT over a large part of the scan",
    "patches of the scan that all lie on one side of the skin, against its usual misfit",
    ("surface_registration",),
    "the parts are named; clamp and what presses on them are checked; the scan is void, and the skin is "
    "scanned again",
    (SKIN_CHANGED,),
)
SPHERE_OFF_SKIN = Branch(
    "a sphere is not where the skin, and the other spheres, have it",
    "its place against the one predicted without it",
    ("surface_registration",),
    "the sphere is named; the localization is void, and the tracker localizes again. None is left out in the "
    "same run",
    (SPHERE_MOVED,),
)
CARRIED_ELSEWHERE = Branch(
    "after a small move of the clamp, the skin is not where its frame has carried the registration",
    "six looks at skin that was scanned before, point by point",
    ("surface_registration",),
    "the landmarks are touched again, and the whole skin is scanned",
    (CARRIED_DIFFERS,),
)
UNREACHABLE = Branch(
    "a trajectory cannot be reached with its strategy: out of range, singular, not seen, or not clear "
    "at any free angle",
    "every pose and motion, at up to 90 degrees about the axis",
    ("path_check",),
    "a working free angle is used and reported; otherwise, if the operator agrees, another strategy "
    "that reaches it, or the others continue without it",
    (NotReachable,),
    Topic.UNREACHABLE,
    (*(strategy_answer(name) for name in BY_ACCURACY), LEAVE_OUT, HOLD),
)
NOT_CLEAR_NOW = Branch(
    "with the fine registration, the path to a target is not clear or out of range",
    "the same checks, right before the motion",
    ("positioning",),
    "nothing moves; the trajectory is named",
    (NotReachable,),
)
ARM_FAULT = Branch(
    "the arm is in fault: late packets, protective stop, following error, controller",
    "driver and monitor, every cycle",
    (),
    "safe stop; nothing starts until the fault is acknowledged. A mounted guide is checked at the "
    "gauge again before the next target",
)
KEPT_REGISTRATION = Branch(
    "a registration is older than a fault of the arm",
    "acknowledged faults",
    ("positioning",),
    "it is kept only if the operator says so",
    (GateFailed,),
    Topic.REGISTRATION_KEPT,
    (YES, NO),
)
KEPT_BASES = Branch(
    "the bases of two arms are older than a fault of one of them",
    "acknowledged faults",
    ("at_target",),
    "they are kept only if the operator says that no arm, tool or cart was touched",
    (GateFailed,),
    Topic.REGISTRATION_KEPT,
    (YES, NO),
)
WRONG_TOOL = Branch(
    "the wrong tool is mounted after an exchange",
    "the controller's inputs",
    ("tool_change", "global_localization"),
    f"the tool is mounted and checked again, {MOUNTINGS} times at most; nothing moves",
    (WrongTool,),
    Topic.TOOL_CHANGE,
    (YES, NO),
)
TOOL_BESIDE_GAUGE = Branch(
    "the mounted guide is not as it was when its tip was calibrated: bent, badly seated, wrong "
    "mandrel, or the arm sags because the configured load is wrong",
    "dials of a gauge on the table, 0.05 mm and 0.1 deg from the tool's record",
    ("tool_check",),
    "it is mounted again and checked again, once, if the operator agrees; nothing moves towards the patient",
    (ToolBesideGauge,),
    Topic.TOOL_CHANGE,
    (YES, NO),
)
WRONG_STOP = Branch(
    "the depth stop of the instrument is set wrong",
    "the reading of its scale against the computed value, 0.1 mm",
    ("at_target",),
    f"it is set and read again, {SETTINGS} times at most; no instrument is inserted",
    (DEPTH_STOP_WRONG,),
    Topic.DEPTH_STOP,
    (YES, NO),
)
WORK_BEGUN = Branch(
    "the guide returns to a target where it has already been worked through: after a "
    "move, a restart, a repeat",
    "the journal, which records each stage before it begins",
    ("at_target",),
    "the work done there is listed; the operator chooses the stage to continue from, "
    "possibly one already done",
    (NotConfirmed,),
    Topic.WORK_BEGUN,
    (FINISHED, *(stage_answer(task) for task in (INSERT, DURA, DRILL, SKIN)), HOLD_GUIDE),
)
GUIDE_PUSHED = Branch(
    "someone pushes or pulls the guide, or the arm",
    "the frame on the mount as seen by the tracker, and the joints, against the held pose "
    "of the guide; 0.2 mm",
    ("at_target",),
    "reported immediately; the case is suspended until guide and arm are released, or the operator "
    "leaves the step",
    (GuardUnmet,),
    Topic.GUARD,
    (WAIT, LEAVE),
)
INSTRUMENT_INSIDE = Branch(
    "the arm must move while an instrument is, or may be, in the guide: also after a restart",
    "the journal, which records an insertion before it begins",
    ("tool_check", "at_target", "retreat", "confirmation"),
    "nothing moves until the operator has confirmed that it is out",
    (NotConfirmed,),
    Topic.INSTRUMENT_OUT,
    (IS_OUT, INSIDE),
)
ABORTED = Branch(
    "the operator ends the case",
    "any checkpoint, any question of a pause",
    (),
    "the arm stops; it leaves along the tool axis, then goes home, when the operator says so",
    (OperatorAborted,),
    ending_unasked=BranchEnding.ABORT,
)

BRANCHES = tuple(row for row in tuple(globals().values()) if isinstance(row, Branch))  # in this order

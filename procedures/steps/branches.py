"""The decision points and failure branches of a case: what may happen, what notices it, and how it ends.

This table is the only one: steps take their questions from it, the page of the state chart shows it, and a
test reaches every row. No branch moves the arm again unasked.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from procedures.engine.checkpoint import GO_ON as CONTINUE
from procedures.engine.checkpoint import LEAVE, WAIT
from procedures.engine.errors import GateFailed, GuardUnmet, NotConfirmed, OperatorAborted
from procedures.engine.hands import INSIDE, IS_OUT
from procedures.engine.operator import NO, YES, Question, Topic
from procedures.guards.errors import BaseShifted, PatientMoved
from procedures.planning.errors import NotReachable, WrongMarkerCount
from procedures.planning.reach.alternatives import BY_ACCURACY
from procedures.registration.errors import NoUniqueMatch
from procedures.relocalization.errors import Saturated, ServoDiverges, ServoExhausted
from procedures.steps.errors import CartMisplaced, CartNotLocked, DepthStopWrong, ToolBesideGauge
from procedures.workcell.errors import SphereNotFound, WrongTool
from ronna_hw.errors import RonnaError
from ronna_hw.wire.room_tasks import DRILL, DURA, INSERT, SKIN

GO_ON, LEAVE_OUT, FOLLOW, HOLD = "go on", "leave it out", "follow", "hold"
FINISHED = "finished"  # all that was to be done through the guide was done before
AGAIN, AS_IT_STANDS = "placed again", "as it stands"


def use(strategy: str) -> str:
    """The answer that agrees to another strategy."""
    return f"use {strategy}"


def from_stage(task: str) -> str:
    """The answer that goes on with that stage of the work through the guide."""
    return f"from {task}"


FEWEST_SPHERES = 4  # that must remain: with three, one that moved cannot be told from the others
SETTINGS = 3  # of a depth stop, before the case is held
PLACINGS = 3  # of the cart, before the case is held
MOUNTINGS = 3  # of a tool that is not the right one, before the case is held


class Ending(StrEnum):
    """How a branch ends."""

    HOLD = "hold"  # the step fails with an error: arm at rest, every result stands
    ASK = "ask"  # the operator decides; what is not agreed to is held
    ABORT = "abort"  # the case ends
    RECORDED = "recorded"  # no motion depends on it: it goes on, and the record says so


@dataclass(frozen=True)
class Branch:
    """One row. `errors` are what it holds with, or holds with when the answer is no."""

    event: str
    detected_by: str
    steps: tuple[str, ...]  # in which it can happen; none for any
    action: str
    ending: Ending
    errors: tuple[type[RonnaError], ...] = ()
    topic: Topic | None = None
    answers: tuple[str, ...] = ()

    def question(
        self,
        subject: str,
        value: str,
        trajectory: str | None = None,
        answers: tuple[str, ...] | None = None,
    ) -> Question:
        """What the operator is asked, with all answers by default. Raises ValueError when nothing is."""
        if self.topic is None:
            raise ValueError(f"nothing is asked when: {self.event}")
        return Question(self.topic, subject, value, answers or self.answers, trajectory)


SPHERE_COUNT = Branch(
    "the CT shows more or fewer spheres than were implanted",
    "count of the spheres found against the plan",
    ("plan_check",),
    f"all candidates are shown; fewer only while {FEWEST_SPHERES} remain",
    Ending.ASK,
    (WrongMarkerCount,),
    Topic.SPHERE_COUNT,
    (GO_ON, HOLD),
)
CT_DISAGREEMENT = Branch(
    "the two estimates of a sphere in the CT differ by more than 0.06 mm",
    "distance of the two centres",
    ("fiducial_localization",),
    "the sphere is flagged and weighs less: its covariance grows by what the estimates differ",
    Ending.RECORDED,
)
SIGHT_LOST = Branch(
    "the tracker loses sight of the reference frame",
    "frames without it, partial, disturbed or stale",
    ("global_localization",),
    "nothing moves; the step is repeated when sight is free",
    Ending.HOLD,
    (GateFailed,),
)
GUARD_UNMET = Branch(
    "what a guard watches is not as it must be: line of sight, reference, age of data",
    "the guards at every checkpoint",
    (),
    "the case is suspended and waits; then the operator waits on or leaves the step",
    Ending.ASK,
    (GuardUnmet,),
    Topic.GUARD,
    (WAIT, LEAVE),
)
HEAD_UNSEEN = Branch(
    "a guide is near a head that the tracker has not seen for 10 s",
    "theatre time since three known spheres were in their places, under way and at the target",
    ("positioning", "at_target"),
    "the arm stops and the case is suspended: it waits for sight, or the operator goes on without it for as "
    "long again, or leaves the step",
    Ending.ASK,
    (GuardUnmet,),
    Topic.HEAD_UNSEEN,
    (WAIT, CONTINUE, LEAVE),
)
AMBIGUOUS = Branch(
    "the spheres of CT and room match in several ways, or in none",
    "log-likelihood over the runner-up below ln 10,000",
    ("correspondence",),
    "both pairings are shown; none is used",
    Ending.HOLD,
    (NoUniqueMatch,),
)
UNMATCHED_SPHERE = Branch(
    "a sphere is missing in the room, on a wrong screw, or far from its place",
    "the CT matches in one way when the count is left aside, with fewer spheres than were implanted",
    ("correspondence",),
    f"it is named; the case goes on with the others while {FEWEST_SPHERES} remain and the operator agrees",
    Ending.ASK,
    (NoUniqueMatch,),
    Topic.UNMATCHED_SPHERE,
    (LEAVE_OUT, HOLD),
)
SPHERE_FAILED = Branch(
    "the stereo head cannot measure a sphere: not in the field, hidden, too dark, no end of the servo",
    "three rings of 5 mm, other exposures, 15 steps of the servo",
    ("relocalization",),
    f"left out while {FEWEST_SPHERES} remain and the operator agrees; the head backs off along its axis",
    Ending.ASK,
    (SphereNotFound, ServoDiverges, ServoExhausted, Saturated),
    Topic.SPHERE,
    (LEAVE_OUT, HOLD),
)
WRONG_SPHERE = Branch(
    "a sphere is not where the tracker saw it",
    "fine against coarse position, 3 mm",
    ("relocalization",),
    "another sphere, or the patient moved: localize with the tracker again",
    Ending.HOLD,
    (GateFailed,),
)
MOVED_SPHERE = Branch(
    "the fit disagrees with its own error budget, and one sphere alone explains it",
    "chi-square gate, then leaving out one at a time",
    ("registration",),
    "the sphere is named; the registration is made without it when the operator agrees",
    Ending.ASK,
    (GateFailed,),
    Topic.MOVED_SPHERE,
    (LEAVE_OUT, HOLD),
)
FIT_DISAGREES = Branch(
    "the fit disagrees with its own error budget, and no one sphere explains it",
    "chi-square gate, then leaving out one at a time",
    ("registration",),
    "localize again",
    Ending.HOLD,
    (GateFailed,),
)
REFERENCE_MOVED = Branch(
    "the patient's reference has moved: head, cart or tracker",
    "known spheres and the frame on the arm, at rest before and after motions; the spheres also while the "
    "guide moves and while it is at its target",
    ("relocalization", "tool_change", "positioning", "at_target", "retreat"),
    "the arm stops; the localization is void: home, the stereo head is mounted again, and the tracker "
    "localizes anew. After a small move under the guide only the registrations are, and may follow it",
    Ending.HOLD,
    (BaseShifted, PatientMoved),
)
CART_MISPLACED = Branch(
    "the cart stands elsewhere than `ronna-plan place` proposed",
    "place.json of the case, against frame on the arm and spheres as the tracker sees them",
    ("cart_lock",),
    f"how far to push it is told; it is placed again, {PLACINGS} times at most, or stays when the operator "
    "says so: the path check judges the real place",
    Ending.ASK,
    (CartMisplaced,),
    Topic.CART_PLACE,
    (AGAIN, AS_IT_STANDS, HOLD),
)
CART_UNLOCKED = Branch(
    "the cart is not locked",
    "nobody confirms it, or the frame on the arm moves against the spheres while somebody leans on the cart; "
    "0.3 mm",
    ("cart_lock",),
    "nothing is localized and nothing moves; it is locked, and leaned on again",
    Ending.HOLD,
    (CartNotLocked,),
)
CART_MOVED = Branch(
    "the cart or the tracker has moved, and what depends on its place is void",
    "the frame on the arm by tracker and arm, as above",
    ("relocalization", "tool_change", "tool_check", "positioning", "at_target", "retreat"),
    "when the operator agrees the arm goes home, the cart is locked again, and the case goes on from the "
    "global localization; CT and plan stand, and what was done at finished targets. When all are finished "
    "the arm goes home and the case ends",
    Ending.ASK,
    (BaseShifted,),
    Topic.CART_MOVED,
    (GO_ON, HOLD),
)
MOVE_FOLLOWED = Branch(
    "with the guide mounted the head has moved by up to 5 mm and 2 degrees, as one body, and lies still",
    "60 frames of the tracker, arm at home, with the frame on the arm where it was",
    ("registration",),
    "the registration follows the measured move when the operator agrees, with its error in the prediction; "
    "else the localization is void",
    Ending.ASK,
    (PatientMoved,),
    Topic.MOVE_FOLLOWED,
    (FOLLOW, HOLD),
)
BEYOND_MARGIN = Branch(
    "the predicted error at a target exceeds the plan's margin",
    "propagation of all errors to the target",
    ("registration",),
    "the trajectory is refused; the others go on without it when the operator agrees",
    Ending.ASK,
    (GateFailed,),
    Topic.MARGIN,
    (LEAVE_OUT, HOLD),
)
UNREACHABLE = Branch(
    "a trajectory cannot be reached by its strategy: out of range, singular, not seen, not clear at any free "
    "angle",
    "every pose and motion, at up to 90 degrees about the axis",
    ("path_check",),
    "a free angle that works is taken and said; else another strategy that serves it, or the others go on "
    "without it, when the operator agrees",
    Ending.ASK,
    (NotReachable,),
    Topic.REACH,
    (*(use(name) for name in BY_ACCURACY), LEAVE_OUT, HOLD),
)
NOT_CLEAR_NOW = Branch(
    "with the fine registration the way to a target is not clear or out of range",
    "the same checks, right before the motion",
    ("positioning",),
    "nothing moves; the trajectory is named",
    Ending.HOLD,
    (NotReachable,),
)
ARM_FAULT = Branch(
    "the arm is in fault: late packets, protective stop, following error, controller",
    "driver and monitor, every cycle",
    (),
    "safe stop; nothing begins before it is acknowledged. A mounted guide is checked at the gauge again "
    "before the next target",
    Ending.HOLD,
)
KEPT_REGISTRATION = Branch(
    "a registration was made before the arm was in fault",
    "faults that were acknowledged",
    ("positioning",),
    "it is kept only when the operator says so",
    Ending.ASK,
    (GateFailed,),
    Topic.REGISTRATION_KEPT,
    (YES, NO),
)
WRONG_TOOL = Branch(
    "another tool than the one that was asked for is mounted after an exchange",
    "the controller's inputs",
    ("tool_change", "global_localization"),
    f"it is mounted again and read again, {MOUNTINGS} times at most; nothing moves",
    Ending.ASK,
    (WrongTool,),
    Topic.TOOL_CHANGE,
    (YES, NO),
)
TOOL_BESIDE_GAUGE = Branch(
    "the mounted guide is not as it was when its tip was calibrated: bent, badly seated, another mandrel, or "
    "the arm sags under another load than it was told",
    "dials of a gauge on the table, 0.05 mm and 0.1 deg beside the tool's record",
    ("tool_check",),
    "it is mounted again and checked again; nothing moves towards the patient",
    Ending.HOLD,
    (ToolBesideGauge,),
)
WRONG_STOP = Branch(
    "the depth stop of the instrument is set wrong",
    "what is read off its scale against what was computed, 0.1 mm",
    ("at_target",),
    f"it is set again and read again, {SETTINGS} times at most; no instrument goes in",
    Ending.ASK,
    (DepthStopWrong,),
    Topic.DEPTH_STOP,
    (YES, NO),
)
WORK_BEGUN = Branch(
    "the guide is led again to where hands have worked through it: after a move, a restart, a repeat",
    "the journal, which says that a stage begins before hands do anything",
    ("at_target",),
    "what was done there is said; the operator says from which stage the work goes on, which may be one that "
    "was done",
    Ending.ASK,
    (NotConfirmed,),
    Topic.WORK_BEGUN,
    (FINISHED, *(from_stage(task) for task in (INSERT, DURA, DRILL, SKIN)), HOLD),
)
GUIDE_PUSHED = Branch(
    "somebody pushes or pulls the guide, or the arm",
    "the frame on the mount, which the tracker sees, and the joints, against how the guide was held; 0.2 mm",
    ("at_target",),
    "it is told at once; the case is suspended until both are let go, or the operator leaves the step",
    Ending.ASK,
    (GuardUnmet,),
    Topic.GUARD,
    (WAIT, LEAVE),
)
INSTRUMENT_INSIDE = Branch(
    "the arm is to move while an instrument is in the guide, or may be: also after a restart",
    "the journal, which says that it goes in before it does",
    ("tool_check", "at_target", "retreat"),
    "nothing moves before the operator has said that it is out",
    Ending.ASK,
    (NotConfirmed,),
    Topic.INSTRUMENT_OUT,
    (IS_OUT, INSIDE),
)
ABORTED = Branch(
    "the operator ends the case",
    "any checkpoint, any question of a rest",
    (),
    "the arm stops; the way out is along the tool axis, then home, when the operator says so",
    Ending.ABORT,
    (OperatorAborted,),
)

BRANCHES = (
    *(
        SPHERE_COUNT,
        CT_DISAGREEMENT,
        SIGHT_LOST,
        GUARD_UNMET,
        HEAD_UNSEEN,
        AMBIGUOUS,
        UNMATCHED_SPHERE,
        SPHERE_FAILED,
        WRONG_SPHERE,
    ),
    *(
        CART_MISPLACED,
        CART_UNLOCKED,
        REFERENCE_MOVED,
        CART_MOVED,
        MOVE_FOLLOWED,
        MOVED_SPHERE,
        FIT_DISAGREES,
        BEYOND_MARGIN,
        UNREACHABLE,
        NOT_CLEAR_NOW,
        ARM_FAULT,
    ),
    *(KEPT_REGISTRATION, WRONG_TOOL, TOOL_BESIDE_GAUGE, WRONG_STOP, WORK_BEGUN),
    *(GUIDE_PUSHED, INSTRUMENT_INSIDE, ABORTED),
)

"""Placing and locking of the arm's cart, verified by the tracker.

The frame on the arm moves with the cart, the spheres move with the head. After somebody leans on the cart,
neither may have moved against the other.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.guards.errors import PatientMoved
from procedures.guards.room_reading import RoomReading, room_reading
from procedures.journal.errors import GateFailed
from procedures.journal.results import StepResult, Values
from procedures.operator.question import YES, Question, Task, Topic
from procedures.planning.errors import PLACE_UNFIT
from procedures.planning.proposed_place import PlaceFile, ProposalDeviation, ProposedPlace, read_place
from procedures.planning.short_numbers import DIGITS
from procedures.registration.movement import measure_shift
from procedures.steps.branches import AS_IT_STANDS, CART_MISPLACED, HOLD, PLACINGS
from procedures.steps.clinical.coarse_match import coarse_match, room_prior
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.head_clamp import ClampedHead
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.conditions import needs_arm_home
from procedures.steps.errors import CART_NOT_LOCKED, CART_OUT_OF_PLACE
from procedures.workcell.tracker_look import average_pose, read_frames_at_rest, robot_from_marker
from ronna_hw.arrays import Array
from ronna_hw.calibration import Numbers3
from ronna_hw.frames import Frame, Transform
from ronna_hw.wire.room_tasks import CART_LOCK, CART_PLACE, CART_PUSH

# Of the frame on the arm against the spheres, between two looks from one pose. The noise is 0.1 mm; a free
# wheel gives way by centimetres.
# Safety against a cart that is not locked (U).
LOCKED_LIMIT_MM = 0.3

HEAD_LEVEL_MM, HEAD_LEVEL_DEG = 5.0, 2.0  # beyond, the map was made for another position of the head


class Proposal(Values):
    """Proposed position of the cart."""

    sha256: str = Field(description="Hash of the file that proposed it.")
    place: ProposedPlace = Field(description="The part of it that was compared.")


class LockedCart(StepResult, kind="cart_lock", version=2):
    """The locked cart: its position, and how far it moved when somebody leaned on it."""

    placings: int = Field(description="How many times it was placed.")
    moved_mm: Numbers3 = Field(
        description="Motion of the frame on the arm against the head while leaned on, robot frame."
    )
    spheres: int = Field(description="Spheres on the head seen in both readings.")
    beside_mm: tuple[float, float] | None = Field(
        description="Offset of the cart from its proposed position, x and y; none without a proposal or a "
        "unique match to compare it by."
    )
    turned_deg: float | None = Field(description="Its rotation from the proposal.")
    proposal: Proposal | None = Field(description="None if nothing was proposed.")

    def differences(self, path: Path) -> str:
        """Describe how a file's proposal differs from the recorded one; empty if equal. Raises PLAN-022."""
        found = read_place(path)
        if self.proposal is None or (found is not None and found.place == self.proposal.place):
            return ""
        now = "no position" if found is None else f"another position, SHA-256 {found.sha256[:DIGITS]}"
        return f"{now} instead of {self.proposal.sha256[:DIGITS]}"


def run(context: StepContext) -> Outcome[LockedCart]:
    """Guide the cart's placing and locking. Raises PRO-007, PRO-020, PRO-041, PRO-042, PLAN-022."""
    for before in context.reads:
        context.result(before)
    context.workcell.rest()  # hands are on the cart: nothing may move the arm meanwhile
    several = len(context.workcell.arms) > 1
    carts, are = ("the carts of master and assistant", "are") if several else ("the arm's cart", "is")
    proposed = _read_proposal(context)
    proposal = None if proposed is None else proposed.place
    for placing in range(1, PLACINGS + 1):
        context.perform_task(Task(CART_PLACE, f"wheel {carts} into position"))
        context.perform_task(Task(CART_LOCK, f"lock the brakes of {carts}"))
        brakes = "the brakes of all wheels are set and nobody is pushing"
        _confirm(context, f"{are} {carts} locked", brakes, f"{carts} {are} locked")
        robot_from_tracker, first = _take_first_look(context)
        drift = (
            None if proposal is None else _offset_from_proposal(context, proposal, robot_from_tracker, first)
        )
        if proposal is None or drift is None or _accept_position(context, proposal, drift, placing):
            break
    context.perform_task(Task(CART_PUSH, f"lean on {carts} from each side, then stand clear"))
    leaned = f"someone leaned on {carts}"
    _confirm(context, f"has {leaned}", "from each side, and everyone stands clear", leaned)
    frames, _ = read_frames_at_rest(context.workcell)
    second = room_reading(context.workcell, frames, robot_from_tracker)
    try:
        moved_mm, spheres = displacement_against_head(robot_from_tracker, first, second)
    except PatientMoved as moved:
        context.void(ClampedHead, moved)
        raise
    if proposed is not None:
        context.note_inputs(context.clinical.place)
    whose = "the master's" if several else "it"
    return Outcome(
        LockedCart(
            placings=placing,
            moved_mm=tuple(moved_mm.tolist()),
            spheres=spheres,
            beside_mm=None if drift is None else (drift.x_mm, drift.y_mm),
            turned_deg=None if drift is None else drift.turned_deg,
            proposal=None if proposed is None else Proposal(sha256=proposed.sha256, place=proposed.place),
        ),
        summary=(
            f"{carts} {are} locked; {whose} moved {np.linalg.norm(moved_mm):.2f} mm against the head "
            "when leaned on"
        )
        + (", the assistant's was not measured" if several else "")
        + ("" if drift is None else f"; {_format_offset(drift)} from its proposed position"),
    )


def _read_proposal(context: StepContext) -> PlaceFile | None:
    path = context.clinical.place
    proposed = read_place(path)
    series = context.result(CheckedPlan).plan.series_instance_uid
    if proposed is not None and proposed.place.series_instance_uid != series:
        raise PLACE_UNFIT(
            f"{path.name} was made for another CT", expected=series, got=proposed.place.series_instance_uid
        )
    return proposed


def _take_first_look(context: StepContext) -> tuple[Transform, RoomReading]:
    workcell = context.workcell
    frames, _ = read_frames_at_rest(workcell, lambda share: context.progress(share, "locating the cart"))
    seen = average_pose(frames, workcell.calibrations.tracker_frame.tool)
    robot_from_tracker = robot_from_marker(workcell, workcell.master.joints_rad()) @ seen.inverse()
    return robot_from_tracker, room_reading(workcell, frames, robot_from_tracker)


def _offset_from_proposal(
    context: StepContext, proposal: ProposedPlace, robot_from_tracker: Transform, look: RoomReading
) -> ProposalDeviation | None:
    """Return the cart's deviation from the proposal, or record a finding and return None without a match."""
    localized, plan = context.result(LocalizedFiducials), context.result(CheckedPlan)
    prior = room_prior(plan, context.setting.settings, robot_from_tracker)
    found = coarse_match(
        plan, localized, robot_from_tracker.apply(look.spheres_mm), prior, context.clinical.methods
    )
    if found.transform is None:
        context.find(f"the cart cannot be compared with its proposed position: {found.reason}")
        return None
    drift = proposal.drift(Transform(Frame.ROBOT, Frame.CT, found.transform))
    if abs(drift.head_mm) > HEAD_LEVEL_MM or drift.head_deg > HEAD_LEVEL_DEG:
        context.find(
            f"the head is {drift.head_mm:+.0f} mm higher and tilted by {drift.head_deg:.0f} deg "
            "against the map of cart positions: the path check judges this position"
        )
    return drift


def _accept_position(
    context: StepContext, proposal: ProposedPlace, drift: ProposalDeviation, placing: int
) -> bool:
    """Return whether the cart may stay where it is or must be placed again. Raises PRO-042."""
    if proposal.allows(drift):
        return True
    problem = CART_OUT_OF_PLACE(
        f"the cart is {_format_offset(drift)} from its proposed position",
        limit=f"{proposal.free_mm:.0f} mm, or half of that turned by -{proposal.turns_deg[0]:g} to "
        f"+{proposal.turns_deg[1]:g} deg",
        action=f"Push it by x {round(-drift.x_mm):+d} mm and y {round(-drift.y_mm):+d} mm and turn it by "
        f"{_to_tenths(-drift.turned_deg)} deg, then repeat the step; or make a new map: ronna-plan place.",
    )
    context.find(problem.summary)
    answer = context.choose(CART_MISPLACED.question(problem.summary, problem.advice))
    if answer == HOLD or (answer != AS_IT_STANDS and placing == PLACINGS):
        raise problem
    return answer == AS_IT_STANDS


def _confirm(context: StepContext, asked: str, value: str, statement: str) -> None:
    """Ask for confirmation before the tracker measures, so that nobody is rushed. Raises PRO-041."""
    if context.choose(Question(Topic.CART_LOCKED, f"{asked[0].upper()}{asked[1:]}?", value)) != YES:
        raise CART_NOT_LOCKED(f"the cart is not locked: nobody confirmed that {statement}")


def displacement_against_head(
    robot_from_tracker: Transform, first: RoomReading, second: RoomReading
) -> tuple[Array, int]:
    """Return the arm frame's displacement (3,) mm relative to the head and the number of spheres used.

    Raises PRO-041, or PRO-020 if it was the head that moved.
    """
    head = measure_shift(first.head_mm, second.head_mm)
    if head is None or first.frame_mm is None or second.frame_mm is None:
        raise GateFailed(
            "the tracker does not see the frame and the head both before and after the cart was leaned on",
            expected="the frame on the arm, and three spheres or the frame on the clamp",
            action="Clear the line of sight, then repeat the step.",
        )
    head_mm = robot_from_tracker.rotation_matrix @ head.mean_mm
    frame_mm = second.frame_mm - first.frame_mm
    against_mm = np.asarray(frame_mm - head_mm)
    moved_mm = float(np.linalg.norm(against_mm))
    if moved_mm < LOCKED_LIMIT_MM:
        return against_mm, head.points
    limit, got = f"{LOCKED_LIMIT_MM:g} mm", f"{moved_mm:.2f} mm"
    if np.linalg.norm(head_mm) > np.linalg.norm(frame_mm):
        raise PatientMoved(
            "the head moved while the cart was leaned on: it is not clamped", limit=limit, got=got
        )
    raise CART_NOT_LOCKED("the cart is not locked: it rolled when leaned on", limit=limit, got=got)


def _format_offset(drift: ProposalDeviation) -> str:
    way = f"x {round(drift.x_mm):+d}, y {round(drift.y_mm):+d}"
    return f"{drift.off_mm:.0f} mm ({way}), {_to_tenths(drift.turned_deg)} deg"


def _to_tenths(value: float) -> str:
    return f"{round(value, 1) + 0.0:+.1f}"  # without a sign before nothing


STEP = StepSpec(
    LockedCart,
    "Place and lock the cart",
    Phase.PREPARATION,
    run,
    asks=(Topic.CART_LOCKED,),
    reads=(CheckedSetUp, ClampedHead, LocalizedFiducials, CheckedPlan),
    preconditions=needs_arm_home,
)

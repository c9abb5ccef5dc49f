"""Looks at all isolated spheres from the most informative poses, for the arm calibration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from pydantic import Field

from procedures.calibration.arm_check import require_record
from procedures.calibration.arm_model import ArmLooks, ArmModel, Flanks, SphereLook, arrays_of, choose_poses
from procedures.calibration.errors import NO_BALL, POSES_OUT_OF_REACH
from procedures.calibration.pose_set import PlannedLook, order_by_orientation, plan_centred_looks
from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, StepSpec
from procedures.journal.results import StepResult
from procedures.operator.question import Topic
from procedures.relocalization.errors import SphereNotInView
from procedures.steps.calibration import ball_place
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.workcell import Workcell
from procedures.workcell.ball_watcher import BallWatcher
from procedures.workcell.stereo_look import pair_picture
from ronna_hw.arrays import Array
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame
from ronna_hw.text import format_count
from ronna_hw.vectors import JointVector

MOST_SPHERES = 6  # more add travel and little information
CANDIDATES = 60  # planned looks of each sphere, of which the most telling are taken
CHOICE = 1.5  # planned looks for each wanted one if there are few spheres
SPARE = 1.15  # planned looks for each wanted one: some show a sphere half hidden
GOLDEN = 0.6180339887498949  # its multiples spread evenly over the 64 patterns
NOT_KNOWN = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))  # before a look, its covariance


class ObservedSpheres(StepResult, kind="sphere_looks"):
    """Looks at the spheres used to calibrate or check the arm."""

    observed: ArmLooks = Field(description="Contents of `looks.json`.")
    remarks: tuple[str, ...] = Field(description="Warnings for the operator.")


@dataclass(frozen=True)
class _PlannedSphereLook:
    """A reachable planned look; `look` is the expected measurement."""

    pose: PlannedLook
    look: SphereLook


def _measure_spheres(context: StepContext, count: int, validation: int) -> Outcome[ObservedSpheres]:
    """Measure the spheres. Raises CAL-009, CAL-010 for too few poses, CAL-014 for a check, PRO-002."""
    set_up = context.result(CheckedSetUp)
    workcell = context.workcell
    if count == 0:
        require_record(workcell.calibrations.arm)
    remarks: list[str] = []
    places = _select_places(context.result(GlobalLocalization).points_mm, workcell, remarks)
    head = workcell.calibrations.stereo_head
    model = ArmModel(
        workcell.master.arm.kinematics, head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    )
    plan = _plan_looks(model, places, workcell, count, validation)
    planned = {one.look.sphere for one in plan}
    remarks += [
        f"{_describe_place(place)} was left out: none of the planned poses is around it"
        for number, place in enumerate(places)
        if number not in planned
    ]
    context.confirm(
        Topic.CALIBRATION,
        f"The arm will measure {format_count(len(planned), 'sphere')} "
        f"from {format_count(len(plan), 'pose')}. Nobody and nothing else may be within its reach",
        format_count(len(plan), "measurement"),
    )
    seen: list[SphereLook] = []
    for number in sorted(planned):
        own_looks = [one for one in plan if one.look.sphere == number]
        seen += _look_at_sphere(
            context, places[number], own_looks, len(seen) / len(plan), remarks, count + validation
        )
    remarks += ball_place.return_home_if_clear(context)
    observed = ArmLooks(
        created=context.setting.began,
        arm=workcell.master.arm.kinematics.name,
        arm_serial=set_up.identities["arm"].serial,
        serials=workcell.stereo.serials,
        stereo_head=head,
        tool_tip=workcell.calibrations.tool_tip,
        arm_record=workcell.calibrations.arm,
        looks=tuple(seen),
    )
    return Outcome(
        ObservedSpheres(observed=observed, remarks=tuple(remarks)), format_count(len(seen), "measurement")
    )


def _plan_looks(
    model: ArmModel, places: Sequence[ball_place.BallPlace], workcell: Workcell, count: int, validation: int
) -> tuple[_PlannedSphereLook, ...]:
    """Choose the most informative looks for the fit and evenly spread looks for validation."""
    informative_count, validation_count = round(SPARE * count), math.ceil(SPARE * validation)
    wanted = informative_count + validation_count
    each = max(CANDIDATES, math.ceil(CHOICE * wanted / len(places)))
    reached = [
        _PlannedSphereLook(look, _expect_look(number, joints, order))
        for number, place in enumerate(places)
        for order, look in enumerate(plan_centred_looks(place.reference, place.ball_mm, each))
        if (joints := ball_place.reachable_joints(workcell, look)) is not None
    ]
    if len(reached) < wanted:
        raise POSES_OUT_OF_REACH(
            "too few poses around the spheres are reachable",
            expected=f"{wanted} poses",
            got=f"{len(reached)} of {each * len(places)}",
        )
    informative_numbers = choose_poses(model, arrays_of([one.look for one in reached]), informative_count)
    rest = sorted(set(range(len(reached))) - set(informative_numbers.tolist()))
    validation_numbers = [rest[round(at)] for at in np.linspace(0, len(rest) - 1, validation_count)]
    validation_looks = [
        _PlannedSphereLook(one.pose, one.look.model_copy(update={"validation": True}))
        for one in (reached[number] for number in validation_numbers)
    ]
    return (*(reached[number] for number in informative_numbers), *validation_looks)


def _look_at_sphere(
    context: StepContext,
    place: ball_place.BallPlace,
    plan: Sequence[_PlannedSphereLook],
    done: float,
    remarks: list[str],
    total: int,
) -> list[SphereLook]:
    workcell = context.workcell
    watcher = BallWatcher(workcell, np.array(place.ball_mm))
    ball_place.start_around_ball(context, watcher.ball_mm, place.others_mm)
    try:
        context.keep_picture(ball_place.BALL_PICTURE, pair_picture(watcher.find(place.first_look)))
    except (LimitError, SphereNotInView) as error:
        if workcell.master.arm.observe().state is not Lifecycle.ACTIVE:
            raise  # tripped, not refused before it began
        remarks.append(f"{_describe_place(place)} was left out: {error.what}")
        return []
    seen: list[SphereLook] = []
    by_pose = {id(one.pose): one.look for one in plan}
    for step, pose in enumerate(order_by_orientation([one.pose for one in plan])):
        planned = by_pose[id(pose)]
        look = watcher.take(pose, planned.flanks)
        if look is not None and look.point is not None:
            seen.append(
                planned.model_copy(
                    update={
                        "joints_rad": workcell.master.joints_rad(),
                        "point_mm": tuple(look.point.position_mm.tolist()),
                        "covariance_mm2": tuple(map(tuple, look.point.covariance_mm2.tolist())),
                    }
                )
            )
        context.progress(min(1.0, done + (step + 1) / total), "measuring spheres")
    if watcher.rejected:
        remarks.append(
            f"{watcher.rejected.total()} measurements of {_describe_place(place)} failed: "
            f"{watcher.why_rejected()}"
        )
    return seen


def looks_step(count: int, validation: int) -> StepSpec[ObservedSpheres]:
    """Build the step, with `count` looks for the fit and `validation` looks to validate it."""
    run = partial(_measure_spheres, count=count, validation=validation)
    return ball_place.measuring_step(ObservedSpheres, "Measure the spheres", run, GlobalLocalization)


def flanks_of(number: int, axes: int) -> Flanks:
    """Return each joint's approach side for look `number`; all side patterns occur equally often."""
    pattern = int(GOLDEN * number % 1.0 * 2**axes)
    return tuple(1 if pattern >> axis & 1 else -1 for axis in range(axes))


def _select_places(
    points_mm: Array, workcell: Workcell, remarks: list[str]
) -> tuple[ball_place.BallPlace, ...]:
    """Return the isolated spheres within reach, the nearest to the head first. Raises CAL-009."""
    isolated_spheres = ball_place.find_isolated(points_mm)
    if not isolated_spheres:
        raise NO_BALL("the tracker sees no isolated sphere", got=format_count(len(points_mm), "stray sphere"))
    head_mm = workcell.master.tool_pose().translation_mm
    near = sorted(isolated_spheres, key=lambda number: float(np.linalg.norm(points_mm[number] - head_mm)))
    places = [ball_place.BallPlace.among(points_mm, number) for number in near]
    reached = [
        place for place in places if ball_place.reachable_joints(workcell, place.first_look) is not None
    ]
    remarks += [
        f"{_describe_place(one)} was left out: it is out of reach" for one in places if one not in reached
    ]
    if not reached:
        raise NO_BALL("no isolated sphere is within reach", got=", ".join(map(_describe_place, places)))
    return tuple(reached[:MOST_SPHERES])


def _describe_place(place: ball_place.BallPlace) -> str:
    x, y, z = place.ball_mm
    return f"the sphere at {x:.0f} {y:.0f} {z:.0f} mm"


def _expect_look(sphere: int, joints_rad: JointVector, order: int) -> SphereLook:
    return SphereLook(
        sphere=sphere,
        joints_rad=joints_rad,
        flanks=flanks_of(order, len(joints_rad)),
        point_mm=(0.0, 0.0, 0.0),
        covariance_mm2=NOT_KNOWN,
        validation=False,
    )

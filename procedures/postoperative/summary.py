"""The result of a postoperative check, as stored, printed for scripts, and shown in a report."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from procedures.imaging.volume import Volume
from procedures.planning.plan_model import Plan
from procedures.postoperative.assignment import FoundKind
from procedures.postoperative.comparison import Proof
from ronna_hw.calibration import Numbers3, Numbers4, Strict
from ronna_hw.text.beyond import beyond


class FoundTrajectory(Strict):
    """One trajectory as planned and as carried out; points in LPS mm of the planned CT."""

    id: str = Field(description="Its name in the plan.")
    kind: FoundKind = Field(description="An instrument, with a tip, or a drilled hole, without.")
    planned_entry_mm: Numbers3 = Field(description="Planned point.")
    planned_target_mm: Numbers3 = Field(description="Planned point.")
    entry_mm: Numbers3 = Field(description="Point of the found axis at the planned entry.")
    axis_at_target_mm: Numbers3 = Field(description="The tip, or the point of a hole's axis at the target.")
    tip_mm: Numbers3 | None = Field(description="Tip of the instrument.")
    entry_error_mm: float = Field(
        description="From the planned entry to the axis, across the planned trajectory."
    )
    target_error_mm: float | None = Field(description="From the planned target to the tip.")
    lateral_mm: float = Field(description="At the target, across the planned trajectory.")
    depth_error_mm: float | None = Field(description="Along the planned trajectory; positive is too deep.")
    angle_deg: float = Field(description="Between the planned and the found axis.")
    doubts: tuple[str, ...] = Field(default=(), description="Reasons, from its fit, why it may be wrong.")


class PostoperativeCheck(Strict):
    """A postoperative CT compared with the plan."""

    schema_version: Literal[1] = Field(default=1, alias="schema", description="Version of this format.")
    pre_series_instance_uid: str = Field(description="The planning CT.")
    post_series_instance_uid: str = Field(description="The postoperative CT.")
    post_from_pre: tuple[Numbers4, Numbers4, Numbers4, Numbers4] = Field(
        description="Pose of the head, second CT <- first, mm."
    )
    bone_agreement: float = Field(description="Correlation of both CTs at bone; 1 for equal skulls.")
    bone_overlap: float = Field(description="Share of the first CT's bone that the second shows.")
    trajectories: tuple[FoundTrajectory, ...] = Field(description="In the order of the plan.")
    warnings: tuple[str, ...] = Field(
        default=(), description="Errors that the plan does not accept, and what limits the accuracy."
    )


def _doubts(proof: Proof) -> tuple[str, ...]:
    return tuple(
        f"{one.identifier} is doubtful: {doubt}" for one in proof.trajectories for doubt in one.doubts
    )


def _beyond_margin(proof: Proof, plan: Plan) -> tuple[str, ...]:
    said = []
    for one in proof.trajectories:
        margin_mm = plan.trajectory(one.identifier).margin_mm
        error_mm = one.lateral_mm if one.target_error_mm is None else one.target_error_mm
        if error_mm > margin_mm:
            off_mm = beyond(error_mm, margin_mm, 2)
            said.append(f"{one.identifier} is {off_mm} mm off its target: the plan accepts {margin_mm:g} mm")
    return tuple(said)


def summary_of(
    proof: Proof, plan: Plan, pre: Volume, post: Volume, warnings: tuple[str, ...] = ()
) -> PostoperativeCheck:
    """The comparison as plain values."""
    rows = [tuple(row) for row in proof.registration.post_from_pre.as_matrix().tolist()]
    first, second, third, last = ((a, b, c, d) for a, b, c, d in rows)
    found = []
    for one in proof.trajectories:
        planned = plan.trajectory(one.identifier)
        found.append(
            FoundTrajectory(
                id=one.identifier,
                kind=one.kind,
                planned_entry_mm=planned.entry_mm,
                planned_target_mm=planned.target_mm,
                entry_mm=one.entry_mm,
                axis_at_target_mm=one.axis_at_target_mm,
                tip_mm=one.tip_mm,
                entry_error_mm=one.entry_error_mm,
                target_error_mm=one.target_error_mm,
                lateral_mm=one.lateral_mm,
                depth_error_mm=one.depth_error_mm,
                angle_deg=one.angle_deg,
                doubts=one.doubts,
            )
        )
    return PostoperativeCheck(
        pre_series_instance_uid=pre.series_instance_uid,
        post_series_instance_uid=post.series_instance_uid,
        post_from_pre=(first, second, third, last),
        bone_agreement=proof.registration.agreement,
        bone_overlap=proof.registration.overlap,
        trajectories=tuple(found),
        warnings=(*_beyond_margin(proof, plan), *pre.warnings, *post.warnings, *warnings, *_doubts(proof)),
    )

"""Frames, spheres and plan of a case, from its results and its workcell. Asks no device."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from procedures.journal.results import StepResult
from procedures.live.feed_socket import Subject
from procedures.live.records import Fiducial, Fiducials, FramePose, LiveRecord, PlannedLine, PlannedLines
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import RegisteredRobot, Relocalization
from ronna_hw.devices.readings import Validity
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Frame, Transform
from ronna_hw.roles import MASTER
from ronna_hw.vectors import vector3

if TYPE_CHECKING:
    from procedures.engine.case import Stored
    from procedures.engine.engine import Engine

R = TypeVar("R", bound=StepResult)


def frame_pose(parent: str, child: str, pose: Transform, at_s: float, *, is_fixed: bool = False) -> FramePose:
    """Return a pose, parent <- child, as a record."""
    w, x, y, z = pose.quaternion_wxyz.tolist()
    return FramePose(
        theatre_time_s=at_s,
        parent=parent,
        child=child,
        rotation=(w, x, y, z),
        translation_mm=vector3(pose.translation_mm),
        is_fixed=is_fixed,
    )


def base_frame(role: str) -> str:
    """Return the frame of an arm's base; that of the master is the robot's."""
    return Frame.ROBOT if role == MASTER else role


def flange_frame(role: str) -> str:
    """Return the frame of an arm's flange."""
    return Frame.FLANGE if role == MASTER else f"{role}_{Frame.FLANGE}"


class CaseFrames:
    """Frames that stand until something changes, spheres and plan; returns each only when it has changed."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._workcell = engine.setting.workcell
        self._known: dict[Subject, LiveRecord] = {}
        self._target: str | None = None
        self._fiducials: tuple[tuple[str, str | None], Fiducials] | None = None  # of these two records

    def changes(self, now_s: float) -> list[LiveRecord]:
        """Return what has changed since the last call; a frame that is no longer known has no pose."""
        current: dict[Subject, LiveRecord] = {(one.kind, one.about): one for one in self._current(now_s)}
        for subject, former in self._known.items():
            if subject not in current and isinstance(former, FramePose):
                gone = {"rotation": None, "translation_mm": None, "validity": Validity.MISSING}
                current[subject] = former.model_copy(update={**gone, "theatre_time_s": now_s})
        changed = [one for key, one in current.items() if _content(one) != _content(self._known.get(key))]
        self._known = current
        return changed

    def _current(self, now_s: float) -> Iterator[LiveRecord]:
        with suppress(RonnaError):  # the mounted tool is not known
            tool = self._workcell.master.flange_from_tool
            yield frame_pose(Frame.FLANGE, Frame.TOOL, tool, now_s, is_fixed=True)
        placed = self._workcell.motion.placed
        for role in self._workcell.arms:
            if role != MASTER and placed.is_placed(role):
                base = placed.base(role).to_transform()
                yield frame_pose(Frame.ROBOT, base_frame(role), base, now_s, is_fixed=True)
        localized = self._find(GlobalLocalization)
        if localized is not None:
            move = self._workcell.tracker_move(localized.record.identifier).move
            tracker = localized.result.robot_from_tracker.transform @ move.inverse()
            yield frame_pose(Frame.ROBOT, Frame.TRACKER, tracker, now_s, is_fixed=True)
        registered = self._find(RegisteredRobot)
        if registered is not None:
            robot_from_ct = registered.result.robot_from_ct_at(self._find_target())
            yield frame_pose(Frame.CT, Frame.ROBOT, robot_from_ct.inverse(), now_s, is_fixed=True)
        if (spheres := self._find(LocalizedFiducials)) is not None:
            by = (spheres.record.identifier, None if registered is None else registered.record.identifier)
            if self._fiducials is None or self._fiducials[0] != by:
                self._fiducials = by, self._judge_fiducials(spheres.result, registered, now_s)
            yield self._fiducials[1]
        if (checked := self._find(CheckedPlan)) is not None:
            lines = (
                PlannedLine(name=one.id, entry_mm=one.entry_mm, target_mm=one.target_mm)
                for one in checked.result.plan.trajectories
            )
            yield PlannedLines(theatre_time_s=now_s, lines=tuple(lines))

    def _find_target(self) -> str | None:
        """Return the target where the arm is or was last, in whose correction the frames are; None before.

        A learned arm errs by millimetres: only by the correction of a target do its joints agree with the
        head there.
        """
        running = self._engine.running
        at = self._workcell.master.place.trajectory or (running and running.trajectory)
        self._target = at or self._target
        return self._target

    def _find(self, model: type[R]) -> Stored[R] | None:
        """Return the latest valid result of a step."""
        found = [one for one in self._engine.case.valid_results if isinstance(one.result, model)]
        return found[-1] if found else None  # type: ignore[return-value]  # checked just above

    def _judge_fiducials(
        self, spheres: LocalizedFiducials, registered: Stored[RegisteredRobot] | None, now_s: float
    ) -> Fiducials:
        residual_mm, left_out = dict[int, float](), set[int]()
        if registered is not None:
            left_out = {one.fiducial for one in registered.result.left_out_spheres}
            for stored in self._engine.case.valid_results:
                measured = stored.result
                of_it = stored.record.identifier in registered.record.parents
                if of_it and isinstance(measured, Relocalization):
                    for index, found_mm in registered.result.found_in_ct_mm(measured).items():
                        residual_mm[index] = float(np.linalg.norm(found_mm - spheres.centres_mm[index]))
        return Fiducials(
            theatre_time_s=now_s,
            spheres=tuple(
                Fiducial(
                    name=f"M{number}",
                    position_mm=vector3(marker.centre_mm),
                    diameter_mm=spheres.diameter_mm,
                    residual_mm=residual_mm.get(number - 1),
                    is_used=None
                    if registered is None
                    else number - 1 in residual_mm and number - 1 not in left_out,
                )
                for number, marker in spheres.numbered.items()
            ),
        )


def _content(record: LiveRecord | None) -> object:
    return None if record is None else record.model_copy(update={"theatre_time_s": 0.0})

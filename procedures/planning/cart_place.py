"""Assessment of whether the whole procedure can be executed from a cart position."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.planning.free_angle import choose_free_angles
from procedures.planning.line_of_sight import StereoSight
from procedures.planning.motions import check_fixed_places
from procedures.planning.paths import check_branch
from procedures.planning.scene import PlanningScene
from procedures.planning.tracker_sight import TrackerSight, explain_hidden_frame
from procedures.planning.visits import (
    ArmSetting,
    Axes,
    PathCheck,
    Visit,
    build_target_visit,
    list_localizations,
)
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.kinematics import Branch
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.sensors import VolumeSections
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame, Transform

HIDDEN = "the arm at home hides {} from the tracker"


@dataclass(frozen=True)
class CartMove:
    """Offset of the cart from its assumed position: shift x, y in the assumed $ROBROOT, then rotation."""

    x_mm: float
    y_mm: float
    turn_rad: float = 0.0

    def to_cart_frame(self, in_robot: RigidTransform) -> RigidTransform:
        """Transform a pose from the assumed $ROBROOT to that of the moved cart."""
        moved = RigidTransform.from_components(
            [self.x_mm, self.y_mm, 0.0], Rotation.from_rotvec([0.0, 0.0, self.turn_rad])
        )
        return moved.inv() * in_robot


@dataclass(frozen=True)
class PlaceSolution:
    """Solution at a cart position: the arm branch, and each trajectory's turn about its axis."""

    branch: Branch
    turns_rad: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class PlaceVerdict:
    """Verdict on a cart position: the solution, or the first pose that fails, with the reason."""

    found: PlaceSolution | None
    pose: str = ""
    reason: str = ""

    @property
    def serves(self) -> bool:
        """Whether the whole procedure can be executed from the position."""
        return self.found is not None


@dataclass(frozen=True, eq=False)
class CartCase:
    """Arm at the assumed cart position, with scene and task.

    Fiducials (n, 3) are in CT mm; `robot_from_tracker` is the tracker's pose, None if it does not matter, and
    `stereo_from_marker` that of the frame on the arm, and `volume_mm` where the tracker measures.
    Bodies that the cell describes in the robot frame are assumed to move with the cart.
    """

    setting: ArmSetting
    trajectories: tuple[Trajectory, ...]
    fiducials_mm: tuple[tuple[float, float, float], ...]
    sight: StereoSight
    robot_from_tracker: Transform | None = None
    stereo_from_marker: Transform | None = None
    volume_mm: VolumeSections = ()

    def judge(
        self, move: CartMove, known: Sequence[PlaceSolution] = (), *, search: bool = True
    ) -> PlaceVerdict:
        """Judge a position. Known solutions are tried first, then all others if `search` is set."""
        setting = self.setting_at(move)
        hidden = self._find_hidden(setting, move)
        if hidden:
            return PlaceVerdict(None, "home", hidden)
        for unmet in check_fixed_places(setting):
            return PlaceVerdict(None, str(unmet.pose), unmet.reason)
        for found in known:
            if self._serves(setting, found):
                return PlaceVerdict(found)
        if not search:
            return PlaceVerdict(None, "", "reachable nearby, but not from here")
        unreached_axis = self._find_unreachable(setting)
        if unreached_axis is not None:
            return unreached_axis
        turned = choose_free_angles(setting, self.trajectories, self.fiducials_mm, self.sight)
        return _to_verdict(turned.check, dict(turned.turns_rad))

    def setting_at(self, move: CartMove) -> ArmSetting:
        """Return the arm setting that results from moving the cart."""
        pose = move.to_cart_frame(self.setting.robot_from_ct.rigid)
        return replace(self.setting, robot_from_ct=Transform(Frame.ROBOT, Frame.CT, pose))

    def _serves(self, setting: ArmSetting, found: PlaceSolution) -> bool:
        axes = Axes.of(setting, self.trajectories, self.fiducials_mm).turned(dict(found.turns_rad))
        spheres = setting.robot_from_ct.apply(np.array(self.fiducials_mm))
        visits: list[Visit] = []
        try:
            for axis in axes.localized:
                visits += list_localizations(setting, axis, self.fiducials_mm, found.branch)
        except LimitError:
            return False
        if self.sight.unmet(visits, spheres):
            return False
        return check_branch(setting, axes, self.fiducials_mm, found.branch, first_only=True).passed

    def _find_unreachable(self, setting: ArmSetting) -> PlaceVerdict | None:
        """Find the first axis with a pose unreachable at every turn, as a cheap check before the search."""
        start_branch = setting.kinematics.branch_of(setting.start_rad)
        arm = setting.in_branch(start_branch)
        axes = Axes.of(setting, self.trajectories, self.fiducials_mm)
        for axis in axes.distinct:
            last_error: LimitError | None = None
            try:
                turns = setting.strategy.turns_rad(axis, self.fiducials_mm, setting.robot_from_ct, arm)
            except LimitError:
                return None  # left to the search
            for turn in turns:
                turned = axes.only(axis.identifier).turned({axis.identifier: turn})
                try:
                    self._require_solutions(setting, turned)
                    break
                except LimitError as error:
                    last_error = error
            else:
                if last_error is not None:
                    reason = f"{last_error.summary} [{last_error.code}]"
                    return PlaceVerdict(None, axis.identifier, reason)
        return None

    def _require_solutions(self, setting: ArmSetting, axis: Axes) -> None:
        """Raise ARM-001 to ARM-003 for a pose or an approach that no branch reaches."""
        visits: list[Visit] = [build_target_visit(setting, one) for one in axis.targeted]
        if setting.strategy.localizes_per_trajectory and not _depends_on_branch(setting):
            start_branch = setting.kinematics.branch_of(setting.start_rad)
            for one in axis.localized:
                visits += list_localizations(setting, one, self.fiducials_mm, start_branch)
        guide = setting.flange_from_tool.inverse()
        stereo = (setting.flange_from_stereo or setting.flange_from_tool).inverse()
        for visit in visits:
            tool = guide if visit.name.fiducial is None else stereo
            for pose in (visit.pose, visit.approach):
                setting.kinematics.solutions(Pose.from_transform(pose @ tool))

    def _find_hidden(self, setting: ArmSetting, move: CartMove) -> str:
        """Describe the frame or spheres hidden from the tracker by the arm at home, or return ''."""
        if self.robot_from_tracker is None:
            return ""
        scene = setting.scene
        assert isinstance(scene, PlanningScene)
        tracker = Transform(Frame.ROBOT, Frame.TRACKER, move.to_cart_frame(self.robot_from_tracker.rigid))
        spheres = tracker.inverse().apply(setting.robot_from_ct.apply(np.array(self.fiducials_mm)))
        stereo = setting.flange_from_stereo or setting.flange_from_tool
        if self.stereo_from_marker is not None:
            marker = setting.kinematics.flange_pose(setting.start_rad) @ stereo @ self.stereo_from_marker
            arm = setting.kinematics, setting.start_rad
            if unseen := explain_hidden_frame(tracker, marker, *arm, self.volume_mm):
                return unseen
        around = scene.with_stereo_head(setting.robot_from_ct, stereo)
        seen = TrackerSight(tracker, spheres).seen(setting.kinematics, around, setting.start_rad)
        numbers = [str(number) for number, one in enumerate(seen, start=1) if not one]
        return HIDDEN.format(f"fiducial {', '.join(numbers)}") if numbers else ""


def _depends_on_branch(setting: ArmSetting) -> bool:
    """Return whether the strategy's orientations depend on the branch, so that all branches must be tried."""
    return setting.strategy.name not in ("ocs", "thesis-ocs")


def _to_verdict(check: PathCheck, turns_rad: dict[str, float]) -> PlaceVerdict:
    if check.passed and check.branch is not None:
        return PlaceVerdict(PlaceSolution(check.branch, tuple(sorted(turns_rad.items()))))
    for first in check.unmet:
        return PlaceVerdict(None, str(first.pose), first.reason)
    return PlaceVerdict(None, "", "no branch works")

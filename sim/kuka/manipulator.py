"""The arm in the world: drives, nominal geometry for the controller and true geometry for observers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import degrees, dist, radians

import numpy as np

from sim.kuka.controller_parameters import ControllerParameters
from sim.kuka.drives import Drives
from sim.kuka.motion import pose_on_line
from sim.world.nominal_arm import axes_of_posture, description, frame_of, pose_of_frame
from sim.world.rigid import Matrix, inverse
from sim.world.scene.model import ArmTruth
from sim.world.true_arm import JointChain, TrueArm, rotation_vector
from sim.world.world import ArmState

IDENTITY = np.eye(4)
WAYPOINTS = 40  # checked before a straight path is accepted


class Manipulator:
    """Moving arm that publishes its true flange pose."""

    def __init__(
        self,
        truth: ArmTruth,
        seed: int,
        publish: Callable[[ArmState], None],
        parameters: ControllerParameters,
        resume_from: ArmState | None = None,
    ) -> None:
        """Start at `resume_from`, the arm's last state in a continued world, or at home if None."""
        self.description = description(truth.variant)
        start_deg = (
            truth.home_deg if resume_from is None else [degrees(angle) for angle in resume_from.joints_rad]
        )
        self.drives = Drives(self.description, start_deg, parameters, resume_from)
        self._nominal = JointChain(self.description)
        self._true = TrueArm(truth, seed)
        self._publish = publish
        self._tools: dict[int, Matrix] = {0: np.eye(4)}  # $TOOL_DATA in the flange frame
        self._bases: dict[int, Matrix] = {0: np.eye(4)}  # $BASE_DATA in $ROBROOT
        self.tool_number = self.base_number = 0
        self._tool: Matrix | None = None  # $TOOL, None is the flange
        self._base: Matrix | None = None  # $BASE in $ROBROOT, None is $ROBROOT
        self._readout_step_deg = parameters.readout_step_deg
        self._read: list[float] | None = None
        self._reported: list[float] = []
        self._reported_frame: list[float] | None = None
        self._published: tuple[int, bool] | None = None
        self.publish()

    @property
    def axes_deg(self) -> list[float]:
        """Encoder angles in degrees."""
        return self.drives.axes_deg

    @property
    def reported_deg(self) -> list[float]:
        """Encoder angles as reported, in degrees; the same object while nothing moves."""
        if self._read is not self.drives.axes_deg:
            self._read, step, self._reported_frame = self.drives.axes_deg, self._readout_step_deg, None
            self._reported = [round(angle / step) * step for angle in self._read] if step else self._read
        return self._reported

    @property
    def frame(self) -> list[float]:
        """Nominal tool frame in BASE, X Y Z (mm) A B C (deg)."""
        return self._frame_at(self.drives.axes_deg)

    @property
    def reported_frame(self) -> list[float]:
        """Tool frame at the reported axes, X Y Z (mm) A B C (deg); the same object while nothing moves."""
        reported_deg = self.reported_deg
        if self._reported_frame is None:
            self._reported_frame = self._frame_at(reported_deg)
        return self._reported_frame

    @property
    def base(self) -> Matrix:
        """Pose of $BASE in $ROBROOT, (4, 4)."""
        return IDENTITY if self._base is None else self._base

    def tool_point(self, axes_deg: Sequence[float] | None = None) -> Matrix:
        """Return the nominal tool pose (4, 4) in $ROBROOT at the given axes (default: present)."""
        axes = self.drives.axes_deg if axes_deg is None else axes_deg
        flange = self._nominal.flange([radians(angle) for angle in axes])
        return flange if self._tool is None else flange @ self._tool

    def _frame_at(self, axes_deg: list[float]) -> list[float]:
        pose = self.tool_point(axes_deg)
        return frame_of(pose if self._base is None else inverse(self._base) @ pose)

    def peak_tool_speed_mm(self, goal_deg: Sequence[float]) -> float:
        """Return the peak tool speed of a synchronous motion, in mm per unit of path parameter."""
        start_deg = self.drives.axes_deg
        places = [
            self.tool_point([a + n / WAYPOINTS * (b - a) for a, b in zip(start_deg, goal_deg, strict=True)])[
                :3, 3
            ]
            for n in range(WAYPOINTS + 1)
        ]
        return WAYPOINTS * max(dist(a, b) for a, b in pairwise(places))

    def _flange_of(self, tool_point: Matrix) -> Matrix:
        return tool_point if self._tool is None else tool_point @ inverse(self._tool)

    def set_tool(self, number: int, frame: Sequence[float]) -> None:
        """Define and activate a tool, X Y Z (mm) A B C (deg) in the flange frame."""
        self._tools[number] = pose_of_frame(frame)
        self.use_frames(number, self.base_number)

    def set_base(self, number: int, frame: Sequence[float]) -> None:
        """Define and activate a base, X Y Z (mm) A B C (deg) in $ROBROOT."""
        self._bases[number] = pose_of_frame(frame)
        self.use_frames(self.tool_number, number)

    def use_frames(self, tool_number: int, base_number: int) -> None:
        """Activate a tool and a base (0 is the identity); raises ValueError for an undefined number."""
        for what, number, frames in (("tool", tool_number, self._tools), ("base", base_number, self._bases)):
            if number not in frames:
                raise ValueError(f"{what} {number} is not defined")
        self._tool, self._base = self._tools[tool_number], self._bases[base_number]
        self.tool_number, self.base_number, self._reported_frame = tool_number, base_number, None

    def joints_for(self, tool_point: Matrix, near_deg: Sequence[float]) -> list[float] | None:
        """Return the joint angles (deg) nearest to `near_deg` for a nominal tool pose, or None on failure."""
        flange = self._flange_of(tool_point)
        joints = self._nominal.joints_at(flange, [radians(angle) for angle in near_deg])
        return None if joints is None else [degrees(angle) for angle in joints]

    def axes_in_posture(self, frame: Matrix, status: int, turn: int) -> list[float] | None:
        """Return the axes (deg) for a pose (4, 4) in BASE with posture S T, or None if unreachable."""
        flange = self._flange_of(self.base @ frame)
        return axes_of_posture(self.description, flange, status, turn, self.drives.axes_deg)

    def joints_at_line_end(self, tool_point: Matrix) -> list[float] | None:
        """Return the axes (deg) after a straight line to a pose in $ROBROOT, or None if unreachable."""
        start, near_deg = self.tool_point(), self.drives.axes_deg
        turn = rotation_vector(tool_point[:3, :3] @ start[:3, :3].T)
        for number in range(1, WAYPOINTS + 1):
            pose = pose_on_line(start, tool_point, turn, number / WAYPOINTS)
            joints_deg = self.joints_for(pose, near_deg)
            if joints_deg is None or any(
                not joint.lower_deg <= angle <= joint.upper_deg
                for joint, angle in zip(self.description.joints, joints_deg, strict=True)
            ):
                return None
            near_deg = joints_deg
        return near_deg

    def follow(self, command_deg: list[float], *, has_reply: bool) -> None:
        """Advance one cycle towards a command."""
        self.drives.step(command_deg, has_reply=has_reply)
        self.publish()

    def settle(self) -> None:
        """Advance one cycle without a command."""
        self.drives.settle()
        self.publish()

    def publish(self) -> None:
        """Publish the flange pose if it has changed."""
        drives = self.drives
        if drives.at_rest and self._published == (id(drives.axes_deg), True):
            return
        encoders = [radians(angle) for angle in drives.axes_deg]
        self._publish(drives.state(self._true, encoders, at_rest=drives.at_rest))
        self._published = (id(drives.axes_deg), drives.at_rest)

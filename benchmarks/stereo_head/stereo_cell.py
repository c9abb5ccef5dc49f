"""In-process simulated arm and stereo head: true kinematics and rendered images, without a network.

The two devices implement the interfaces used by the procedure's step. A campaign thus runs the step's own
loop thousands of times at the cost of drawing and measuring the images.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import patch

import numpy as np

from benchmarks.stereo_head.stereo_pictures import Studio
from procedures.journal.journal import JOURNAL_FILE, Journal
from procedures.operator.checkpoint import Checkpoint
from procedures.operator.question import Question, Topic
from procedures.planning.line_of_sight import StereoSight
from procedures.planning.pose_name import PoseKind, PoseName
from procedures.planning.visits import Visit
from procedures.relocalization import StereoPoint
from procedures.runs.answers import ScriptedOperator
from procedures.workcell import MountedTool, Workcell
from procedures.workcell.centring import CentredSphere, Centring
from procedures.workcell.stereo_look import Look
from ronna_hw.arm.kr6_r900 import Kr6R900, kr6_r900
from ronna_hw.arm.pose import Pose
from ronna_hw.arrays import Array
from ronna_hw.calibration import STEREO_HEAD_NUMBER, StereoHeadCalibration
from ronna_hw.clock import HostClock
from ronna_hw.config import parse_theatre
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import AreaOfInterest, CameraImage, Stamp, StereoReading, Validity
from ronna_hw.devices.robot import JointMove, Motion
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector
from sim.basler.camera.photographer import Photographer
from sim.basler.settings import CameraSettings
from sim.world.displacements import spheres_in_theatre
from sim.world.rigid import (
    apply,
    inverse,
    matrix_from,
    matrix_of,
    pose_of,
    rotation_from_vector,
    rotation_towards,
)
from sim.world.scene.model import LinkError, Scene
from sim.world.scene.named_scenes import draw_scene
from sim.world.true_arm import TrueArm
from sim.world.world import ArmState, World

EXPOSURE_US, GAIN_RAW = 2000, 100  # the driver's defaults
STANDOFF_MM = 60.0
LARGEST_TILT_RAD = 0.35  # between the tool axis and straight down
TRAJECTORY = "T1"
NO_LINK_ERROR = LinkError(translation_mm=(0.0, 0.0, 0.0), rotation_rad=(0.0, 0.0, 0.0))
SIX_ZEROS = (0.0,) * 6


def with_ideal_arm(scene: Scene) -> Scene:
    """Return the scene with a nominal arm, except for its repeatability error of 0.015 mm per axis."""
    exact = {
        "links": (NO_LINK_ERROR,) * 6,
        "joint_offset_rad": SIX_ZEROS,
        "harmonic_1_rad": SIX_ZEROS,
        "harmonic_2_rad": SIX_ZEROS,
        "sag_rad": (0.0, 0.0),
        "backlash_rad": SIX_ZEROS,
    }
    return scene.model_copy(update={"arm": scene.arm.model_copy(update=exact)})


def without_arm_errors(scene: Scene) -> Scene:
    mount = scene.mount.model_copy(update={"flange_from_tool_true": scene.mount.flange_from_tool_nominal})
    return with_ideal_arm(scene).model_copy(update={"mount": mount})


@dataclass
class CellArm:
    """Arm that completes every motion at once, with gear flanks set by the direction of travel."""

    state = Lifecycle.ACTIVE

    world: World
    kinematics: Kr6R900
    truth: TrueArm
    joints_rad: JointVector
    flanks: list[float] = field(default_factory=lambda: [1.0] * 6)
    motions: int = 0

    def read_state(self, timeout_s: float = 1.0) -> SimpleNamespace:
        return SimpleNamespace(joints_rad=self.joints_rad)

    def read_tool_identity(self, timeout_s: float = 1.0) -> SimpleNamespace:
        return SimpleNamespace(number=STEREO_HEAD_NUMBER)

    def move(self, motion: Motion, **_more: Any) -> SimpleNamespace:
        target_rad = (
            motion.target_rad
            if isinstance(motion, JointMove)
            else self.kinematics.solve_branch(
                Pose.from_transform(motion.target),
                self.kinematics.branch_of(self.joints_rad),
                self.joints_rad,
            )
        )
        travels_rad = [new - old for new, old in zip(target_rad, self.joints_rad, strict=True)]
        self.flanks = [
            float(np.sign(travel_rad)) if travel_rad else flank
            for travel_rad, flank in zip(travels_rad, self.flanks, strict=True)
        ]
        self.joints_rad, self.motions = target_rad, self.motions + 1
        flange = self.truth.at_rest(target_rad, self.flanks, self.motions)
        self.world.publish_arm(ArmState(target_rad, flange, self.motions, True))
        return self.read_state()


class CellStereo:
    """Stereo head that renders an image pair on request."""

    def __init__(self, world: World) -> None:
        self._cameras = [
            (
                Photographer(world, truth),
                truth.serial,
                CameraSettings(exposure_us=EXPOSURE_US, gain_raw=GAIN_RAW),
            )
            for truth in (world.scene.left, world.scene.right)
        ]
        self._exposure_us: float = EXPOSURE_US
        self.pairs = 0
        self.clock = HostClock()

    def set_areas(self, left: AreaOfInterest, right: AreaOfInterest, timeout_s: float = 2.0) -> None:
        for (_, _, settings), area in zip(self._cameras, (left, right), strict=True):
            settings.offset_x, settings.offset_y = area.offset_x, area.offset_y
            settings.width, settings.height = area.width, area.height

    def set_exposure(self, exposure_us: float, gain_raw: int, timeout_s: float = 2.0) -> None:
        self._exposure_us = exposure_us
        for _, _, settings in self._cameras:
            settings.exposure_us, settings.gain_raw = round(exposure_us), gain_raw

    def scale_exposure(self, share: float, timeout_s: float = 2.0) -> None:
        for _, _, settings in self._cameras:
            settings.exposure_us = round(share * self._exposure_us)

    def grab_pair(self, timeout_s: float = 5.0) -> StereoReading:
        self.pairs += 1
        stamp = Stamp(self.pairs, self.pairs, self.clock.now_s())
        left, right = (
            self._take_image(stamp, camera, serial, settings) for camera, serial, settings in self._cameras
        )
        return StereoReading(stamp, Validity.OK, left, right)

    def _take_image(
        self, stamp: Stamp, camera: Photographer, serial: str, settings: CameraSettings
    ) -> CameraImage:
        drawn = camera.triggered(settings.frame(), self.pairs)
        pixels = np.frombuffer(drawn, np.uint8).reshape(settings.height, settings.width)
        area = AreaOfInterest(settings.offset_x, settings.offset_y, settings.width, settings.height)
        return CameraImage(stamp, Validity.OK, serial, pixels, area)


@dataclass(frozen=True)
class Start:
    """A sphere, and the commanded tool pose from which the servo starts."""

    fiducial: int
    expected: Transform
    near_rad: JointVector


class StereoCell:
    """Simulated cell of a scene, using the given stereo head calibration."""

    def __init__(self, scene: Scene, calibration: StereoHeadCalibration, folder: Path) -> None:
        self.scene = scene
        self.world = World.create(scene, paced=False)
        self.kinematics = kr6_r900(scene.arm.variant)
        home: Any = tuple(float(np.radians(angle)) for angle in scene.arm.home_deg)
        self.arm = CellArm(self.world, self.kinematics, TrueArm(scene.arm, scene.seed), home)
        self.stereo = CellStereo(self.world)
        self._home = home
        self._tool_in_flange = calibration.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
        self._calibration = calibration
        self._workcell = _build_workcell(self.arm, self.stereo, calibration, folder)
        self.centres_mm = apply(
            matrix_of(scene.head.robot_from_ct), [each.centre_ct_mm for each in spheres_in_theatre(scene)]
        )

    def draw_start(self, generator: np.random.Generator, away_mm: float, *, in_sight: bool = True) -> Start:
        """Draw a sphere, a viewing direction, and a true tool position `away_mm` from the sphere.

        A servo begins where the path check found both lines of sight clear, so only such sides are drawn.
        Without `in_sight` only refused sides are drawn: another sphere is in the way.
        """
        while True:
            fiducial = int(generator.integers(len(self.centres_mm)))
            direction = generator.standard_normal(3)
            offset = away_mm * direction / np.linalg.norm(direction)
            tilt = rotation_from_vector([*generator.uniform(-LARGEST_TILT_RAD, LARGEST_TILT_RAD, 2), 0.0])
            sphere = self.centres_mm[fiducial]
            outwards = np.array([sphere[0], sphere[1], 0.0])
            orientation = tilt @ rotation_towards((0.0, 0.0, -1.0), outwards)
            nominal = matrix_from(sphere, orientation)
            if self._is_in_sight(fiducial, nominal) is in_sight:
                break
        # the tool's true position when the controller believes it is on the sphere
        self._move_tool(nominal)
        believed_mm = self.world.robot_from_tool()[:3, 3]
        expected = matrix_from(sphere + offset - (believed_mm - sphere), orientation)
        return Start(fiducial, _as_transform(expected), self._solve_joints(expected))

    def centre(self, start: Start, *, is_close: bool = False) -> CentredSphere:
        """Run the procedure's own servo loop on one sphere."""
        centring = Centring(self._workcell, (1,) * 6, self.scene.servo_area_px, STANDOFF_MM)
        found = centring.centre_on(start.fiducial, start.expected, start.near_rad, is_close=is_close)
        centring.back_off()
        return found

    def centre_on_truth(self, start: Start) -> CentredSphere:
        """Centre on a sphere using error-free measurements instead of images."""

        def look() -> Look:
            seen = apply(inverse(self.world.robot_from_tool()), [self.centres_mm[start.fiducial]])[0]
            point = StereoPoint(seen, np.eye(3), 0.0, (0.0, 0.0))
            return Look(cast(StereoReading, None), None, None, point)

        with patch.object(self._workcell, "look", look):
            return self.centre(start)

    def look_from(self, start: Start) -> Look:
        self._move_tool(start.expected.as_matrix())
        self._workcell.sensors.read_whole()
        return self._workcell.look()

    def true_offset_mm(self, found: CentredSphere, fiducial: int) -> Array:
        """Return the recorded point minus the true sphere position, robot frame (3,)."""
        return np.asarray(found.point_mm - self.centres_mm[fiducial])

    def rest_error_mm(self, joints_rad: JointVector, motion: int) -> Array:
        """Return the repeatability error (3,) of a motion at its end."""
        at_rest = self.arm.truth.at_rest(joints_rad, self.arm.flanks, motion)
        return np.asarray((at_rest - self.arm.truth.moving(joints_rad, self.arm.flanks))[:3, 3])

    def _is_in_sight(self, fiducial: int, tool: Array) -> bool:
        visit = Visit(PoseName(PoseKind.FIDUCIAL, TRAJECTORY, fiducial), _as_transform(tool), 0.0)
        return not StereoSight.of(self._calibration).unmet([visit], self.centres_mm)

    def _move_tool(self, tool: Array) -> None:
        self.arm.move(JointMove(self._solve_joints(tool)))

    def _solve_joints(self, tool: Array) -> JointVector:
        flange = Pose.from_transform(_as_transform(tool) @ self._tool_in_flange.inverse())
        return self.kinematics.solve_branch(flange, self.kinematics.branch_of(self._home), self._home)


def _build_workcell(
    arm: CellArm, stereo: CellStereo, calibration: StereoHeadCalibration, folder: Path
) -> Workcell:
    """Build the procedure's workcell from these devices, with its journal in the folder."""
    (folder / JOURNAL_FILE).unlink(missing_ok=True)
    file = parse_theatre({"theatre": "stereo cell"})  # its devices are passed in, without endpoints
    theatre = SimpleNamespace(
        arms={"master": arm}, stereo=stereo, clock=stereo.clock, require=lambda *_names: None, file=file
    )
    calibrations: Any = SimpleNamespace(
        stereo_head=calibration, arms={}, tracker_frame=SimpleNamespace(tool="arm")
    )
    workcell = Workcell(cast("Any", theatre), Journal(folder), calibrations=calibrations)
    operator = ScriptedOperator()

    def agree(question: Question) -> str:
        return operator.ask(question).word

    resting = Checkpoint(agree, lambda _state, _reason: nullcontext(), HostClock())
    workcell.master.supervised.ask_before(resting, agree)
    workcell.master.supervised.confirm(Topic.FIRST_MOTION, "every motion of a benchmark", ())
    workcell.master.mount.check(MountedTool.STEREO_HEAD)
    return workcell


def _as_transform(matrix: Array) -> Transform:
    pose = pose_of(matrix)
    return Transform.of(
        Frame.ROBOT, Frame.TOOL, translation_mm=pose.translation_mm, quaternion_wxyz=pose.quaternion_wxyz
    )


START_MM = 5.0
END_MM, STEPS = 0.03, 8
STARTS_PER_CELL = 100  # then another arm, mount and head
PLACES_SEED = 7


@dataclass
class ServoTally:
    """Servo results by start. `beyond_mm` are the point errors without the repeatability error."""

    starts: int = 0
    steps: list[int] = field(default_factory=list)
    residuals_mm: list[float] = field(default_factory=list)
    errors_mm: list[float] = field(default_factory=list)
    beyond_mm: list[float] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)

    @property
    def within(self) -> int:
        """Number of starts that met the end condition within the allowed steps."""
        ends = zip(self.steps, self.residuals_mm, strict=True)
        return sum(steps <= STEPS and residual <= END_MM for steps, residual in ends)


def servo_campaign(
    starts: int,
    scene_of: Callable[[Scene], Scene] = lambda scene: scene,
    *,
    first_seed: int = 0,
    drawn: bool = True,
    in_sight: bool = True,
) -> ServoTally:
    """Run the servo step from `starts` random positions, in scenes modified by `scene_of`.

    Without drawn images the measurements are the truth, at a fiftieth of the cost: only the arm's
    errors remain. Without `in_sight` it begins where the path check would refuse to, with another
    sphere in the line of sight.
    """
    tally = ServoTally()
    with tempfile.TemporaryDirectory(prefix="ronna-servo-") as folder:
        for number in range(-(-starts // STARTS_PER_CELL)):
            scene = scene_of(draw_scene("default", seed=first_seed + number))
            count = min(STARTS_PER_CELL, starts - tally.starts)
            cell = calibrated_cell(scene, Path(folder))
            generator = np.random.default_rng([PLACES_SEED, first_seed + number])
            for _ in range(count):
                _from_one_start(cell, cell.draw_start(generator, START_MM, in_sight=in_sight), tally, drawn)
    return tally


def calibrated_cell(scene: Scene, folder: Path) -> StereoCell:
    """Return a cell with perfectly calibrated cameras on a mount assumed to be nominal."""
    perfect = Studio(scene).calibration()
    nominal = perfect.model_copy(update={"flange_from_tool": scene.mount.flange_from_tool_nominal})
    return StereoCell(scene, nominal, folder)


def _from_one_start(cell: StereoCell, start: Start, tally: ServoTally, drawn: bool) -> None:
    tally.starts += 1
    try:
        found = cell.centre(start) if drawn else cell.centre_on_truth(start)
    except RonnaError as problem:
        tally.failures.append(str(problem))
        return
    error = cell.true_offset_mm(found, start.fiducial)
    # the retreat was one more motion after the measurement
    rest = cell.rest_error_mm(found.joints_rad, cell.arm.motions - 1)
    tally.steps.append(len(found.residuals_mm) - 1)
    tally.residuals_mm.append(found.residuals_mm[-1])
    tally.errors_mm.append(float(np.linalg.norm(error)))
    tally.beyond_mm.append(float(np.linalg.norm(error + rest)))

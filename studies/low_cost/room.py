"""The room of the experiment: phantom with its frame, tracker, tool, and UR5 arms with errors.

PAPER 2 (IROS 2015, pp. 3785-3790) was not found: places and shapes are our own. Arms are drawn as a
theatre's are, with links and joint offsets scaled to what the vendor says of arms without a calibration.
"""

from __future__ import annotations

import math

import numpy as np

from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.arrays import Array
from ronna_hw.frames import Frame, Transform
from ronna_hw.wire.polaris import PolarisModel
from sim.world.descriptions import DESCRIPTIONS
from sim.world.noise import noise
from sim.world.nominal_arm import AXES
from sim.world.rigid import (
    apply,
    as_point,
    matrix_from,
    matrix_of,
    pose_of,
    rotation_from_vector,
    rotation_towards,
)
from sim.world.scene.arm_design import CHOSEN
from sim.world.scene.as_built import draw_arm
from sim.world.scene.head import CAP_AXIS_CT, CENTRE_CT_MM, LEFT_CT
from sim.world.scene.model import ArmTruth, LinkError, Mount, Scene, TrackerTruth
from sim.world.scene.named_scenes import add_patient_frame, draw_scene, robot_frame
from sim.world.true_arm import JointChain, TrueArm
from studies.low_cost.targets import REFERENCE
from studies.sphere_errors import GLUED_MM

MODEL = ArmChoice.UR5.value
SPHERES = 8
PHANTOM_MM = (470.0, -60.0, 60.0)  # centre of the head on the table, in reach without a stretched arm
CAP_TOWARDS = (0.2, 0.4, 1.0)  # spheres are around this direction: upwards, and somewhat to the tracker
TRACKER_DIRECTION = (0.45, 0.75, 0.75)  # from the middle of what it watches
WATCHED_MM = (30.0, 100.0, 70.0)  # this middle, from the centre of the head
TRACKER_DISTANCE_MM = 1000.0  # the Vicra's volume is deepest there: 557 to 1336 mm

TIP_IN_FLANGE_MM = (0.0, 0.0, 170.0)
FRAME_ABOVE_TIP_MM, FRAME_ASIDE_MM = 130.0, 75.0  # of the tool's frame, towards the tracker
BUILT_MM, BUILT_RAD = 0.5, math.radians(0.05)  # deviation of the tool's frame from its drawing, per axis

# ISO 9283: repeatability is mean + 3 sd of the distance from the mean position. For equal, normal errors
# sigma per axis that is 2 sqrt(2 / pi) sigma + 3 sqrt(3 - 8 / pi) sigma.
REPEATABILITY_MM = 0.1  # UR5, data sheet
REPEATABILITY_SIGMAS = 2.0 * math.sqrt(2.0 / math.pi) + 3.0 * math.sqrt(3.0 - 8.0 / math.pi)
# Error of an arm with nominal parameters, rms over the workspace. The vendor: stretched arms differ from
# their model by up to "multiple millimeters". The arms of a study are spread over this range.
NOMINAL_ERRORS_MM = (2.0, 5.0)
POSTURES, SPREAD_RAD = 200, math.radians(60.0)  # about home, of every joint, either way
POSTURES_KEY = 5  # of the random numbers

TOOL_KEY, ARM_KEY = "low-cost tool", "low-cost arm"  # of random numbers


def draw_room(seed: int) -> Scene:
    """Draw phantom, tool and tracker. The arm in it is nominal: `draw_ur5` draws true ones."""
    drawn = draw_scene("default", seed=seed, markers=SPHERES, targets=1)
    centre = np.array(PHANTOM_MM)
    turn = rotation_towards(CAP_TOWARDS, (1.0, 0.0, 0.0)) @ rotation_towards(CAP_AXIS_CT, LEFT_CT).T
    head = drawn.head.model_copy(
        update={
            "robot_from_ct": pose_of(matrix_from(centre - turn @ np.array(CENTRE_CT_MM), turn)),
            "seating_error_mm": GLUED_MM,
        }
    )
    backwards = np.array(TRACKER_DIRECTION) / np.linalg.norm(TRACKER_DIRECTION)
    place = centre + WATCHED_MM + TRACKER_DISTANCE_MM * backwards
    tracker = TrackerTruth(
        model=PolarisModel.VICRA,
        robot_from_tracker=pose_of(matrix_from(place, rotation_towards(backwards, (0.0, 0.0, 1.0)))),
        tools=(robot_frame(),),
    )
    scene = drawn.model_copy(
        update={"head": head, "mount": _draw_tool(drawn.mount, seed, backwards), "tracker": tracker}
    )
    return add_patient_frame(scene)


def _draw_tool(mount: Mount, seed: int, to_tracker: Array) -> Mount:
    """Return a mount whose tool centre is the tip of a pointer on the flange's axis."""
    tool = matrix_from(TIP_IN_FLANGE_MM, np.eye(3))
    random = noise(seed, TOOL_KEY, 0)
    marker = drawn_marker_in_tip().as_matrix()
    marker[:3, 3] += random.normal(0.0, BUILT_MM, 3)
    marker[:3, :3] = marker[:3, :3] @ rotation_from_vector(random.normal(0.0, BUILT_RAD, 3))
    return mount.model_copy(
        update={
            "flange_from_tool_nominal": pose_of(tool),
            "flange_from_tool_true": pose_of(tool),
            "tool_from_marker_true": pose_of(marker),
        }
    )


def drawn_marker_in_tip() -> Transform:
    """Return the pose TOOL <- MARKER by the tool's drawing: the frame faces the tracker."""
    towards = REFERENCE.as_matrix().T @ np.array(TRACKER_DIRECTION) / np.linalg.norm(TRACKER_DIRECTION)
    aside = np.array([*towards[:2], 0.0]) / np.linalg.norm(towards[:2])
    place = FRAME_ASIDE_MM * aside - np.array([0.0, 0.0, FRAME_ABOVE_TIP_MM])
    return Transform.from_matrix(
        Frame.TOOL, Frame.MARKER, matrix_from(place, rotation_towards(towards, (0.0, 0.0, -1.0)))
    )


def draw_ur5(seed: int, number: int, arms: int) -> ArmTruth:
    """Draw a true UR5 by its number. Of `arms`, the first errs least and the last most."""
    random = np.random.default_rng(np.random.SeedSequence([seed, *ARM_KEY.encode(), number]))
    drawn = draw_arm(random, CHOSEN[ArmChoice.UR5])
    as_drawn = _scaled(drawn, 1.0)
    least, largest = NOMINAL_ERRORS_MM
    wanted_mm = np.geomspace(least, largest, arms)[number]
    return _scaled(drawn, float(wanted_mm / nominal_error_mm(as_drawn)))  # errors are small, so nearly linear


def _scaled(drawn: ArmTruth, scale: float) -> ArmTruth:
    """Return a UR5 with links and joint offsets of that share, and the data sheet's repeatability."""
    links = tuple(
        LinkError(
            translation_mm=as_point(scale * np.array(link.translation_mm)),
            rotation_rad=as_point(scale * np.array(link.rotation_rad)),
        )
        for link in drawn.links
    )
    return drawn.model_copy(
        update={
            "links": links,
            "joint_offset_rad": tuple(scale * offset for offset in drawn.joint_offset_rad),
            "repeatability_mm": REPEATABILITY_MM / REPEATABILITY_SIGMAS,
        }
    )


def nominal_error_mm(truth: ArmTruth) -> float:
    """Return the rms error of the flange by nominal parameters, mm, over the workspace."""
    true, nominal = TrueArm(truth, seed=0), JointChain(DESCRIPTIONS[truth.variant])
    random = np.random.default_rng(POSTURES_KEY)
    postures = np.radians(truth.home_deg) + random.uniform(-SPREAD_RAD, SPREAD_RAD, (POSTURES, AXES))
    still = (0.0,) * AXES
    errors = [true.moving(one, still)[:3, 3] - nominal.flange(one)[:3, 3] for one in postures.tolist()]
    return float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))


def phantom_centre_mm(scene: Scene) -> Array:
    """Return the centre of the phantom in the robot frame."""
    return np.asarray(apply(matrix_of(scene.head.robot_from_ct), scene.head.centre_ct_mm))

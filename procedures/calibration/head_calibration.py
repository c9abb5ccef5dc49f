"""Stereo head calibration: adjustment, tool frame, and dated records with stated errors.

Images and arm determine where the cameras are on the flange. The tool frame relative to them is a convention,
and whatever shares the mount (guide tip, reference frame) is known relative to it. So it is kept where the
previous record had it: points around the tool centre keep their pixels in both images. Only a head that has
moved on the mount since it was calibrated leaves the tip where it is on the flange.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.calibration.bundle import BALL, DERIVATIVE_STEP, BundleFit, fit_bundle
from procedures.calibration.head_model import (
    CAMERA_PARAMETERS,
    Cameras,
    adjust_cameras,
    cameras_of,
    intersect_rays,
    pose_record,
)
from procedures.calibration.observations import ObservationSet, identifier_suffix
from procedures.calibration.pose_set import rms_mm
from ronna_hw.arm.catalogue import find_arm
from ronna_hw.arrays import Array
from ronna_hw.calibration import StereoHeadCalibration, ToolTipCalibration
from ronna_hw.frames import Frame, Transform

LIFE = timedelta(days=30)
MADE_BY = "ronna-stereo calibrate"
# Over the standard error of a tool centre: two calibrations of one head, each with an error of its own, are
# within three standard deviations of each other.
MOVED_OVER_ERROR = 3.0 * math.sqrt(2.0)
ANCHOR_REACH_MM = 6.0  # of the points around the tool centre that keep their pixels


@dataclass(frozen=True)
class HeadResult:
    """New head records and their quality. Covariance (3, 3) mm2 of the tool centre on the flange.

    `tool_error_mm` is its standard error; the record states that of a point measured in the tool frame, where
    errors of the arm hardly count. `tool_shift_mm` is how far the tool centre moved on the flange. A shift
    beyond `smallest_slip_mm` means that the head has moved on its mount (None where the previous record is of
    another kind and not compared). `frame_misfit_mm` (rms) is how far the cameras have moved relative to each
    other since the previous record.
    """

    fit: BundleFit
    stereo_head: StereoHeadCalibration
    tool_tip: ToolTipCalibration | None
    tool_covariance_mm2: Array
    tool_shift_mm: float
    frame_misfit_mm: float
    smallest_slip_mm: float | None

    @property
    def head_moved(self) -> bool:
        """Whether the head has moved on its mount since the previous calibration."""
        return self.smallest_slip_mm is not None and self.tool_shift_mm > self.smallest_slip_mm

    @property
    def tool_error_mm(self) -> float:
        """Standard error of the tool centre on the flange."""
        return _standard_error_mm(self.tool_covariance_mm2)


def calibrate_head(
    observed: ObservationSet, *, life: timedelta = LIFE, arm_geometry: bool = True
) -> HeadResult:
    """Compute dated records from observations. Raises CAL-002 to CAL-004.

    Without `arm_geometry` all errors of the arm are treated as random.
    """
    before = observed.start
    arm = find_arm(observed.arm_variant).kinematics.chain if arm_geometry else None
    fit = fit_bundle(observed.observations, before, arm=arm)
    flange_from_tool, misfit = _fit_tool_frame(before, fit.cameras)
    left, right = fit.cameras
    head = StereoHeadCalibration(
        identifier=new_identifier("stereo-head", observed.created),
        stated_error_mm=_point_error_mm(before, fit),
        flange_from_tool=pose_record(flange_from_tool),
        left=left.record(observed.serials[0], before.left.sensor_px, flange_from_tool),
        right=right.record(observed.serials[1], before.right.sensor_px, flange_from_tool),
        created=observed.created,
        expires=observed.created + life,
        made_by=MADE_BY,
    )
    tool_before = before.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    shift_mm = float(np.linalg.norm(flange_from_tool.translation_mm - tool_before.translation_mm))
    covariance = _covariance(fit, lambda cameras: _triangulate_anchors(before, cameras)[0])
    # A drawing is as far off as the whole mount; a calibration of the same kind only by its error.
    smallest_mm = MOVED_OVER_ERROR * _standard_error_mm(covariance) if before.made_by == MADE_BY else None
    moved = smallest_mm is not None and shift_mm > smallest_mm
    tip = observed.tool_tip
    return HeadResult(
        fit=fit,
        stereo_head=head,
        tool_tip=tip if tip is None or moved else move_tip(tip, tool_before, flange_from_tool),
        tool_covariance_mm2=covariance,
        tool_shift_mm=shift_mm,
        frame_misfit_mm=misfit,
        smallest_slip_mm=smallest_mm,
    )


def _standard_error_mm(covariance_mm2: Array) -> float:
    return float(np.sqrt(np.trace(covariance_mm2)))


def new_identifier(name: str, created: datetime) -> str:
    """Compose a record identifier from name and time."""
    return name + identifier_suffix(created)


def move_tip(tip: ToolTipCalibration, before: Transform, after: Transform) -> ToolTipCalibration:
    """Move the tip along with the head's tool frame, since they share a mount.

    Its dates and stated error remain: the tip itself was not measured.
    """
    flange_from_tip = tip.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    moved = after.rigid * before.rigid.inv() * flange_from_tip.rigid
    return tip.model_copy(
        update={"flange_from_tool": pose_record(Transform(Frame.FLANGE, Frame.TOOL, moved))}
    )


def _anchor_points() -> Array:
    """Return the tool centre and the corners of a cube around it, (9, 3) mm in the tool frame."""
    corners = np.array(np.meshgrid(*3 * ([-ANCHOR_REACH_MM, ANCHOR_REACH_MM],))).reshape(3, -1).T
    return np.vstack([np.zeros(3), corners])


def _triangulate_anchors(before: StereoHeadCalibration, cameras: Cameras) -> Array:
    """Return the flange points at which these cameras see the anchor points' previous pixels."""
    tool = before.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    points = tool.apply(_anchor_points())
    left, right = cameras_of(before)
    return intersect_rays(cameras, left.image_points(points), right.image_points(points))[0]


def _fit_tool_frame(before: StereoHeadCalibration, cameras: Cameras) -> tuple[Transform, float]:
    """Fit FLANGE <- TOOL so as to preserve pixels near the tool centre; also return the rms misfit, mm."""
    tool, flange = _anchor_points(), _triangulate_anchors(before, cameras)
    middle_tool, middle_flange = tool.mean(axis=0), flange.mean(axis=0)
    rotation, _ = Rotation.align_vectors(flange - middle_flange, tool - middle_tool)
    rigid = RigidTransform.from_components(middle_flange - rotation.apply(middle_tool), rotation)
    pose = Transform(Frame.FLANGE, Frame.TOOL, rigid)
    return pose, rms_mm(pose.apply(tool) - flange)


def _point_error_mm(before: StereoHeadCalibration, fit: BundleFit) -> float:
    """Return the standard error of a point measured in the tool frame, rms over the anchor points, mm."""

    def points_in_tool(cameras: Cameras) -> Array:
        flange_from_tool, _ = _fit_tool_frame(before, cameras)
        return np.ravel(flange_from_tool.rigid.inv().apply(_triangulate_anchors(before, cameras)))

    return float(np.sqrt(np.trace(_covariance(fit, points_in_tool)) / len(_anchor_points())))


def _covariance(fit: BundleFit, evaluate: Callable[[Cameras], Array]) -> Array:
    """Return the covariance (n, n) of n values computed from the cameras."""
    slopes = []
    for step in DERIVATIVE_STEP * np.eye(2 * CAMERA_PARAMETERS):
        ahead, behind = (evaluate(adjust_cameras(fit.cameras, sign * step)) for sign in (1.0, -1.0))
        slopes.append((ahead - behind) / (2.0 * DERIVATIVE_STEP))
    by_value = np.transpose(slopes)
    return np.asarray(by_value @ fit.covariance[BALL:, BALL:] @ by_value.T)

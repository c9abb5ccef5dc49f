"""Projection model of the two cameras on the flange: images of a ball given in the flange frame.

Pinhole with OpenCV's distortion k1 k2 p1 p2 k3. Free per camera: rotation and translation relative to the
initial record (rad, mm), focal length (relative), principal point (px) and k1. The pixel aspect ratio and the
other distortion coefficients are kept from that record: a field of 5 degrees does not reveal them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from procedures.relocalization.triangulation import distort
from ronna_hw.arrays import Array
from ronna_hw.calibration import CameraCalibration, PoseRecord, StereoHeadCalibration
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import vector3

CAMERA_PARAMETERS = 10  # rotation 3, translation 3, focal length, principal point 2, k1
UNDISTORT_STEPS = 12  # each gains about three digits with lenses of this kind


@dataclass(frozen=True)
class FlangeCamera:
    """Camera on the flange: pose CAMERA <- FLANGE as rotation matrix and translation (mm), and lens."""

    rotation: Array
    translation_mm: Array
    focal_px: Array
    principal_px: Array
    distortion: tuple[float, float, float, float, float]

    @classmethod
    def from_record(cls, camera: CameraCalibration, flange_from_tool: Transform) -> FlangeCamera:
        """Build the camera from a record and the tool frame that the record refers to."""
        pose = camera.camera_from_tool.transform(Frame.CAMERA_LEFT, Frame.TOOL) @ flange_from_tool.inverse()
        return cls(
            pose.rotation_matrix,
            pose.translation_mm,
            np.array(camera.focal_px),
            np.array(camera.principal_point_px),
            camera.distortion,
        )

    def with_increments(self, increments: Array) -> FlangeCamera:
        """Add increments to the camera's ten parameters."""
        turn = Rotation.from_rotvec(increments[:3]).as_matrix()
        k1, k2, p1, p2, k3 = self.distortion
        return FlangeCamera(
            turn @ self.rotation,
            self.translation_mm + increments[3:6],
            self.focal_px * (1.0 + increments[6]),
            self.principal_px + increments[7:9],
            (k1 + float(increments[9]), k2, p1, p2, k3),
        )

    def image_points(self, points_mm: Array, semi_minor_px: ArrayLike = 0.0) -> Array:
        """Project points (n, 3) in the flange frame to pixels (n, 2).

        Given the semi-minor axis b of a ball's outline, return the centre of that outline instead, which is
        farther out than the ball's centre by the factor 1 + b^2, b in normalised units.
        """
        x, y, z = (points_mm @ self.rotation.T + self.translation_mm).T
        b = np.asarray(semi_minor_px, dtype=float) / np.sqrt(self.focal_px.prod())
        out = np.column_stack([x / z, y / z]) * np.reshape(1.0 + b * b, (-1, 1))
        return distort(out, self.distortion) * self.focal_px + self.principal_px

    def slopes(self, points_mm: Array) -> Array:
        """Differentiate the pixels by the point, (n, 2, 3), ignoring distortion: only for weighting."""
        x, y, z = (points_mm @ self.rotation.T + self.translation_mm).T
        slope = np.zeros((len(points_mm), 2, 3))
        slope[:, 0, 0] = slope[:, 1, 1] = 1.0 / z
        slope[:, 0, 2], slope[:, 1, 2] = -x / z**2, -y / z**2
        return np.asarray(slope * self.focal_px[:, None] @ self.rotation)

    def rays(self, pixels: Array) -> tuple[Array, Array]:
        """Return the centre of projection (3,) and unnormalized directions (n, 3) in the flange frame."""
        image_points = (pixels - self.principal_px) / self.focal_px
        straight = image_points
        for _ in range(UNDISTORT_STEPS):
            straight = straight + (image_points - distort(straight, self.distortion))
        directions = np.column_stack([straight, np.ones(len(straight))]) @ self.rotation
        return -self.rotation.T @ self.translation_mm, directions

    def record(
        self, serial: str, sensor_px: tuple[int, int], flange_from_tool: Transform
    ) -> CameraCalibration:
        """Convert to a record relative to a tool frame."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.translation_mm
        pose = Transform.from_matrix(Frame.CAMERA_LEFT, Frame.FLANGE, matrix) @ flange_from_tool
        fx, fy = self.focal_px.tolist()
        cx, cy = self.principal_px.tolist()
        return CameraCalibration(
            serial=serial,
            focal_px=(fx, fy),
            principal_point_px=(cx, cy),
            distortion=self.distortion,
            sensor_px=sensor_px,
            camera_from_tool=pose_record(pose),
        )


Cameras = tuple[FlangeCamera, FlangeCamera]


def cameras_of(calibration: StereoHeadCalibration) -> Cameras:
    """Build a record's left and right cameras, relative to the flange."""
    tool = calibration.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    return FlangeCamera.from_record(calibration.left, tool), FlangeCamera.from_record(calibration.right, tool)


def adjust_cameras(cameras: Cameras, increments: Array) -> Cameras:
    """Add increments (20,) to the parameters of the left and of the right camera."""
    left, right = cameras
    return (
        left.with_increments(increments[:CAMERA_PARAMETERS]),
        right.with_increments(increments[CAMERA_PARAMETERS:]),
    )


def intersect_rays(cameras: Cameras, left_px: Array, right_px: Array) -> tuple[Array, Array]:
    """Return midpoints (n, 3) between lines of sight in the flange frame, and gaps (n,), mm.

    The gap is signed: positive when the right line of sight passes on the side of left x right.
    """
    (origin_a, a), (origin_b, b) = cameras[0].rays(left_px), cameras[1].rays(right_px)
    between = origin_b - origin_a
    across = np.cross(a, b)
    square = np.sum(across * across, axis=1)
    along_a = np.sum(np.cross(between, b) * across, axis=1) / square
    along_b = np.sum(np.cross(between, a) * across, axis=1) / square
    near_a, near_b = origin_a + along_a[:, None] * a, origin_b + along_b[:, None] * b
    gaps = np.sum((near_b - near_a) * across, axis=1) / np.sqrt(square)
    return 0.5 * (near_a + near_b), gaps


def pose_record(pose: Transform) -> PoseRecord:
    """Convert a transform to a pose record."""
    qw, qx, qy, qz = pose.quaternion_wxyz.tolist()
    return PoseRecord(translation_mm=vector3(pose.translation_mm), quaternion_wxyz=(qw, qx, qy, qz))

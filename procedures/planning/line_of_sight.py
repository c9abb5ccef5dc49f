"""Lines of sight of the stereo head and the tracker at the planned poses.

Stereo head: spheres are compared by their outlines in a camera. Two outlines must not touch, whichever sphere
is nearer, because a bright neighbour behind the rim is as harmful as one in front.

Tracker: an estimate past the bodies of the path check. It can explain why nothing is seen, but never prove
that something is: only a reading does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.planning.pose_name import MARKER, SPHERE
from procedures.planning.visits import Unmet, Visit
from ronna_hw.arm.clearance.bodies import Bodies, Surroundings
from ronna_hw.arm.clearance.sweep import moving_ends, segment_distances
from ronna_hw.arm.kinematics import ArmBodies
from ronna_hw.calibration import CameraCalibration, StereoHeadCalibration
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector

Array = NDArray[np.float64]

SPHERE_RADIUS_MM = 5.75
CLEARANCE_MM = 3.0  # around each sphere, for the error of the coarse positions
# The two sensors, tracker frame, mm: half a metre apart about the origin, along y. A sphere is measured only
# if both see it. An estimate: manufacturers publish the outer size of their units, 0.6 m.
SENSORS_MM = ((0.0, -250.0, 0.0), (0.0, 250.0, 0.0))
# The pyramid of a Polaris Spectra, as published: z, half x, half y of faces and knee, tracker frame, mm.
VOLUME_MM = ((-2400.0, 656.4, 783.0), (-1532.0, 398.0, 572.0), (-950.0, 224.7, 240.6))
FRAME_MM = 100.0  # how far the spheres of the frame on the arm are from its origin


@dataclass(frozen=True)
class StereoSight:
    """Positions of the two cameras in the tool frame, mm."""

    left_mm: Array
    right_mm: Array

    @classmethod
    def of(cls, calibration: StereoHeadCalibration) -> Self:
        """Derive the camera positions from the stereo head's calibration record."""
        return cls(_projection_centre(calibration.left), _projection_centre(calibration.right))

    def unmet(self, visits: Sequence[Visit], spheres_mm: ArrayLike) -> tuple[Unmet, ...]:
        """List localizations with a neighbour touching the sphere's outline. Spheres (n, 3) are in robot mm.

        Row k of the spheres is the one measured by a visit of `fiducial` k.
        """
        spheres = np.asarray(spheres_mm, dtype=float).reshape(-1, 3)
        found = []
        for visit in visits:
            fiducial = visit.name.fiducial
            if fiducial is None:
                continue
            for name, camera_mm in (("left", self.left_mm), ("right", self.right_mm)):
                neighbour = _find_touching(visit.pose.apply(camera_mm), spheres, fiducial)
                if neighbour is not None:
                    reason, words = (
                        f"{one} {neighbour + 1} is in front of or behind it in the {name} camera"
                        for one in (SPHERE, MARKER)
                    )
                    found.append(Unmet(visit.name, reason, words))
        return tuple(found)


def _projection_centre(camera: CameraCalibration) -> Array:
    """Return the projection centre of either camera in the tool frame."""
    return camera.camera_from_tool.transform(Frame.CAMERA_LEFT, Frame.TOOL).inverse().translation_mm


def _find_touching(camera_mm: Array, spheres_mm: Array, index: int) -> int | None:
    rays = spheres_mm - camera_mm
    distances = np.linalg.norm(rays, axis=1)
    radii = np.arcsin(np.minimum(1.0, (SPHERE_RADIUS_MM + CLEARANCE_MM) / distances))
    cosines = np.clip(rays @ rays[index] / (distances * distances[index]), -1.0, 1.0)
    gaps = np.arccos(cosines) - radii - radii[index]
    gaps[index] = np.inf
    nearest = int(np.argmin(gaps))
    return nearest if gaps[nearest] < 0.0 else None


@dataclass(frozen=True)
class TrackerSight:
    """Tracker pose from global localization, and `spheres_mm` (n, 3) in the tracker frame."""

    robot_from_tracker: Transform
    spheres_mm: Array

    def seen(self, arm: ArmBodies, surroundings: Surroundings, joints_rad: JointVector) -> NDArray[np.bool_]:
        """Flag the spheres (n,) visible to both sensors past the arm and its tool, ignoring static bodies.

        The head hid none of them when they were localized, nor do clamp and table.
        """
        bodies = Bodies(arm, surroundings)
        ends = moving_ends(bodies, np.array([joints_rad]))[0]  # (bodies, 2, 3)
        eyes, spheres = (self.robot_from_tracker.apply(places) for places in (SENSORS_MM, self.spheres_mm))
        shape = (3, len(ends), len(eyes), len(spheres))
        starts, stops = (np.broadcast_to(side.T[:, :, None, None], shape) for side in ends.swapaxes(0, 1))
        eyes = np.broadcast_to(eyes.T[:, None, :, None], shape)
        spheres = np.broadcast_to(spheres.T[:, None, None, :], shape)
        radii = np.array(bodies.moving_radii_mm)[:, None, None]
        hidden: NDArray[np.bool_] = np.asarray(segment_distances(starts, stops, eyes, spheres) < radii)
        return np.asarray(~hidden.any(axis=(0, 1)))


def explain_hidden_frame(
    robot_from_tracker: Transform, robot_from_marker: Transform, arm: ArmBodies, joints_rad: JointVector
) -> str:
    """Explain why the tracker cannot see the frame on the arm, which faces along its z axis, or return ''."""
    marker = robot_from_tracker.inverse() @ robot_from_marker
    x_mm, y_mm, z_mm = marker.translation_mm.tolist()
    depths_mm, *halves_mm = np.transpose(VOLUME_MM)
    half_x_mm, half_y_mm = (float(np.interp(z_mm, depths_mm, half)) for half in halves_mm)
    outside_mm = max(abs(x_mm) - half_x_mm, abs(y_mm) - half_y_mm, depths_mm[0] - z_mm, z_mm - depths_mm[-1])
    if outside_mm > -FRAME_MM:
        return "the frame on the arm at home is outside the measuring volume of the tracker"
    if ((np.array(SENSORS_MM) - marker.translation_mm) @ marker.rotation_matrix[:, 2]).min() <= 0.0:
        return "the frame on the arm at home faces away from the tracker"
    if not TrackerSight(robot_from_tracker, marker.translation_mm[None]).seen(
        arm, Surroundings(), joints_rad
    ):
        return "the arm at home hides the frame on it from the tracker"
    return ""

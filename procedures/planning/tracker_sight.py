"""Lines of sight of the tracker past an arm and its tool.

An estimate past the bodies of the path check. It can explain why nothing is seen, but never prove that
something is: only a reading does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronna_hw.arm.clearance.bodies import Bodies, Surroundings
from ronna_hw.arm.clearance.pair_distances import segment_distances
from ronna_hw.arm.clearance.sweep import moving_ends
from ronna_hw.arm.kinematics import ArmBodies
from ronna_hw.arrays import Array, Mask
from ronna_hw.devices.crossed_sight import SENSORS_MM
from ronna_hw.devices.sensors import VolumeSections
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector

FRAME_MM = 100.0  # how far the spheres of the frame on the arm are from its origin


@dataclass(frozen=True)
class TrackerSight:
    """Tracker pose from global localization, and `spheres_mm` (n, 3) in the tracker frame."""

    robot_from_tracker: Transform
    spheres_mm: Array

    def seen(self, arm: ArmBodies, surroundings: Surroundings, joints_rad: JointVector) -> Mask:
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
        hidden: Mask = np.asarray(segment_distances(starts, stops, eyes, spheres) < radii)
        return np.asarray(~hidden.any(axis=(0, 1)))


def explain_hidden_frame(
    robot_from_tracker: Transform,
    robot_from_marker: Transform,
    arm: ArmBodies,
    joints_rad: JointVector,
    volume_mm: VolumeSections,
) -> str:
    """Explain why the tracker cannot see the frame on the arm, which faces along its z axis, or return ''.

    An empty `volume_mm` is unknown, and explains nothing.
    """
    marker = robot_from_tracker.inverse() @ robot_from_marker
    if volume_mm and _outside_mm(marker.translation_mm, volume_mm) > -FRAME_MM:
        return "the frame on the arm at home is outside the measuring volume of the tracker"
    if ((np.array(SENSORS_MM) - marker.translation_mm) @ marker.rotation_matrix[:, 2]).min() <= 0.0:
        return "the frame on the arm at home faces away from the tracker"
    if not TrackerSight(robot_from_tracker, marker.translation_mm[None]).seen(
        arm, Surroundings(), joints_rad
    ):
        return "the arm at home hides the frame on it from the tracker"
    return ""


def _outside_mm(place_mm: Array, volume_mm: VolumeSections) -> float:
    """Return how far a place (3,), tracker frame, is outside the volume; inside, it is negative."""
    x_mm, y_mm, z_mm = place_mm.tolist()
    depths_mm, *halves_mm = np.transpose(volume_mm[::-1])
    half_x_mm, half_y_mm = (float(np.interp(z_mm, depths_mm, half)) for half in halves_mm)
    return float(max(abs(x_mm) - half_x_mm, abs(y_mm) - half_y_mm, depths_mm[0] - z_mm, z_mm - depths_mm[-1]))

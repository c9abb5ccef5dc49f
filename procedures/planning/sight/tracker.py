"""Which spheres the tracker sees past the arm, using the bodies of the path check.

An estimate that can explain why nothing is seen, but never proves that something is: only a reading does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ronna_hw.arm.clearance.bodies import Bodies
from ronna_hw.arm.clearance.surroundings import Surroundings
from ronna_hw.arm.clearance.sweep import moving_ends, segment_distances
from ronna_hw.arm.links import ArmBodies
from ronna_hw.devices.readings import JointVector
from ronna_hw.frames import Transform

Array = NDArray[np.float64]

# The two sensors, tracker frame, mm: half a metre apart about the origin, along y. A sphere is measured only
# if both see it. An estimate: manufacturers publish the outer size of their units, 0.6 m.
SENSORS_MM = ((0.0, -250.0, 0.0), (0.0, 250.0, 0.0))


@dataclass(frozen=True)
class TrackerSight:
    """The tracker at the pose found by global localization; `spheres_mm` (n, 3) in its frame."""

    robot_from_tracker: Transform
    spheres_mm: Array

    def seen(self, arm: ArmBodies, surroundings: Surroundings, joints_rad: JointVector) -> NDArray[np.bool_]:
        """Which spheres (n,) both sensors see past the arm and its tool. Static bodies hide none.

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

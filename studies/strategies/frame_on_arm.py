"""Worth of the frame on the arm, seen by the tracker at every look: by the covariance alone.

The frame is displaced by the arm's errors at its own place, so a tracker that sees it at each look says
something of them. Where it is mounted and where the tracker stands are unknown. Each of its spheres is read
with the noise of the frames that a look takes, and off by the tracker's distortion, which varies smoothly
over its volume.
"""

from __future__ import annotations

import json
import sys

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.distance import cdist

from procedures.calibration.arm_sources import REPEATABILITY_MM, SERVO_MM
from procedures.registration.look_choice import POSE_SD
from procedures.registration.rigid_fit import pose_jacobian
from procedures.workcell.tracker_look import FRAMES
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.deviations import flange_rotations
from ronna_hw.calibrated_arm.error_budget import unit_errors
from studies.accuracy.phantom import FREE_SPHERES, Markers, draw_phantom
from studies.accuracy.postures import ARM
from studies.accuracy.scene import AXES
from studies.correspondence.pairing_misspecified import WAVELENGTHS_MM
from studies.strategies.case_plans import CasePlanner, PlannedLooks
from studies.strategies.distorted_tracker import FRAME_MM
from studies.strategies.learning import SCENARIOS, TARGETS_OF_CASE, plan_case
from studies.strategies.study import DEPTHS_MM

PLACE = 1
# Spheres of the frame in the flange frame: a square beside the tool (U).
FRAME_IN_FLANGE_MM = np.array([[30.0, 90, 40], [-30, 90, 40], [30, 150, 40], [-30, 150, 40]])
# Distortion per axis: as a tracker states its error for the whole volume, 0.3 mm 3-D rms, and a tenth of it.
DISTORTIONS_MM = (0.3 / np.sqrt(AXES), 0.03 / np.sqrt(AXES))
ALIKE_MM = float(np.mean(WAVELENGTHS_MM)) / (2.0 * np.pi)  # spheres nearer than this are off alike
TOOL_COLUMNS = slice(-AXES, None)  # of the unit errors: the frame is not on the tool


def rms_mm(planner: CasePlanner, looks: PlannedLooks, distortion_mm: float | None) -> float:
    """Return the rms error at the targets predicted from the looks, with the frame or without (None)."""
    points, targets = planner.spheres_mm[looks.spheres], planner.targets_mm
    centre, count, spheres = points.mean(axis=0), len(points), len(planner.spheres_mm)
    arm = unit_errors(ARM.chain, looks.joints_rad, points, planner.sizes, looks.arrival)
    errors = arm.shape[2]
    of_sphere = np.eye(spheres)[looks.spheres]
    on_spheres = np.einsum("cn,ij->cinj", of_sphere, np.eye(AXES)).reshape(count, AXES, -1)
    nothing = np.zeros((count, AXES, 12))  # by the poses of tracker and frame
    rows = [np.concatenate([pose_jacobian(points, centre), -arm, on_spheres, nothing], axis=2)]
    noise = [np.eye(AXES * count) * (REPEATABILITY_MM**2 + SERVO_MM**2 / AXES)]
    if distortion_mm is not None:
        places = _frame_places(looks)  # (c, k, 3)
        seen = np.concatenate([_frame_rows(planner, looks, one, centre) for one in range(places.shape[1])], 1)
        unseen = np.zeros((count, seen.shape[1], 6 + AXES * spheres))
        rows.append(
            np.concatenate([unseen[..., :6], seen[..., :errors], unseen[..., 6:], seen[..., errors:]], axis=2)
        )
        apart = cdist(places.reshape(-1, AXES), places.reshape(-1, AXES))
        field = distortion_mm**2 * np.exp(-0.5 * np.square(apart / ALIKE_MM))
        noise.append(np.kron(field + np.eye(len(field)) * FRAME_MM**2 / FRAMES, np.eye(AXES)))
    design = np.concatenate([one.reshape(-1, one.shape[2]) for one in rows])
    ct = np.full(AXES * spheres, planner.ct_mm**2 / AXES)
    prior = np.concatenate([np.square(POSE_SD), np.ones(errors), ct, np.tile(np.square(POSE_SD), 2)])
    known = design.T @ np.linalg.solve(block_diag(*noise), design) + np.diag(1.0 / prior)
    at_targets = unit_errors(
        ARM.chain, looks.targets.joints_rad, targets, planner.sizes, looks.target_arrival
    )
    rest = np.zeros((len(targets), AXES, AXES * spheres + 12))
    aims = np.concatenate([pose_jacobian(targets, centre), -at_targets, rest], axis=2)
    aims = aims.reshape(-1, aims.shape[2])
    return float(np.sqrt(np.trace(aims @ np.linalg.solve(known, aims.T)) / len(targets)))


def _frame_places(looks: PlannedLooks) -> Array:
    """Return the places (c, k, 3) mm of the frame's spheres at every look, robot frame."""
    turns = flange_rotations(ARM.chain, looks.joints_rad)
    flanges = np.array([ARM.flange_pose(tuple(one)).translation_mm for one in looks.joints_rad.tolist()])
    return np.asarray(flanges[:, None] + np.einsum("cij,kj->cki", turns, FRAME_IN_FLANGE_MM))


def _frame_rows(planner: CasePlanner, looks: PlannedLooks, marker: int, centre: Array) -> Array:
    """Return how one sphere of the frame moves (c, 3, k + 12): by the arm, the tracker and its mount."""
    places = _frame_places(looks)[:, marker]
    arm = unit_errors(ARM.chain, looks.joints_rad, places, planner.sizes, looks.arrival)
    arm[..., TOOL_COLUMNS] = 0.0
    turns = flange_rotations(ARM.chain, looks.joints_rad)
    mount = turns @ pose_jacobian(FRAME_IN_FLANGE_MM[marker], FRAME_IN_FLANGE_MM.mean(axis=0))
    return np.concatenate([arm, pose_jacobian(places, centre), mount], axis=2)


def main() -> None:
    """Print the predicted rms of one case in JSON, with the frame and without."""
    phantom = draw_phantom(Markers.FREE, DEPTHS_MM, TARGETS_OF_CASE)
    found = {}
    for kind in SCENARIOS:
        planner = plan_case(kind, phantom, PLACE)
        looks = planner.choose(planner.candidates(), FREE_SPHERES)
        without_mm = rms_mm(planner, looks, None)
        found[kind] = {"without_mm": without_mm} | {
            f"distorted_by_{1000.0 * np.sqrt(AXES) * distortion_mm:.0f}_um": {
                "with_mm": (with_mm := rms_mm(planner, looks, distortion_mm)),
                "less_percent": 100.0 * (1.0 - with_mm / without_mm),
            }
            for distortion_mm in DISTORTIONS_MM
        }
    sys.stdout.write(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()

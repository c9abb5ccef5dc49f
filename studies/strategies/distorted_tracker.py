"""Followed moves of the head, measured by a tracker whose distortion varies over its volume.

Beyond the pairing, the tracker decides an error at the target only here: the registration follows a small
move of the head by the spheres before and after it. What the distortion is at one place cancels; how it
changes over the move does not, and the covariance of the readings does not contain it.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from enum import StrEnum

import numpy as np
from scipy.spatial.transform import Rotation

from procedures.registration.movement import fit_rigid_move
from procedures.steps.clinical.followed_move import MOST_FOLLOWED_RAD, STEADY_MM
from procedures.steps.clinical.room import MOST_FOLLOWED_MM
from procedures.workcell.tracker_look import FRAMES
from ronna_hw.arrays import Array
from studies.accuracy.phantom import Markers, draw_phantom
from studies.campaign import bounds
from studies.campaign.study import Sums, Table, yes_or_no
from studies.correspondence.pairing_misspecified import DISTORTION_MM, WAVELENGTHS_MM, distort
from studies.heads import draw_pose, uniform_in_ball
from studies.strategies.study import DEPTHS_MM, TARGETS

RUNS = 400
MOVES_KEY = 13  # of the random numbers
FRAME_MM = 0.1  # noise of one frame, per axis
GOAL = 0.90  # of the errors within the 95 % limit


class Tracker(StrEnum):
    """Tracker as the prediction assumes it, and one that distorts."""

    AS_STATED = "as stated"
    DISTORTS = "distorts"


def follow_moves(tracker: Tracker, seed: int, runs: int) -> Sums:
    """Follow random moves; return the sums of errors and limits at the targets, and counts."""
    random = np.random.default_rng(np.random.SeedSequence([seed, MOVES_KEY, zlib.crc32(tracker.encode())]))
    phantom = draw_phantom(Markers.FREE, DEPTHS_MM, TARGETS)
    targets_mm = np.array([one.target_mm for one in phantom.trajectories])
    count = len(phantom.spheres_mm)
    covariance = np.tile(np.eye(3) * (2.0 * FRAME_MM**2 / FRAMES + STEADY_MM**2), (count, 1, 1))
    sums: Sums = dict.fromkeys(("targets", "used", "refused", "inside", "error", "limit"), 0.0)
    for _ in range(runs):
        pose = draw_pose(random)
        before, targets = pose.apply(phantom.spheres_mm), pose.apply(targets_mm)
        middle = before.mean(axis=0)
        turn = Rotation.from_rotvec(uniform_in_ball(1, MOST_FOLLOWED_RAD, random)[0])
        shift = uniform_in_ball(1, MOST_FOLLOWED_MM, random)[0]

        def move(points: Array, turn: Rotation = turn, middle: Array = middle, shift: Array = shift) -> Array:
            return np.asarray(turn.apply(points - middle) + middle + shift)

        both = np.concatenate([before, move(before)])
        seen = distort(both[None], random)[0] if tracker is Tracker.DISTORTS else both
        noise_mm = np.hypot(FRAME_MM / np.sqrt(FRAMES), STEADY_MM / np.sqrt(2.0))  # drift between readings
        read = seen + random.normal(0.0, noise_mm, seen.shape)
        fit = fit_rigid_move(read[:count], read[count:], covariance)
        sums["targets"] += TARGETS
        if not fit.gate.passed or fit.rms_mm > MOST_FOLLOWED_MM or fit.turn_rad > MOST_FOLLOWED_RAD:
            sums["refused"] += TARGETS
            continue
        errors_mm = np.linalg.norm(fit.fit.transform.apply(targets) - move(targets), axis=1)
        limits_mm = fit.fit.predict_tre(targets).limit_mm
        sums["used"] += TARGETS
        sums["inside"] += float(np.sum(errors_mm <= limits_mm))
        sums["error"] += float(errors_mm.sum())
        sums["limit"] += float(limits_mm.sum())
    return sums


def tabulate(sums: Mapping[str, Sums]) -> Table:
    """Tabulate the errors that following a move adds, against their limits."""
    return Table.of(
        "Followed moves of the head",
        [
            {
                "tracker": tracker,
                "targets": round(one["targets"]),
                "refused %": 100.0 * one["refused"] / one["targets"],
                "mean error mm": one["error"] / one["used"],
                "mean limit mm": one["limit"] / one["used"],
                **bounds.cells("within %", bounds.percent(one["inside"], one["used"])),
                f"at least {100 * GOAL:.0f} %": yes_or_no(one["inside"] >= GOAL * one["used"]),
            }
            for tracker, one in sums.items()
            if one["used"]
        ],
        f"Five spheres. The distortion is {DISTORTION_MM} mm rms with wavelengths of "
        f"{WAVELENGTHS_MM[0]:g} to {WAVELENGTHS_MM[1]:g} mm. The error is what following adds at a target. "
        f"{bounds.NOTE}",
    )

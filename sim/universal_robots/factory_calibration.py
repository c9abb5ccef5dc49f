"""The factory's calibration of an arm: Denavit-Hartenberg parameters fitted to measured poses of its flange.

The factory knows no truth: it measures the arm in many postures, with an error of its own. What these
parameters cannot describe, errors of gears and sag, remains the error of the calibrated arm.

Shoulder, elbow and wrist 1 have parallel axes. Near that, a turn between two axes about their common tangent
has no small Denavit-Hartenberg parameters: it puts their common normal hundreds of metres away. `linearised`
leaves that turn out; `exact` contains it, as in real arms with d2 = 439 m.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, Literal

import numpy as np

from sim.universal_robots.kinematics import TrueKinematics
from sim.universal_robots.model import ALPHA_RAD, JOINTS, Model, Vector6
from sim.world.noise import noise
from sim.world.rigid import Matrix, rotation_from_vector
from sim.world.scene.model import ArmTruth
from sim.world.true_arm import ROTATION_WEIGHT_MM, TrueArm

FactoryCalibration = Literal["linearised", "exact", "none"]

KEY: Final = "factory calibration"  # noise key
POSTURES: Final = 60
WORKING_RANGE_RAD: Final = 2.0  # to either side of zero, of a joint while it is measured
MEASURED_WITHIN_MM: Final = 0.05  # error of a measured pose, one sigma per axis (U)
ITERATIONS: Final = 4
DIFFERENCE: Final = 1e-6  # rad or m, for derivatives
MM_PER_M: Final = 1000.0

# Rows of a table of parameters; `BETA` is a turn about y after the others, zero in a controller.
THETA, D, A, ALPHA, BETA = range(5)
_PARALLEL: Final = (1, 2)  # links between parallel axes: their d only repeats that of wrist 1


def calibrate(model: Model, truth: ArmTruth, seed: int, kind: FactoryCalibration) -> TrueKinematics:
    """Return the chain that the factory has stored in the controller of an arm."""
    if kind == "none":
        return TrueKinematics(model)
    nominal = _nominal(model)
    fitted = _fit(nominal, TrueArm(truth, seed), seed, has_turns=kind == "exact")
    if kind == "exact":
        fitted = _without_turns(fitted)
    theta, d, a, alpha, _ = (_six(row) for row in fitted - nominal)
    return TrueKinematics(model, theta_rad=theta, a_m=a, d_m=d, alpha_rad=alpha)


def _nominal(model: Model) -> Matrix:
    table = np.zeros((5, JOINTS))
    table[D], table[A], table[ALPHA] = model.d_m, model.a_m, ALPHA_RAD
    return table


def _fit(nominal: Matrix, arm: TrueArm, seed: int, *, has_turns: bool) -> Matrix:
    """Return the parameters whose chain is closest to the measured poses, by least squares."""
    draws = noise(seed, KEY, 0)
    joints = draws.uniform(-WORKING_RANGE_RAD, WORKING_RANGE_RAD, (POSTURES, JOINTS))
    flanks = draws.choice((-1.0, 1.0), (POSTURES, JOINTS))
    measured = np.array([arm.moving(*at) for at in zip(joints, flanks.tolist(), strict=True)])
    measured[:, :3, 3] /= MM_PER_M
    errors = draws.normal(0.0, MEASURED_WITHIN_MM / MM_PER_M, (POSTURES, 6))
    free = [(row, link) for row in (THETA, D, A, ALPHA) for link in range(JOINTS)]
    free = [(row, link) for row, link in free if row != D or link not in _PARALLEL]
    free += [(BETA, link) for link in _PARALLEL if has_turns]
    table = nominal.copy()
    for _ in range(ITERATIONS):
        here = _difference(measured, _flange(table, joints))
        columns = []
        for place in free:
            moved = table.copy()
            moved[place] += DIFFERENCE
            columns.append((here - _difference(measured, _flange(moved, joints))).ravel() / DIFFERENCE)
        step = np.linalg.lstsq(np.array(columns).T, (here + errors).ravel(), rcond=None)[0]
        for place, change in zip(free, step, strict=True):
            table[place] += change
    return table


def _difference(wanted: Matrix, poses: Matrix) -> Matrix:
    """Return the small differences (n, 6) of poses, in m; rotations are scaled by the reach of the arm."""
    turns = wanted[:, :3, :3] @ poses[:, :3, :3].transpose(0, 2, 1)
    skew = (turns - turns.transpose(0, 2, 1)) / 2.0
    rotation = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    shift: Matrix = wanted[:, :3, 3] - poses[:, :3, 3]
    return np.concatenate([shift, ROTATION_WEIGHT_MM / MM_PER_M * rotation], axis=1)


def _flange(table: Matrix, joints_rad: Matrix) -> Matrix:
    """Return the flange poses (n, 4, 4) in the base, in m."""
    pose: Matrix = np.broadcast_to(np.eye(4), (len(joints_rad), 4, 4))
    for number in range(JOINTS):
        pose = pose @ _turned(joints_rad[:, number]) @ _link(table[:, number])
    return pose


def _turned(angles_rad: Matrix) -> Matrix:
    turns = np.zeros((len(angles_rad), 4, 4))
    turns[:, 0, 0] = turns[:, 1, 1] = np.cos(angles_rad)
    turns[:, 1, 0] = np.sin(angles_rad)
    turns[:, 0, 1] = -turns[:, 1, 0]
    turns[:, 2, 2] = turns[:, 3, 3] = 1.0
    return turns


def _link(parameters: Matrix) -> Matrix:
    theta, d, a, alpha, beta = parameters
    link = np.eye(4)
    about_z = rotation_from_vector((0.0, 0.0, theta))
    link[:3, :3] = about_z @ rotation_from_vector((alpha, 0.0, 0.0)) @ rotation_from_vector((0.0, beta, 0.0))
    link[:3, 3] = about_z @ (a, 0.0, d)
    return link


def _without_turns(table: Matrix) -> Matrix:
    """Return Denavit-Hartenberg parameters of the same chain: by the common normals of its axes."""
    frame = np.eye(4)
    axes = [frame]  # with all joints at zero, each z is an axis
    for number in range(JOINTS):
        frame = frame @ _link(table[:, number])
        axes.append(frame)
    exact = np.zeros_like(table)
    here = np.eye(4)  # on the axis of this joint, with z along it
    for number in range(JOINTS - 1):
        z, next_z, next_at = here[:3, 2], axes[number + 1][:3, 2], axes[number + 1][:3, 3]
        x = np.cross(z, next_z)
        x /= np.linalg.norm(x)
        if x @ axes[number + 1][:3, 0] < 0.0:  # of the two, the one nearer to the x before
            x = -x
        # The common normal leaves z at `d` and meets the next axis after `a`.
        d, a, _ = np.linalg.solve(np.column_stack([z, x, -next_z]), next_at - here[:3, 3])
        exact[:, number] = (_angle(here[:3, 0], x, z), d, a, _angle(z, next_z, x), 0.0)
        here = here @ _link(exact[:, number])
    # The last frame is the flange: what was shifted and turned along its axis goes into theta and d.
    remaining = np.linalg.inv(here) @ axes[JOINTS]
    last = JOINTS - 1
    exact[A, last], exact[ALPHA, last] = table[A, last], table[ALPHA, last]
    exact[THETA, last] = np.arctan2(remaining[1, 0], remaining[0, 0])
    exact[D, last] = remaining[2, 3]
    return exact


def _angle(first: Matrix, second: Matrix, about: Matrix) -> float:
    """Return the angle from one direction to another about an axis across both, in rad."""
    return float(np.arctan2(np.cross(first, second) @ about, first @ second))


def _six(values: Iterable[float]) -> Vector6:
    one, two, three, four, five, six = (float(value) for value in values)
    return one, two, three, four, five, six

"""Load on the guide by an arm's own signals: a hand that leans on it before its rest position is measured.

Signals of a standstill are compared with those of unloaded ones. What weighs on the axes is linear in mass
and first moment of each link and of the tool. They are estimated along with the force, from vague ideas of
them: a reference in the same posture cancels them, others tell how the weight changes with the posture.
Friction of the gears differs from stop to stop, is not known in sign, and is the largest uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from ronna_hw.arm.kinematics import Chain, Kinematics
from ronna_hw.arm.load_model import LoadModel
from ronna_hw.arrays import Array
from ronna_hw.vectors import JointVector, Vector3

FALSE_ALARM_RATE = 1e-4  # share of unloaded standstills that count as loaded
GRAVITY_M_S2 = 9.81
MM = 1000.0
LINK_ARM_M = 0.2  # of a link's weight from its joint, one standard deviation per axis
TOOL_KG, TOOL_ARM_M = 2.0, 0.2  # of what is mounted: its weight and lever, one standard deviation
FORCE_BIAS_N = 20.0  # of a controller's own estimate at all stops, with a weight that it was not told
PER_BODY = 4  # mass, and first moment along three axes


@dataclass(frozen=True)
class Standstill:
    """Signals of an arm at rest, averaged over `cycles`, with `tool` on the flange.

    `signal` is the current in the controller's unit, less what the controller expects if it states that.
    `force_N` is its own estimate of the force on the tool.
    """

    joints_rad: JointVector
    signal: JointVector
    cycles: int
    tool: str
    force_N: Vector3 | None = None


@dataclass(frozen=True, eq=False)
class LoadEstimate:
    """Force on the guide in the robot base, and its displacement by the stiffness of the arm.

    The covariances include errors of torques and stiffness, and friction that hides as much of a load as it
    can. `no_load_chi2` is the squared length of the force in standard deviations of an unloaded guide.
    """

    force_N: Array  # (3,)
    covariance_N2: Array  # (3, 3)
    displacement_mm: Array  # (3,)
    displacement_covariance_mm2: Array  # (3, 3)
    no_load_chi2: float

    @property
    def noticed_from_N(self) -> float:
        """Force along the estimate that would just be noticed."""
        share = float(chdtri(3, FALSE_ALARM_RATE)) / max(self.no_load_chi2, np.finfo(float).tiny)
        return float(np.linalg.norm(self.force_N) * sqrt(share))

    @property
    def is_loaded(self) -> bool:
        """Whether "no load" is rejected, at `FALSE_ALARM_RATE`."""
        return self.no_load_chi2 > float(chdtri(3, FALSE_ALARM_RATE))


def estimate_load(
    kinematics: Kinematics,
    model: LoadModel,
    references: Sequence[Standstill],
    now: Standstill,
    guide_in_flange_mm: Vector3,
) -> LoadEstimate:
    """Estimate the force on the guide now, against unloaded standstills; raises ValueError without any."""
    if not references:
        raise ValueError("a load is estimated against at least one unloaded standstill")
    stops = (now, *references)
    tools = sorted({stop.tool for stop in stops})
    weights = PER_BODY * (len(kinematics.chain.joints) + len(tools))
    against = -point_jacobian(kinematics, now.joints_rad, guide_in_flange_mm).T / MM  # Nm/N
    rows, values, sizes = [], [], []
    for stop in stops:
        weight = np.zeros((len(against), weights + 6))  # unknown: weights, bias, force
        weight[:, :weights] = _weigh(kinematics.chain, stop.joints_rad, tools, stop.tool)
        if stop is now:
            weight[:, -3:] = against
        rows.append(weight)
        values.append(np.multiply(model.torque_per_signal_Nm, stop.signal))
        sizes.append(np.hypot(model.friction_Nm, _noise_Nm(model, stop.cycles)))
        if stop.force_N is not None and model.force_error_N is not None:
            rows.append(np.hstack([np.zeros((3, weights)), np.eye(3), float(stop is now) * np.eye(3)]))
            values.append(np.array(stop.force_N))
            sizes.append(np.full(3, model.force_error_N))
    vague = _vague_ideas(model, len(kinematics.chain.joints), len(tools))
    size = np.concatenate([*sizes, vague])
    design = np.concatenate([*rows, np.eye(len(vague), weights + 6)]) / size[:, np.newaxis]
    covariance = np.linalg.inv(design.T @ design)
    gain = covariance[-3:] @ design.T / size
    force_N = gain @ np.concatenate([*values, np.zeros(len(vague))])
    by_torque = gain[:, : len(against)]  # N/Nm
    return _conclude(model, force_N, covariance[-3:, -3:], by_torque, against)


def point_jacobian(kinematics: Kinematics, joints_rad: JointVector, in_flange_mm: ArrayLike) -> Array:
    """Return the Jacobian (3, axes) mm/rad of a point of the flange frame."""
    flange = kinematics.jacobian(joints_rad)
    lever_mm = np.reshape(kinematics.forward(joints_rad).rotation, (3, 3)) @ np.asarray(in_flange_mm)
    jacobian: Array = flange[:3] + np.cross(flange[3:], lever_mm, axisa=0, axisc=0)
    return jacobian


def _conclude(
    model: LoadModel, force_N: Array, unloaded_N2: Array, by_torque: Array, against: Array
) -> LoadEstimate:
    """Add to the errors of an unloaded guide those that grow with the load."""
    hidden_Nm2 = np.square(model.stiction_Nm) - np.square(model.friction_Nm)
    torque_error_Nm = model.torque_error_share * (against @ force_N)
    covariance = unloaded_N2 + by_torque @ np.diag(hidden_Nm2 + np.square(torque_error_Nm)) @ by_torque.T
    displacement_mm = force_N / model.stiffness_N_mm
    uneven_mm = model.stiffness_error_share * displacement_mm
    return LoadEstimate(
        force_N=force_N,
        covariance_N2=covariance,
        displacement_mm=displacement_mm,
        displacement_covariance_mm2=covariance / model.stiffness_N_mm**2 + np.diag(np.square(uneven_mm)),
        no_load_chi2=float(force_N @ np.linalg.solve(unloaded_N2, force_N)),
    )


def _noise_Nm(model: LoadModel, cycles: int) -> Array:
    independent = max(1.0, cycles / model.noise_cycles)
    return np.multiply(model.torque_per_signal_Nm, model.noise / sqrt(independent))


def _vague_ideas(model: LoadModel, links: int, tools: int) -> Array:
    """Return the sizes of weights and bias, one standard deviation, about zero."""
    link = [model.unexplained_kg, *[model.unexplained_kg * LINK_ARM_M] * 3]
    tool = [TOOL_KG, *[TOOL_KG * TOOL_ARM_M] * 3]
    return np.array(link * links + tool * tools + [FORCE_BIAS_N] * 3)


def _weigh(chain: Chain, joints_rad: JointVector, tools: Sequence[str], tool: str) -> Array:
    """Return the torques (axes, weights) Nm that hold a unit of each mass and first moment: kg, kg m."""
    turned, place_m = np.eye(3), np.array(chain.base_mm) / MM
    axes, places_m, frames = [], [], []
    for joint, angle_rad in zip(chain.joints, joints_rad, strict=True):
        axes.append(turned @ joint.axis)
        places_m.append(place_m)
        turned = turned @ Rotation.from_rotvec(angle_rad * np.array(joint.axis)).as_matrix()
        frames.append(turned)
        place_m = place_m + turned @ joint.to_next_mm / MM
    flange = np.column_stack([place_m, turned])
    bodies = [np.column_stack(one) for one in zip(places_m, frames, strict=True)]  # origin, directions
    torques = np.zeros((len(axes), PER_BODY * (len(bodies) + len(tools))))
    carried = [(number, number, body) for number, body in enumerate(bodies)]
    carried.append((len(bodies) + tools.index(tool), len(bodies) - 1, flange))
    for number, last, body in carried:
        for joint_number in range(last + 1):
            lever = body - np.outer(places_m[joint_number], (1.0, 0.0, 0.0, 0.0))
            axis = axes[joint_number]
            lifted = axis[0] * lever[1] - axis[1] * lever[0]  # height per rad
            torques[joint_number, PER_BODY * number : PER_BODY * (number + 1)] = GRAVITY_M_S2 * lifted
    return torques

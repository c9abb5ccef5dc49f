"""Assumptions by which signals of the load on an arm become torques, forces and a displacement.

All are estimates (U): gears, motors and friction of these arms are not published, nor is their stiffness. A
measurement of one arm replaces them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

from ronna_hw.vectors import JointVector, joint_vector

TORQUE_ERROR_SHARE = 0.15  # of the torque that a drive has per ampere or percent, one standard deviation
STIFFNESS_ERROR_SHARE = 0.2  # in directions and postures, one standard deviation
EVEN = sqrt(3.0)  # largest value of an even distribution over its standard deviation


@dataclass(frozen=True)
class LoadModel:
    """Assumptions on one model of arm. `signal` is percent or A, as its controller states currents."""

    torque_per_signal_Nm: JointVector  # at the joint
    stiction_Nm: JointVector  # torque that the gears hold at standstill, at most
    noise: float  # of a signal in one cycle, in its unit
    noise_cycles: int  # by which cycles must differ to be independent
    stiffness_N_mm: float  # at the tool
    subtracts_gravity: bool  # the signal is the current less what the controller expects of the arm
    unexplained_kg: float  # weight of each link that a signal may contain, one standard deviation
    force_error_N: float | None = None  # of the controller's own estimate, per axis, from stop to stop
    torque_error_share: float = TORQUE_ERROR_SHARE
    stiffness_error_share: float = STIFFNESS_ERROR_SHARE

    @property
    def friction_Nm(self) -> JointVector:
        """Standard deviation of the friction at an undisturbed stop: anywhere within what the gears hold."""
        return joint_vector(limit / EVEN for limit in self.stiction_Nm)


KR6 = LoadModel(
    torque_per_signal_Nm=(2.5, 3.5, 1.75, 0.35, 0.35, 0.2),
    stiction_Nm=(13.0, 18.0, 9.0, 2.0, 2.0, 1.2),
    noise=0.5,
    noise_cycles=3,
    stiffness_N_mm=80.0,
    subtracts_gravity=False,
    unexplained_kg=10.0,
)
UR5E = LoadModel(
    torque_per_signal_Nm=(12.6, 12.6, 12.6, 9.3, 9.3, 9.3),
    stiction_Nm=(7.0, 7.0, 7.0, 1.4, 1.4, 1.4),
    noise=0.05,
    noise_cycles=1,
    stiffness_N_mm=80.0,
    subtracts_gravity=True,
    unexplained_kg=0.5,
    force_error_N=2.0,
)
UR5 = replace(UR5E, force_error_N=None)  # its controller estimates the force by these very currents

"""Loads on the tool: forces of the room, the torques that they and gravity take, and the estimated force.

Forces are in the base of the arm, in N, as the room exerts them on the tool. Masses and centres of the links
are those that the vendor publishes for dynamics (U: quoted from memory), in the frames of the chain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import exp, sqrt
from random import Random
from typing import Final

from sim.universal_robots.controller_parameters import ControllerParameters
from sim.universal_robots.kinematics import IDENTITY, LinkPose, TrueKinematics, compose
from sim.universal_robots.model import JOINTS, ZEROS, Model
from sim.universal_robots.robot import Robot
from sim.universal_robots.variables import PAYLOAD, PLACES
from sim.world.drilling import NO_SIDE, DrilledSkull
from sim.world.held_torques import GRAVITY_M_S2, HeldTorques, Stiction
from sim.world.noise import TabledNoise
from sim.world.nominal_arm import LinkWeight
from sim.world.tool_load import SimulatedLoad

MM: Final = 1000.0
TORQUE_PER_CURRENT_NM_A: Final = (12.6, 12.6, 12.6, 9.3, 9.3, 9.3)  # motor constant times gear (U)
NOISE_TABLE: Final = 4099  # a prime: three values a cycle do not repeat soon
CONTACT_STIFFNESS_N_MM: Final = 20.0  # of an instrument in bone, by which it is relieved when drawn back (U)
BONE_RAMP_MM: Final = 0.5  # from its surface to its full resistance (U)

MOVING_CYCLES: Final = 4  # from one current to the next in motion, where nobody needs each: 8 ms (e-Series)

FORCE: Final = "actual_TCP_force"
CURRENT: Final = "actual_current"
TORQUES: Final = frozenset({CURRENT, "target_current", "target_moment"})
_FORCE, _CURRENT = PLACES[FORCE], PLACES[CURRENT]
_TARGET_CURRENT, _MOMENT = PLACES["target_current"], PLACES["target_moment"]
_COG = PLACES["payload_cog"]
Force = tuple[float, float, float]
NONE: Final[Force] = (0.0, 0.0, 0.0)


class Tissue:
    """Skin, bone and what lies behind it, on a straight way in the base (m)."""

    def __init__(
        self, entry: Sequence[float], axis: Sequence[float], parameters: ControllerParameters
    ) -> None:
        self._entry, self.axis = tuple(entry), tuple(axis)
        self._parameters = parameters
        self._deepest_mm = 0.0

    def force_n(self, tip: Sequence[float]) -> float:
        """Return the resistance at this place of the tip; drawn back, it is relieved."""
        depth_mm = MM * sum((x - e) * a for x, e, a in zip(tip, self._entry, self.axis, strict=True))
        self._deepest_mm = max(self._deepest_mm, depth_mm)
        relief = CONTACT_STIFFNESS_N_MM * (self._deepest_mm - depth_mm)
        return max(resistance_n(self._deepest_mm, self._parameters) - relief, 0.0)


def resistance_n(depth_mm: float, parameters: ControllerParameters) -> float:
    """Return the resistance to an instrument that advances at this depth under the skin's surface."""
    if depth_mm <= 0.0:
        return 0.0
    if depth_mm < parameters.skin_mm:
        return parameters.skin_stiffness_n_mm * depth_mm
    in_bone = depth_mm - parameters.skin_mm
    if in_bone < parameters.bone_mm:
        return parameters.bone_resistance_n * min(in_bone / BONE_RAMP_MM, 1.0)
    return parameters.friction_n


class Loads:
    """Loads on one arm. Without any, a cycle costs a few sums."""

    def __init__(self, robot: Robot, seed: int) -> None:
        parameters, model = robot.parameters, robot.model
        scale = parameters.force_error_scale
        random = Random(f"force estimate {seed}")
        self._noise = [random.gauss(0.0, scale * model.force_noise_N) for _ in range(NOISE_TABLE)]
        self._bias = [random.uniform(-1.0, 1.0) * scale * model.force_bias_N for _ in range(3)]
        self._place = 0
        self._robot = robot
        self._share = 1.0 - exp(-robot.cycle_s / parameters.force_lag_s)
        self._estimate: Force = NONE  # without bias and noise
        self.axial_n = 0.0
        self.hand_n: Force = NONE
        self.on_tool: SimulatedLoad | None = None  # a hand in the theatre's room
        self._push_n: Force = NONE
        self.tissue: Tissue | None = None
        self.skull: DrilledSkull | None = None  # under the drill in a holder
        self.hung_kg: Callable[[], float] | None = None  # test weight on that holder
        self._hung_n = 0.0
        self._drill_n, self._aside_n = 0.0, NO_SIDE
        self.instrument: LinkPose | None = None  # held beside the flange; its z axis replaces the tool's
        self.force_n: Force = NONE  # of the room on the tool
        self.trip = ""  # why the safety system must stop the arm
        self.shows_forces = self.shows_torques = True  # some client reads them
        self._torques = HeldTorques(model.name, link_bodies(model))
        self._held_at: tuple[object, ...] = ()
        self._held_nm: list[float] = [0.0] * JOINTS
        self._stiction = Stiction([parameters.stiction_share * most for most in model.torques_nm], seed)
        self._stops, self._moved = 0, False
        self._cycle = 0
        self._current_noise = TabledNoise(seed, CURRENT)

    def meet_tissue(self, ahead_mm: float | None) -> None:
        """Place tissue so far ahead of the tool centre point or instrument on its z axis, or remove it."""
        if ahead_mm is None:
            self.tissue = None
        elif self.tissue is None:
            tool, ahead = self._pushed(), ahead_mm / MM
            axis = (tool.r02, tool.r12, tool.r22)
            entry = (tool.x + ahead * axis[0], tool.y + ahead * axis[1], tool.z + ahead * axis[2])
            self.tissue = Tissue(entry, axis, self._robot.parameters)

    def follow(self) -> None:
        """Compute the loads of this cycle, and what the controller knows of them."""
        self._push_n = NONE if self.on_tool is None else self.on_tool.push_N()
        if self.skull is not None:
            self._drill_n, self._aside_n = self.skull.thrust_N(), self.skull.side_N
        self._hung_n = 0.0 if self.hung_kg is None else GRAVITY_M_S2 * self.hung_kg()
        along_n = self.axial_n or self._drill_n or self._aside_n != NO_SIDE
        if along_n or self._hung_n or self.tissue is not None or self.hand_n is not NONE or any(self._push_n):
            self.force_n = self._present_force()
        else:
            self.force_n = NONE
        x, y, z = self.force_n
        if self.force_n is not NONE:
            limit_n = self._robot.parameters.safety_force_n
            size_n = sqrt(x * x + y * y + z * z)
            if size_n > limit_n:
                self.trip = f"force of {size_n:.0f} N on the tool, at most {limit_n:.0f}"
        a, b, c = self._estimate
        share = self._share
        wrong = GRAVITY_M_S2 * self._unknown_mass_kg()
        self._estimate = (a + share * (x - a), b + share * (y - b), c + share * (z - wrong - c))
        if self.shows_forces:
            self._publish_force()
        if self.shows_torques or self.force_n is not NONE:
            self.publish_torques()

    def publish_torques(self) -> None:
        """Write torques and currents of the joints."""
        robot = self._robot
        values, drives, push_n = robot.values, robot.drives, self.force_n
        self._cycle += 1
        if not drives.at_rest:
            self._moved = True
            if self._cycle % MOVING_CYCLES:
                return
        held_at = drives.target, drives.actual, push_n, values[PAYLOAD], *values[_COG]
        if held_at != self._held_at:
            self._held_at = held_at
            centre_mm = [MM * value for value in values[_COG]]
            torques = self._torques
            torques.carry(values[PAYLOAD], centre_mm)
            values[_MOMENT] = expected = torques.weight_Nm(drives.target)
            values[_TARGET_CURRENT] = _currents(expected)
            torques.carry(values[PAYLOAD] + self._unknown_mass_kg(), centre_mm)
            self._held_nm = torques.weight_Nm(drives.actual)
            if push_n is not NONE:
                self._hold_force(push_n)
        if not drives.at_rest:
            motors = self._stiction.moving(self._held_nm, [_sign(speed) for speed in drives.actual_speed])
        else:
            self._stops, self._moved = self._stops + self._moved, False
            motors = self._stiction.at_rest(self._held_nm, self._stops)
        noises, size = self._current_noise.at(self._cycle, JOINTS), robot.parameters.current_noise_a
        values[_CURRENT] = [a + size * b for a, b in zip(_currents(motors), noises, strict=True)]

    def _hold_force(self, force_n: Force) -> None:
        """Add the torques against a force; one too large for a joint stops the arm.

        A hand pushes where the tool is, which the controller need not know; all else, at its centre point.
        """
        joints, tcp, push_n = self._robot.drives.actual, self._robot.tcp, self._push_n
        at_tcp = [a - b for a, b in zip(force_n, push_n, strict=True)]
        pulls = [(at_tcp, (MM * tcp.x, MM * tcp.y, MM * tcp.z))]
        if self.on_tool is not None:
            pulls.append((list(push_n), self.on_tool.point_mm))
        for pull_n, point_mm in pulls:
            if any(pull_n):
                against = self._torques.against_force_Nm(joints, pull_n, point_mm)
                self._held_nm = [a + b for a, b in zip(self._held_nm, against, strict=True)]
        for joint, (torque, most) in enumerate(zip(self._held_nm, self._robot.model.torques_nm, strict=True)):
            if abs(torque) > most and not self.trip:
                self.trip = f"joint {joint} holds {abs(torque):.0f} Nm, at most {most:.0f}"

    def _present_force(self) -> Force:
        x, y, z = (a + b for a, b in zip(self.hand_n, self._push_n, strict=True))
        z -= self._hung_n
        tool = self._pushed()
        against = self.axial_n + self._drill_n
        if against:
            x, y, z = x - against * tool.r02, y - against * tool.r12, z - against * tool.r22
        if self._aside_n != NO_SIDE:
            u, v = self._aside_n
            x += u * tool.r00 + v * tool.r01
            y += u * tool.r10 + v * tool.r11
            z += u * tool.r20 + v * tool.r21
        if self.tissue is not None:
            against = self.tissue.force_n((tool.x, tool.y, tool.z))
            u, v, w = self.tissue.axis
            x, y, z = x - against * u, y - against * v, z - against * w
        return x, y, z

    def _pushed(self) -> LinkPose:
        """Return what is pushed along its z axis, in the base."""
        robot = self._robot
        if self.instrument is None:
            return robot.tool_frame(robot.drives.actual)
        return compose(robot.kinematics.flange(robot.drives.actual), self.instrument)

    def _unknown_mass_kg(self) -> float:
        """Return how much heavier the tool is than the controller was told."""
        true_kg = self._robot.parameters.tool_mass_kg
        return true_kg - float(self._robot.values[PAYLOAD]) if true_kg else 0.0

    def _publish_force(self) -> None:
        noise, place = self._noise, self._place
        self._place = place = place + 3 if place + 6 < NOISE_TABLE else 0
        bias, (x, y, z) = self._bias, self._estimate
        self._robot.values[_FORCE] = (
            x + bias[0] + noise[place],
            y + bias[1] + noise[place + 1],
            z + bias[2] + noise[place + 2],
            0.0,
            0.0,
            0.0,
        )


def link_bodies(model: Model) -> list[LinkWeight]:
    """Return the links with the arm at zero, in the base."""
    frames = TrueKinematics(model).link_frames(ZEROS)[1:]
    centres = (
        compose(frame, IDENTITY._replace(x=x, y=y, z=z))
        for frame, (x, y, z) in zip(frames, model.link_centres_m, strict=True)
    )
    return [
        LinkWeight(mass_kg, (MM * place.x, MM * place.y, MM * place.z))
        for mass_kg, place in zip(model.link_masses_kg, centres, strict=True)
    ]


def _sign(speed: float) -> float:
    return float((speed > 0.0) - (speed < 0.0))


def _currents(torques_nm: Sequence[float]) -> list[float]:
    return [torque / constant for torque, constant in zip(torques_nm, TORQUE_PER_CURRENT_NM_A, strict=True)]

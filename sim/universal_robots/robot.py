"""The arm as programs see it: joints, tool, payload, speed slider, registers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from ronna_hw.wire.universal_robots import TOOL_INPUTS
from sim.universal_robots import variables
from sim.universal_robots.controller_parameters import ControllerParameters
from sim.universal_robots.drives import Drives
from sim.universal_robots.kinematics import (
    IDENTITY,
    LinkPose,
    TrueKinematics,
    compose,
    frame_of_pose,
    inverted,
    pose_of_frame,
)
from sim.universal_robots.model import HOME_RAD, JOINTS, Model

_TCP_OFFSET, _COG = variables.PLACES["tcp_offset"], variables.PLACES["payload_cog"]
COMMANDED_STOP: Final = "protective_stop()"  # reason of a stop that a program has asked for by that name
LARGEST: Final = 1e6  # kg, m or rad of a load, far beyond any: currents by it still fit in a package


class Robot:
    """One arm with its controller's variables. Programs move it, once per cycle."""

    def __init__(
        self,
        model: Model,
        parameters: ControllerParameters,
        kinematics: TrueKinematics,
        start_rad: Sequence[float] = HOME_RAD,
    ) -> None:
        self.model = model
        self.parameters = parameters
        self.kinematics = kinematics
        self.cycle_s = model.cycle_s
        self.drives = Drives(start_rad, model.cycle_s, parameters, model.full_speed_rad_s)
        self.values: list[Any] = list(variables.INITIAL_VALUES)
        self.values[variables.SPEED_SCALING] = self.values[variables.TARGET_SPEED_FRACTION] = 1.0
        self.tcp = IDENTITY
        self.keeps_load = False  # fault: a new payload or tool centre point has no effect
        self.stop_request = ""  # a program asks for a protective stop, for this reason
        self.told: list[str] = []  # texts of a program, until the next cycle

    # -- registers

    def input_int(self, number: int) -> int:
        """Return an integer input register."""
        value: int = self.values[variables.INPUT_INTS + number]
        return value

    def input_doubles(self, first: int, count: int = JOINTS) -> list[float]:
        """Return consecutive double input registers."""
        return self.values[variables.INPUT_DOUBLES + first : variables.INPUT_DOUBLES + first + count]

    def write_int(self, number: int, value: int) -> None:
        """Write an integer output register."""
        self.values[variables.OUTPUT_INTS + number] = value

    def write_doubles(self, first: int, values: Sequence[float]) -> None:
        """Write consecutive double output registers."""
        self.values[variables.OUTPUT_DOUBLES + first : variables.OUTPUT_DOUBLES + first + len(values)] = (
            values
        )

    # -- speed, tool, payload

    @property
    def speed_fraction(self) -> float:
        """Fraction by which the speed slider slows motions."""
        fraction: float = self.values[variables.TARGET_SPEED_FRACTION]
        return fraction

    def set_speed_fraction(self, fraction: float) -> None:
        """Set the speed slider, 0 to 1."""
        self.values[variables.TARGET_SPEED_FRACTION] = max(0.0, min(1.0, fraction))

    def set_tcp(self, pose: Sequence[float]) -> None:
        """Set the tool centre point in the flange frame, x y z (m) rx ry rz (rad); raises ValueError."""
        _require_bearable(*pose)
        if self.keeps_load:
            return
        self.tcp = frame_of_pose(pose)
        self.values[_TCP_OFFSET] = pose

    def set_payload(self, mass_kg: float, centre_m: Sequence[float] | None) -> None:
        """Set the payload, at its former centre of gravity if None; raises ValueError."""
        _require_bearable(mass_kg, *(centre_m or ()))
        if self.keeps_load:
            return
        self.values[variables.PAYLOAD] = mass_kg
        if centre_m is not None:
            self.values[_COG] = centre_m

    def set_mounted_tool(self, number: int) -> None:
        """Set what the tool changer states."""
        mask = (1 << len(TOOL_INPUTS)) - 1
        inputs = self.values[variables.DIGITAL_INPUTS] & ~(mask << TOOL_INPUTS.start)
        self.values[variables.DIGITAL_INPUTS] = inputs | (number & mask) << TOOL_INPUTS.start

    # -- kinematics

    def tool_frame(self, joints_rad: Sequence[float]) -> LinkPose:
        """Return the tool centre point in the base."""
        return compose(self.kinematics.flange(joints_rad), self.tcp)

    def tool_pose(self, joints_rad: Sequence[float]) -> list[float]:
        """Return the tool centre point in the base, x y z (m) rx ry rz (rad)."""
        return pose_of_frame(self.tool_frame(joints_rad))

    def joints_at(self, tool: LinkPose, near_rad: Sequence[float]) -> list[float] | None:
        """Return the joints that bring the tool centre point there, or None if none are found."""
        return self.kinematics.joints_at(compose(tool, inverted(self.tcp)), near_rad)


def _require_bearable(*numbers: float) -> None:
    if not all(abs(number) <= LARGEST for number in numbers):  # also if one is no number
        raise ValueError(f"a number beyond {LARGEST:g}")

"""Packages of the primary, secondary and real-time interfaces, big-endian."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from struct import Struct, pack
from typing import Final
from zlib import crc32

from ronna_hw.wire import universal_robots_services as wire
from ronna_hw.wire.universal_robots import RuntimeState, SafetyMode
from ronna_hw.wire.universal_robots_services import MessageKind, PackageKind, PartKind
from sim.universal_robots.controller import (
    COMMANDED_STOP_CODE,
    PROTECTIVE_STOP_CODE,
    Controller,
)
from sim.universal_robots.kinematics import pose_of_frame
from sim.universal_robots.model import (
    ALPHA_RAD,
    JOINT_RANGE_RAD,
    JOINTS,
    LARGEST_ACCELERATION_RAD_S2,
)
from sim.universal_robots.modes import EMERGENCY
from sim.universal_robots.programs.program import ScriptPlace
from sim.universal_robots.variables import (
    DIGITAL_INPUTS,
    DIGITAL_OUTPUTS,
    PLACES,
    SPEED_SCALING,
    TARGET_SPEED_FRACTION,
)

CONTROLLER_SOURCE = -2
NO_DATA, UNSIGNED_DATA = 0, 1  # types of report data
VIOLATION_LEVEL, WARNING_LEVEL = 3, 2
WARNINGS: Final = frozenset({PROTECTIVE_STOP_CODE, COMMANDED_STOP_CODE})
MODE_BYTES: Final = {"38": (0, b""), "46": (1, b""), "47": (1, b"\0")}  # with limit of the speed, and padding
CALIBRATION_LINEARISED = 2
MAIN_VOLTAGE, CONTROLLER_TEMPERATURE = 48.0, 30.0
MICROSECONDS = 1e6
DEFAULT_SPEEDS = (1.05, 1.4, 0.25, 1.2, 0.01)  # joint v, a; tool v, a; radius that counts for turns
PROJECT_NAME = "URControl"
BUILD_DATE = "Jan 01 2026, 00:00:00"
_REALTIME_LEAD: Final = Struct(">i")
_JOINT: Final = Struct(wire.JOINT_PART)
_UNUSED: Final = (0.0,) * JOINTS


def _part(kind: int, payload: bytes) -> bytes:
    return pack(wire.PART_HEADER, len(payload) + 5, kind) + payload


def _message(kind: int, cycles_us: int, payload: bytes) -> bytes:
    body = pack(wire.MESSAGE_HEADER, cycles_us, CONTROLLER_SOURCE, kind) + payload
    return pack(wire.PACKAGE_HEADER, len(body) + 5, PackageKind.MESSAGE) + body


class StatePackages:
    """Builds the packages that describe a controller."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._fixed = self._kinematics() + self._configuration()
        doubles = controller.model.realtime_doubles
        self._realtime = Struct(f">{doubles}d")
        self._realtime_size = _REALTIME_LEAD.pack(4 + self._realtime.size)

    @property
    def _now_us(self) -> int:
        return round(self._controller.cycles * self._controller.model.cycle_s * MICROSECONDS)

    # -- messages

    def version(self) -> bytes:
        """Return the message that a new client gets first."""
        major, minor, bugfix, build = self._controller.model.version
        name = PROJECT_NAME.encode()
        payload = bytes([len(name)]) + name + pack(">BBii", major, minor, bugfix, build) + BUILD_DATE.encode()
        return _message(MessageKind.VERSION, self._now_us, payload)

    def key(self, title: str, text: str) -> bytes:
        """Return a key message, such as that a program has started."""
        name = title.encode()
        payload = pack(">ii", 0, 0) + bytes([len(name)]) + name + text.encode()
        return _message(MessageKind.KEY, self._now_us, payload)

    def safety_mode(self, mode: SafetyMode) -> bytes:
        """Return the message of a changed safety mode."""
        return _message(
            MessageKind.SAFETY_MODE, self._now_us, pack(">iiBII", 0, 0, mode.value, UNSIGNED_DATA, 0)
        )

    def error(self, code: int, text: str) -> bytes:
        """Return an error message, C and a number."""
        level = WARNING_LEVEL if code in WARNINGS else VIOLATION_LEVEL
        payload = pack(">iiiII", code, 0, level, NO_DATA, 0) + text.encode()
        return _message(MessageKind.ERROR, self._now_us, payload)

    def runtime_exception(self, text: str, place: ScriptPlace) -> bytes:
        """Return the message of a program that failed there."""
        return _message(MessageKind.RUNTIME_EXCEPTION, self._now_us, pack(">ii", *place) + text.encode())

    def text(self, text: str) -> bytes:
        """Return the message of a text that a program has told."""
        return _message(MessageKind.TEXT, self._now_us, text.encode())

    # -- robot state

    def state(self) -> bytes:
        """Return the robot state."""
        parts = self._mode() + self._joints() + self._masterboard() + self._cartesian() + self._fixed
        return pack(wire.PACKAGE_HEADER, len(parts) + 5, PackageKind.ROBOT_STATE) + parts

    def _mode(self) -> bytes:
        controller = self._controller
        modes, values = controller.modes, controller.robot.values
        has_limit, padding = MODE_BYTES[controller.parameters.robot_mode_bytes]
        payload = pack(
            wire.MODE_PART,
            self._now_us,
            True,
            True,
            modes.is_powered,
            modes.safety_mode in EMERGENCY,
            modes.safety_mode is SafetyMode.PROTECTIVE_STOP,
            controller.is_running,
            controller.runtime_state is RuntimeState.PAUSED,
            max(0, modes.robot_mode.value),
            0,
            values[TARGET_SPEED_FRACTION],
            values[SPEED_SCALING],
        )
        if has_limit:
            payload += pack(">d", 1.0)
        return _part(PartKind.MODE, payload + padding)

    def _joints(self) -> bytes:
        drives, values = self._controller.robot.drives, self._controller.robot.values
        current, warmth = values[PLACES["actual_current"]], values[PLACES["joint_temperatures"]]
        mode = values[PLACES["joint_mode"]]
        joints = zip(drives.actual, drives.target, drives.actual_speed, current, warmth, mode, strict=True)
        return _part(
            PartKind.JOINTS,
            b"".join(
                _JOINT.pack(actual, target, speed, amps, MAIN_VOLTAGE, celsius, 0.0, state)
                for actual, target, speed, amps, celsius, state in joints
            ),
        )

    def _masterboard(self) -> bytes:
        values = self._controller.robot.values
        payload = pack(
            wire.MASTERBOARD_PART,
            values[DIGITAL_INPUTS] & 0xFFFFFFFF,
            values[DIGITAL_OUTPUTS] & 0xFFFFFFFF,
            0,
            0,
            values[PLACES["standard_analog_input0"].start],
            values[PLACES["standard_analog_input1"].start],
            0,
            0,
            values[PLACES["standard_analog_output0"].start],
            values[PLACES["standard_analog_output1"].start],
            CONTROLLER_TEMPERATURE,
            MAIN_VOLTAGE,
            0.0,
            0.0,
            self._controller.modes.safety_mode.value,
        )
        is_reduced = self._controller.modes.safety_mode is SafetyMode.REDUCED
        remote = not self._controller.modes.local
        return _part(PartKind.MASTERBOARD, payload + pack(">BBIBBB", is_reduced, 0, 0, remote, 0, 0))

    def _cartesian(self) -> bytes:
        robot = self._controller.robot
        pose = robot.tool_pose(robot.drives.actual)
        return _part(PartKind.CARTESIAN, pack(">12d", *pose, *pose_of_frame(robot.tcp)))

    def _kinematics(self) -> bytes:
        kinematics = self._controller.robot.kinematics
        columns = (kinematics.theta_rad, kinematics.a_m, kinematics.d_m, kinematics.alpha_rad)
        checksums = [hash_joint(*(column[joint] for column in columns)) for joint in range(JOINTS)]
        numbers = chain.from_iterable(columns)
        payload = pack(wire.KINEMATICS_PART, *checksums, *numbers, CALIBRATION_LINEARISED)
        return _part(PartKind.KINEMATICS, payload)

    def _configuration(self) -> bytes:
        model = self._controller.model
        payload = pack(">12d", *(-JOINT_RANGE_RAD, JOINT_RANGE_RAD) * JOINTS)
        limits = ((speed, LARGEST_ACCELERATION_RAD_S2) for speed in model.full_speed_rad_s)
        payload += pack(">12d", *chain.from_iterable(limits))
        payload += pack(">5d", *DEFAULT_SPEEDS)
        for column in (model.a_m, model.d_m, ALPHA_RAD, _UNUSED):
            payload += pack(">6d", *column)
        return _part(
            PartKind.CONFIGURATION, payload + pack(">4i", 0, model.controller_box, model.robot_type, 0)
        )

    # -- real-time interface

    def realtime(self) -> bytes:
        """Return the package of the real-time interface."""
        controller = self._controller
        values, modes = controller.robot.values, controller.modes

        def fields(names: str) -> Iterator[float]:
            return chain.from_iterable(values[PLACES[name]] for name in names.split())

        numbers = [
            *fields(
                "timestamp target_q target_qd target_qdd target_current target_moment actual_q actual_qd"
            ),
            *fields("actual_current joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force"),
            *fields("target_TCP_pose target_TCP_speed actual_digital_input_bits joint_temperatures"),
            *fields("actual_execution_time"),
            0.0,
            modes.robot_mode.value,
            *fields("joint_mode"),
            modes.safety_mode.value,
            *_UNUSED,
            *fields("actual_tool_accelerometer"),
            *_UNUSED,
            *fields("speed_scaling actual_momentum"),
            *(0.0,) * 2,
            *fields("actual_main_voltage actual_robot_voltage actual_robot_current actual_joint_voltage"),
            *fields("actual_digital_output_bits"),
            controller.runtime_state.value,
            *_UNUSED,  # place and velocity of the elbow
            modes.safety_mode.value,
            *(0.0,) * 3,
            *fields("payload payload_cog payload_inertia"),
        ]
        doubles = controller.model.realtime_doubles
        return self._realtime_size + self._realtime.pack(*numbers[:doubles])


def hash_joint(theta: float, a: float, d: float, alpha: float) -> int:
    """Return a checksum of one joint's parameters; how the vendor computes it is not public (U)."""
    return crc32(pack(">4d", theta, a, d, alpha))

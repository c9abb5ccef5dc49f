"""Simulated controller: modes, the running program, and what clients are told.

It owns neither socket nor clock.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Final

from ronna_hw.wire.universal_robots import RobotMode, RobotStatus, RuntimeState, SafetyMode
from sim.universal_robots.controller_parameters import ControllerParameters
from sim.universal_robots.kinematics import TrueKinematics
from sim.universal_robots.loads import Loads
from sim.universal_robots.model import HOME_RAD, JOINTS, Model
from sim.universal_robots.modes import BROKEN, EMERGENCY, Modes
from sim.universal_robots.programs.outgoing import Outgoing
from sim.universal_robots.programs.program import FIRST_PLACE, ScriptPlace, UrProgram
from sim.universal_robots.robot import COMMANDED_STOP, Robot
from sim.universal_robots.variables import (
    PLACES,
    ROBOT_MODE,
    ROBOT_STATUS,
    RUNTIME_STATE,
    SAFETY_BITS,
    SAFETY_MODE,
    SAFETY_STATUS,
    TIMESTAMP,
)

_TARGET_Q, _TARGET_QD, _TARGET_QDD = PLACES["target_q"], PLACES["target_qd"], PLACES["target_qdd"]
_ACTUAL_Q, _ACTUAL_QD = PLACES["actual_q"], PLACES["actual_qd"]
_TARGET_POSE, _ACTUAL_POSE = PLACES["target_TCP_pose"], PLACES["actual_TCP_pose"]
_TARGET_VELOCITY, _ACTUAL_VELOCITY = PLACES["target_TCP_speed"], PLACES["actual_TCP_speed"]
POSES: Final = frozenset({"target_TCP_pose", "actual_TCP_pose", "target_TCP_speed", "actual_TCP_speed"})
JOINT_RUNNING, JOINT_POWER_OFF, JOINT_IDLE = 253, 239, 255  # joint_mode

LONGEST_TOLD: Final = 200  # characters of a name or a failure, which may quote any script (U)
STARTED, STOPPED, PAUSED, RESUMED = "STARTED", "STOPPED", "PAUSED", "RESUMED"  # news of a program


class News:
    """Listeners of the client interfaces: functions to call for each kind of report."""

    def __init__(self) -> None:
        self.program: list[Callable[[str, str], None]] = []  # what happened, name
        self.safety: list[Callable[[SafetyMode], None]] = []
        self.failure: list[Callable[[str, ScriptPlace], None]] = []  # runtime exception
        self.text: list[Callable[[str], None]] = []  # of a program
        self.error: list[Callable[[int, str], None]] = []  # number, text

    def tell_failure(self, text: str, place: ScriptPlace = FIRST_PLACE) -> None:
        """Tell of a program that failed."""
        for tell in self.failure:
            tell(text[:LONGEST_TOLD], place)

    def tell_program(self, what: str, name: str) -> None:
        """Report a program."""
        for tell in self.program:
            tell(what, name[:LONGEST_TOLD])


class Controller:
    """Universal Robots controller with one arm and at most one program."""

    def __init__(
        self,
        model: Model,
        parameters: ControllerParameters,
        kinematics: TrueKinematics | None = None,
        start_rad: Sequence[float] = HOME_RAD,
        seed: int = 0,
    ) -> None:
        self.model = model = model.with_software(parameters.software)
        self.parameters = parameters
        self.robot = Robot(model, parameters, kinematics or TrueKinematics(model), start_rad)
        self.loads = Loads(self.robot, seed)
        self.modes = Modes(parameters, model.cycle_s)
        self.news = News()
        self.program: UrProgram | None = None
        self.loaded = ""  # name of the program that the dashboard loaded
        self.runtime_state = RuntimeState.STOPPED
        self.cycles = 0
        self.popup = ""
        self.shows_poses = True  # some client reads poses or speeds of the tool
        self.watched: Callable[[], int] = lambda: 0  # writes to the input that the program's watchdog watches
        self._watch_writes = self._watch_cycles = 0
        self._steps: Iterator[None] | None = None
        self._safety_mode = self.modes.safety_mode
        self._published: object = None  # joints at rest
        self._poses_are_old = True
        self._reaction = 0  # cycles until a stop begins to brake
        self._state: tuple[object, ...] = ()
        self.publish()

    # -- programs

    @property
    def may_run(self) -> str:
        """Reason why no program can start, or an empty string."""
        if self.modes.robot_mode is not RobotMode.RUNNING:
            return f"the robot is in mode {self.modes.robot_mode.name}"
        if not self.modes.may_move:
            return f"safety mode {self.modes.safety_mode.name}"
        return ""

    @property
    def is_running(self) -> bool:
        """Whether a program is running, starting or stopping."""
        return self.runtime_state not in (RuntimeState.STOPPED, RuntimeState.PAUSED)

    @property
    def links(self) -> list[Outgoing]:
        """Connections that the program has opened."""
        return self.program.links if self.program else []

    def start(self, program: UrProgram) -> str:
        """Start a program in place of the present one; returns why not, or an empty string."""
        forbidden = self.may_run
        if forbidden:
            return forbidden
        self.stop()
        self.program = program
        self._steps = program.steps(self.robot, program)
        self._watch_writes = self._watch_cycles = 0
        self.runtime_state = RuntimeState.PLAYING
        self.news.tell_program(STARTED, program.name)
        return ""

    def stop(self) -> None:
        """Stop the program; the arm brakes."""
        program, self.program = self.program, None
        self._steps = None
        if program is None:
            return
        program.awaits_client = False
        for link in program.links:
            link.close()
        self.runtime_state = RuntimeState.STOPPING
        if program.failure:
            self.news.tell_failure(program.failure)
        self.news.tell_program(STOPPED, program.name)

    def pause(self) -> bool:
        """Pause the program; returns whether there was one to pause."""
        if self.program is None or self.runtime_state in (RuntimeState.PAUSED, RuntimeState.PAUSING):
            return False
        self.runtime_state = RuntimeState.PAUSING
        self.program.awaits_client = False
        self.news.tell_program(PAUSED, self.program.name)
        return True

    def resume(self) -> bool:
        """Resume a paused program; returns whether that is possible."""
        if self.may_run or self.runtime_state not in (RuntimeState.PAUSING, RuntimeState.PAUSED):
            return False
        assert self.program is not None
        self.runtime_state = RuntimeState.RESUMING
        self.news.tell_program(RESUMED, self.program.name)
        return True

    # -- power and stops

    def power_off(self) -> None:
        """Stop the program and switch off the power of the arm."""
        self.stop()
        self.modes.power_off()

    def protective_stop(self, reason: str) -> None:
        """Stop the arm, as after a collision."""
        if self.modes.safety_mode is not SafetyMode.PROTECTIVE_STOP:
            code = COMMANDED_STOP_CODE if reason == COMMANDED_STOP else PROTECTIVE_STOP_CODE
            for tell in self.news.error:
                tell(code, reason)
        self.hold(SafetyMode.PROTECTIVE_STOP)

    def hold(self, mode: SafetyMode, *, holds: bool = True) -> None:
        """Begin or end a condition of the safety system."""
        self.modes.hold(mode, holds=holds)
        self._follow_safety()

    def unlock_protective_stop(self) -> bool:
        """Unlock a protective stop; returns whether it is old enough."""
        unlocked = self.modes.unlock_protective_stop()
        if unlocked:
            self._follow_safety()
        return unlocked

    def _follow_safety(self) -> None:
        """Do to the program what a changed safety mode does."""
        before, mode = self._safety_mode, self.modes.safety_mode
        if mode is before:
            return
        self._safety_mode = mode
        for tell in self.news.safety:
            tell(mode)
        if mode in EMERGENCY or mode in BROKEN:
            self._reaction = round(self.parameters.stop_reaction_s / self.model.cycle_s)
            self.stop()
        elif mode is SafetyMode.PROTECTIVE_STOP and self.parameters.after_protective_stop == "stopped":
            self.stop()
        elif mode in (SafetyMode.PROTECTIVE_STOP, SafetyMode.SAFEGUARD_STOP):
            self._reaction = round(self.parameters.stop_reaction_s / self.model.cycle_s)
            self.pause()
        elif self.modes.may_move and (
            (before is SafetyMode.SAFEGUARD_STOP and self.parameters.after_safeguard == "resumes")
            or (before is SafetyMode.PROTECTIVE_STOP and self.parameters.after_unlock == "resumes")
        ):
            self.resume()

    # -- the cycle

    def step(self) -> None:
        """Run one control cycle."""
        self.cycles += 1
        robot, modes = self.robot, self.modes
        modes.step()
        if modes.safety_mode is not self._safety_mode:
            self._follow_safety()
        drives = robot.drives
        served = drives.served
        if self.runtime_state is RuntimeState.PLAYING:
            self._run_program()
        if robot.told:
            self._tell_texts()
        if drives.served == served:
            self._brake()
        loads = self.loads
        loads.follow()
        if drives.trip or robot.stop_request or loads.trip:
            reason = drives.trip or robot.stop_request or loads.trip
            drives.trip = robot.stop_request = loads.trip = ""
            self.protective_stop(reason)
        self._settle_state()
        self.publish()

    def _run_program(self) -> None:
        program, steps = self.program, self._steps
        assert program is not None
        assert steps is not None
        if not self.modes.may_move:  # power was switched off
            self.stop()
            return
        if not self._watchdog_allows(program):
            return
        try:
            next(steps)
        except StopIteration:
            self.stop()
        except (ArithmeticError, ValueError) as error:  # numbers of a client with which it cannot compute
            program.failure = str(error)
            self.stop()

    def _tell_texts(self) -> None:
        texts, self.robot.told = self.robot.told, []
        for text in texts:
            for tell in self.news.text:
                tell(text[:LONGEST_TOLD])

    def _watchdog_allows(self, program: UrProgram) -> bool:
        watchdog = program.watchdog
        if watchdog is None:
            return True
        writes = self.watched()
        if writes != self._watch_writes:
            self._watch_writes, self._watch_cycles = writes, 0
            return True
        self._watch_cycles += 1
        if self._watch_cycles <= watchdog.cycles or watchdog.action == "ignore":
            return True
        if watchdog.action == "pause":
            self.pause()
        else:
            self.stop()
        return False

    def _brake(self) -> None:
        """Brake as the safety mode asks for; without power the brakes hold the arm."""
        drives, mode = self.robot.drives, self.modes.safety_mode
        if not self.modes.is_powered:
            drives.brake(float("inf"))
            return
        if self._reaction > 0 and drives.moving:
            self._reaction -= 1
            drives.coast()
            return
        if mode in EMERGENCY or mode in BROKEN:
            drives.brake(self.parameters.emergency_stop_rad_s2)
        elif mode in (SafetyMode.PROTECTIVE_STOP, SafetyMode.SAFEGUARD_STOP):
            drives.brake(self.parameters.protective_stop_rad_s2)
        else:
            drives.brake(self.parameters.program_stop_rad_s2)

    def _settle_state(self) -> None:
        if self.runtime_state is RuntimeState.STOPPING and not self.robot.drives.moving:
            self.runtime_state = RuntimeState.STOPPED
        elif self.runtime_state is RuntimeState.PAUSING and not self.robot.drives.moving:
            self.runtime_state = RuntimeState.PAUSED
        elif self.runtime_state is RuntimeState.RESUMING:
            self.runtime_state = RuntimeState.PLAYING

    # -- variables

    def publish(self) -> None:
        """Write what has changed to the variables."""
        values, drives, modes = self.robot.values, self.robot.drives, self.modes
        values[TIMESTAMP] = self.cycles * self.model.cycle_s
        state = (modes.robot_mode, modes.safety_mode, self.runtime_state)
        if state != self._state:
            self._state = state
            self._publish_state()
        rests_at = drives.target if drives.at_rest else None
        if rests_at is None or rests_at is not self._published:
            self._published = rests_at
            values[_TARGET_Q], values[_TARGET_QD] = drives.target, drives.target_speed
            values[_TARGET_QDD] = drives.target_acceleration
            values[_ACTUAL_Q], values[_ACTUAL_QD] = drives.actual, drives.actual_speed
            self._poses_are_old = True
        if self.shows_poses and self._poses_are_old:
            self._poses_are_old = False
            self.publish_poses()

    def _publish_state(self) -> None:
        values, modes = self.robot.values, self.modes
        values[ROBOT_MODE] = modes.robot_mode.value
        values[SAFETY_MODE] = values[SAFETY_STATUS] = modes.safety_mode.value
        values[SAFETY_BITS] = modes.safety_bits
        values[RUNTIME_STATE] = self.runtime_state.value
        bits = RobotStatus.POWER_ON if modes.is_powered else RobotStatus(0)
        if self.is_running:
            bits |= RobotStatus.PROGRAM_RUNNING
        values[ROBOT_STATUS] = bits.value
        joint_mode = JOINT_POWER_OFF
        if modes.is_powered:
            joint_mode = JOINT_RUNNING if modes.robot_mode is RobotMode.RUNNING else JOINT_IDLE
        values[PLACES["joint_mode"]] = [joint_mode] * JOINTS

    def publish_poses(self) -> None:
        """Write the poses and velocities of the tool centre point."""
        robot = self.robot
        values, drives = robot.values, robot.drives
        target = values[_TARGET_POSE] = robot.tool_pose(drives.target)
        values[_ACTUAL_POSE] = target if drives.at_rest else robot.tool_pose(drives.actual)
        if drives.at_rest:
            values[_TARGET_VELOCITY] = values[_ACTUAL_VELOCITY] = [0.0] * JOINTS
            return
        jacobian = robot.kinematics.jacobian(drives.target, robot.tcp)
        values[_TARGET_VELOCITY] = (jacobian @ drives.target_speed).tolist()
        values[_ACTUAL_VELOCITY] = (jacobian @ drives.actual_speed).tolist()


PROTECTIVE_STOP_CODE = 153  # position deviates from path (U: the cause is ours)
COMMANDED_STOP_CODE = 209  # a program has triggered a protective stop

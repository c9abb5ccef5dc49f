"""Power and safety of the arm: robot mode, safety mode, and the time that each change takes."""

from __future__ import annotations

from collections import deque
from typing import Final

from ronna_hw.wire.universal_robots import RobotMode, SafetyMode, SafetyStatus
from sim.universal_robots.controller_parameters import ControllerParameters

POWERED: Final = frozenset({RobotMode.IDLE, RobotMode.BACKDRIVE, RobotMode.RUNNING})
MAY_MOVE: Final = frozenset({SafetyMode.NORMAL, SafetyMode.REDUCED})
EMERGENCY: Final = frozenset({SafetyMode.SYSTEM_EMERGENCY_STOP, SafetyMode.ROBOT_EMERGENCY_STOP})
BROKEN: Final = frozenset({SafetyMode.VIOLATION, SafetyMode.FAULT})

_BITS: Final = {
    SafetyMode.NORMAL: SafetyStatus.NORMAL,
    SafetyMode.REDUCED: SafetyStatus.REDUCED,
    SafetyMode.PROTECTIVE_STOP: SafetyStatus.PROTECTIVE_STOPPED,
    SafetyMode.RECOVERY: SafetyStatus.RECOVERY,
    SafetyMode.SAFEGUARD_STOP: SafetyStatus.SAFEGUARD_STOPPED,
    SafetyMode.SYSTEM_EMERGENCY_STOP: SafetyStatus.SYSTEM_EMERGENCY_STOPPED | SafetyStatus.EMERGENCY_STOPPED,
    SafetyMode.ROBOT_EMERGENCY_STOP: SafetyStatus.ROBOT_EMERGENCY_STOPPED | SafetyStatus.EMERGENCY_STOPPED,
    SafetyMode.VIOLATION: SafetyStatus.VIOLATION,
    SafetyMode.FAULT: SafetyStatus.FAULT,
}
_STOPPED: Final = frozenset(_BITS) - {SafetyMode.NORMAL, SafetyMode.REDUCED, SafetyMode.RECOVERY}
# The first of these that holds is the mode.
_PRECEDENCE: Final = (
    SafetyMode.FAULT,
    SafetyMode.VIOLATION,
    SafetyMode.ROBOT_EMERGENCY_STOP,
    SafetyMode.SYSTEM_EMERGENCY_STOP,
    SafetyMode.PROTECTIVE_STOP,
    SafetyMode.SAFEGUARD_STOP,
    SafetyMode.REDUCED,
)


class Modes:
    """Robot mode and safety mode, advanced once per cycle."""

    def __init__(self, parameters: ControllerParameters, cycle_s: float) -> None:
        self._parameters = parameters
        self._cycle_s = cycle_s
        self.robot_mode = RobotMode[parameters.start.upper()]
        self.safety_mode = SafetyMode.NORMAL
        self._holding: set[SafetyMode] = set()
        self._ahead: deque[tuple[int, RobotMode]] = deque()  # cycles until each mode
        self._left = 0
        self._releases = False  # brakes, once powered
        self._locked = 0  # cycles until a protective stop may be unlocked
        self._restarting = 0  # cycles until the safety system has restarted
        self.local = False

    @property
    def may_move(self) -> bool:
        """Whether the arm may move."""
        return self.robot_mode is RobotMode.RUNNING and self.safety_mode in MAY_MOVE

    @property
    def safety_bits(self) -> int:
        """Return `safety_status_bits`."""
        stopped = SafetyStatus.STOPPED_DUE_TO_SAFETY if self.safety_mode in _STOPPED else SafetyStatus(0)
        return int(_BITS[self.safety_mode] | stopped)

    @property
    def is_powered(self) -> bool:
        """Whether the joints have power."""
        return self.robot_mode in POWERED

    @property
    def is_in_transition(self) -> bool:
        """Whether something that takes a number of cycles is under way."""
        return bool(self._ahead or self._locked or self._restarting)

    def _cycles(self, duration_s: float) -> int:
        return max(1, round(duration_s / self._cycle_s))

    # -- power

    def power_on(self) -> None:
        """Begin to power on; without effect when on, or while an emergency stop or a fault holds."""
        if self.robot_mode is not RobotMode.POWER_OFF or self._ahead:
            return
        if self.safety_mode in EMERGENCY | BROKEN:
            return
        booting = self._cycles(self._parameters.power_on_s * self._parameters.booting_share)
        rest = max(1, self._cycles(self._parameters.power_on_s) - booting)
        self.robot_mode = RobotMode.BOOTING
        self._go_through((booting, RobotMode.POWER_ON), (rest, RobotMode.IDLE))

    def release_brakes(self) -> None:
        """Begin to release the brakes, powering on first."""
        self.power_on()
        if self._ahead:
            self._releases = self.robot_mode in (RobotMode.BOOTING, RobotMode.POWER_ON)
        elif self.robot_mode is RobotMode.IDLE:
            self._go_through((self._cycles(self._parameters.brake_release_s), RobotMode.RUNNING))

    def power_off(self) -> None:
        """Begin to power off."""
        self._releases = False
        if self.robot_mode is not RobotMode.POWER_OFF:
            self._go_through((self._cycles(self._parameters.power_off_s), RobotMode.POWER_OFF))

    def _go_through(self, *ahead: tuple[int, RobotMode]) -> None:
        self._ahead = deque(ahead)
        self._left = ahead[0][0]

    # -- safety

    def hold(self, mode: SafetyMode, *, holds: bool = True) -> None:
        """Begin or end a condition of the safety system, such as a pressed emergency stop."""
        if holds is (mode in self._holding):
            return
        if holds:
            self._holding.add(mode)
            if mode is SafetyMode.PROTECTIVE_STOP:
                self._locked = self._cycles(self._parameters.protective_stop_lock_s)
            elif mode in EMERGENCY or mode in BROKEN:
                self._releases = False
                if self.robot_mode is not RobotMode.POWER_OFF:
                    cycles = self._cycles(self._parameters.emergency_power_off_s)
                    self._go_through((cycles, RobotMode.POWER_OFF))
        else:
            self._holding.discard(mode)
        self.safety_mode = next((mode for mode in _PRECEDENCE if mode in self._holding), SafetyMode.NORMAL)

    def unlock_protective_stop(self) -> bool:
        """Unlock a protective stop; returns whether it is old enough."""
        if self._locked:
            return False
        self.hold(SafetyMode.PROTECTIVE_STOP, holds=False)
        return True

    def restart_safety(self) -> None:
        """Begin to restart the safety system after a violation or fault."""
        if self.safety_mode in BROKEN:
            self._restarting = self._cycles(self._parameters.restart_safety_s)

    # -- the cycle

    def step(self) -> None:
        """Advance by one cycle."""
        if self._locked:
            self._locked -= 1
        if self._restarting:
            self._restarting -= 1
            if not self._restarting:
                for mode in BROKEN:
                    self.hold(mode, holds=False)
                self.hold(SafetyMode.PROTECTIVE_STOP, holds=False)
        if not self._ahead:
            return
        self._left -= 1
        if self._left:
            return
        _, self.robot_mode = self._ahead.popleft()
        if self._ahead:
            self._left = self._ahead[0][0]
        elif self._releases and self.robot_mode is RobotMode.IDLE:
            self._releases = False
            self.release_brakes()

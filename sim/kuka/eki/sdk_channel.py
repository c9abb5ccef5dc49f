"""EKI channel of KUKA's C++ client SDK: program control by numbered requests, with status on change."""

from __future__ import annotations

import time
from enum import Enum, IntEnum
from math import inf
from xml.etree import ElementTree

from ronna_hw.wire.kuka_eki import AckCode, OperationMode, ProState
from sim.kuka.autostart import Autostart
from sim.kuka.controller import Controller
from sim.kuka.controller_parameters import SUBMIT_CYCLE_S
from sim.kuka.eki.server import EkiServer

REQUEST = "External"
INTERFACE_VERSION = "1.0.0"
MACHINE_DATA_VERSION = "V1.0.0/KUKA8.6"
FIRST_STATUS_LOOPS = 3  # the first unsolicited status waits, so that the answer to connect comes first
AXES, EXTERNAL_AXES = 6, 0


class SdkRequest(IntEnum):
    """REQTYPE values."""

    CONNECT = 0
    START = 1
    RESET = 2
    CANCEL = 3
    CHANGE_MODE = 4
    NONE = 5
    DRIVES_ON = 6
    DRIVES_OFF = 7
    CHANGE_CYCLE = 8


class SdkEvent(IntEnum):
    """EventID values in a response."""

    STARTED = 0
    STOPPED = 1
    CANCELLED = 2
    RESET_OK = 3
    ERROR = 4
    CONNECTED = 5
    MODE_SWITCHED = 6
    INVALID = 7
    NONE = 8
    DRIVES_ON = 9
    DRIVES_OFF = 10
    CYCLE_CHANGED = 11
    STATUS = 12


class SdkState(Enum):
    """State of the program serving the channel."""

    INITIALIZED = 0
    INACTIVE = 1
    ACTIVE = 2


SETTINGS = {SdkRequest.CHANGE_MODE, SdkRequest.DRIVES_ON, SdkRequest.DRIVES_OFF, SdkRequest.CHANGE_CYCLE}
ACCEPTED = {
    SdkState.INITIALIZED: {SdkRequest.CONNECT} | SETTINGS,
    SdkState.INACTIVE: {SdkRequest.START, SdkRequest.CANCEL} | SETTINGS,
    SdkState.ACTIVE: {SdkRequest.CANCEL, SdkRequest.RESET},
}
CONTROL_MODES = {1: "JOINT_POSITION_CONTROL", 5: "CARTESIAN_POSITION_CONTROL"}
CORRECTIONS = {1: "AXIS"}  # Cartesian position is selectable but no program is mapped to it
CYCLES_MS = {1: 4, 2: 12}
DEFAULT_CYCLE = 2
OPERATION_MODES = {OperationMode.T1: 1, OperationMode.T2: 2, OperationMode.AUT: 3, OperationMode.EXT: 4}


class SdkChannel:
    """Channel for one client, whose disconnection resets the program's state."""

    def __init__(self, server: EkiServer, controller: Controller, autostart: Autostart) -> None:
        self._server = server
        self._controller = controller
        self._autostart = autostart
        self._sent: tuple[int, ...] | None = None
        self._first_status_s = 0.0
        self._cycle = DEFAULT_CYCLE
        self._reset()
        server.attach(self)

    def client_connected(self) -> None:
        """Reset for a newly connected client, to which the status is sent unsolicited."""
        self._reset()
        self._sent = None
        self._first_status_s = time.monotonic() + FIRST_STATUS_LOOPS * SUBMIT_CYCLE_S

    def client_disconnected(self) -> None:
        """Reset after the client has disconnected."""
        self._reset()
        self._autostart.arm()
        self._controller.handle_eki_loss()

    def request(self, element: ElementTree.Element) -> None:
        """Answer a request with a single response."""
        if element.tag != REQUEST:
            return
        try:
            request = SdkRequest(int(element.get("REQTYPE", "")))
            control_mode = int(element.get("ControlMode", "0"))
            cycle = int(element.get("CycleTime", "0"))
        except ValueError:
            self._respond(SdkEvent.INVALID)
            return
        if request is SdkRequest.NONE:
            return
        if request not in ACCEPTED[self._state]:
            self._respond(SdkEvent.INVALID)
        elif request is SdkRequest.CONNECT:
            self._server.send(
                f"<Robot>{_compose_response(SdkEvent.CONNECTED)}{self._compose_status()}{self._compose_init()}</Robot>"
            )
        elif request is SdkRequest.CHANGE_MODE:
            self._change_mode(control_mode)
        elif request is SdkRequest.CHANGE_CYCLE:
            self._respond(SdkEvent.CYCLE_CHANGED if cycle in CYCLES_MS else SdkEvent.ERROR)
            self._cycle = cycle if cycle in CYCLES_MS else self._cycle
        else:
            self._respond(self._command(request))
        # The status reports what has changed one loop later.

    def tick(self, now_s: float) -> float:
        """Send the status if it has changed, and return the time of the next call."""
        if not self._server.connected:
            return inf
        again_s = now_s + SUBMIT_CYCLE_S
        if self._server.writes_later or now_s < self._first_status_s:
            return again_s
        values = self._collect_values()
        if values != self._sent:
            self._sent = values
            self._server.send(f"<Robot>{self._compose_status()}</Robot>")
        return again_s

    def _command(self, request: SdkRequest) -> SdkEvent:
        controller = self._controller
        if request is SdkRequest.DRIVES_ON:
            if controller.message is not None:
                controller.acknowledge()
            return SdkEvent.DRIVES_ON if controller.switch_drives(True).code is AckCode.OK else SdkEvent.ERROR
        if request is SdkRequest.DRIVES_OFF:
            controller.switch_drives(False)
            return SdkEvent.DRIVES_OFF
        if request is SdkRequest.START:
            return self._start()
        # CANCEL and RESET both end the program; they differ in the state that follows.
        self._autostart.disarm()
        if controller.acknowledge().code is not AckCode.OK:
            return SdkEvent.ERROR
        if request is SdkRequest.RESET:
            self._state = SdkState.INACTIVE
            return SdkEvent.RESET_OK
        self._reset(keep_cycle=True)
        return SdkEvent.CANCELLED

    def _start(self) -> SdkEvent:
        correction = CORRECTIONS.get(self._control_mode)
        controller = self._controller
        if correction is None or controller.interlocks.mode is not OperationMode.EXT:
            return SdkEvent.ERROR
        self._autostart.yield_to_client()
        if controller.run is None and controller.program_state is not ProState.FREE:
            controller.acknowledge()
        if controller.start(CYCLES_MS[self._cycle], False, correction).code is not AckCode.OK:
            return SdkEvent.ERROR
        self._state = SdkState.ACTIVE
        return SdkEvent.STARTED

    def _change_mode(self, control_mode: int) -> None:
        if control_mode not in CONTROL_MODES:
            self._respond(SdkEvent.ERROR)
            return
        self._control_mode = control_mode
        self._state = SdkState.INACTIVE
        self._respond(SdkEvent.MODE_SWITCHED, CONTROL_MODES[control_mode])

    def _reset(self, *, keep_cycle: bool = False) -> None:
        self._state = SdkState.INITIALIZED
        self._control_mode = 0
        if not keep_cycle:
            self._cycle = DEFAULT_CYCLE

    def _respond(self, event: SdkEvent, text: str = " ") -> None:
        self._server.send(f"<Robot>{_compose_response(event, text)}</Robot>")

    def _collect_values(self) -> tuple[int, ...]:
        controller = self._controller
        return (
            self._control_mode,
            self._cycle,
            int(controller.drives_on),
            int(controller.interlocks.emergency_stop),
            int(controller.interlocks.guard_open),
            int(controller.moving),
            int(controller.may_move and controller.program_state is ProState.ACTIVE),
            OPERATION_MODES[controller.interlocks.mode],
            int(controller.message is not None),
        )

    def _compose_status(self) -> str:
        mode, cycle, drives, stop, guard, motion, possible, operation, stopped = self._collect_values()
        return (
            f'<Status ControlMode="{mode}" CycleTime="{cycle}" DrivesPowered="{drives}"'
            f' EmergencyStop="{stop}" GuardStop="{guard}" InMotion="{motion}" MotionPossible="{possible}"'
            f' OperationMode="{operation}" RobotStopped="{stopped}"></Status>'
        )

    def _compose_init(self) -> str:
        return (
            f'<Init VER="{INTERFACE_VERSION}" NumAxes="{AXES}" NumExternalAxes="{EXTERNAL_AXES}"'
            f' Model="{self._controller.arm.description.model}" RobVer="{MACHINE_DATA_VERSION}"></Init>'
        )


def _compose_response(event: SdkEvent, text: str = " ") -> str:
    return f'<Response EventID="{event.value}">{text}</Response>'

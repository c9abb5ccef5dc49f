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


class Request(IntEnum):
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


class Event(IntEnum):
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


class State(Enum):
    """State of the program serving the channel."""

    INITIALIZED = 0
    INACTIVE = 1
    ACTIVE = 2


SETTINGS = {Request.CHANGE_MODE, Request.DRIVES_ON, Request.DRIVES_OFF, Request.CHANGE_CYCLE}
ACCEPTED = {
    State.INITIALIZED: {Request.CONNECT} | SETTINGS,
    State.INACTIVE: {Request.START, Request.CANCEL} | SETTINGS,
    State.ACTIVE: {Request.CANCEL, Request.RESET},
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
            request = Request(int(element.get("REQTYPE", "")))
            control_mode = int(element.get("ControlMode", "0"))
            cycle = int(element.get("CycleTime", "0"))
        except ValueError:
            self._respond(Event.INVALID)
            return
        if request is Request.NONE:
            return
        if request not in ACCEPTED[self._state]:
            self._respond(Event.INVALID)
        elif request is Request.CONNECT:
            self._server.send(
                f"<Robot>{_compose_response(Event.CONNECTED)}{self._compose_status()}{self._compose_init()}</Robot>"
            )
        elif request is Request.CHANGE_MODE:
            self._change_mode(control_mode)
        elif request is Request.CHANGE_CYCLE:
            self._respond(Event.CYCLE_CHANGED if cycle in CYCLES_MS else Event.ERROR)
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

    def _command(self, request: Request) -> Event:
        controller = self._controller
        if request is Request.DRIVES_ON:
            if controller.message is not None:
                controller.acknowledge()
            return Event.DRIVES_ON if controller.switch_drives(True).code is AckCode.OK else Event.ERROR
        if request is Request.DRIVES_OFF:
            controller.switch_drives(False)
            return Event.DRIVES_OFF
        if request is Request.START:
            return self._start()
        # CANCEL and RESET both end the program; they differ in the state that follows.
        self._autostart.disarm()
        if controller.acknowledge().code is not AckCode.OK:
            return Event.ERROR
        if request is Request.RESET:
            self._state = State.INACTIVE
            return Event.RESET_OK
        self._reset(keep_cycle=True)
        return Event.CANCELLED

    def _start(self) -> Event:
        correction = CORRECTIONS.get(self._control_mode)
        controller = self._controller
        if correction is None or controller.interlocks.mode is not OperationMode.EXT:
            return Event.ERROR
        self._autostart.yield_to_client()
        if controller.run is None and controller.program_state is not ProState.FREE:
            controller.acknowledge()
        if controller.start(CYCLES_MS[self._cycle], False, correction).code is not AckCode.OK:
            return Event.ERROR
        self._state = State.ACTIVE
        return Event.STARTED

    def _change_mode(self, control_mode: int) -> None:
        if control_mode not in CONTROL_MODES:
            self._respond(Event.ERROR)
            return
        self._control_mode = control_mode
        self._state = State.INACTIVE
        self._respond(Event.MODE_SWITCHED, CONTROL_MODES[control_mode])

    def _reset(self, *, keep_cycle: bool = False) -> None:
        self._state = State.INITIALIZED
        self._control_mode = 0
        if not keep_cycle:
            self._cycle = DEFAULT_CYCLE

    def _respond(self, event: Event, text: str = " ") -> None:
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


def _compose_response(event: Event, text: str = " ") -> str:
    return f'<Response EventID="{event.value}">{text}</Response>'

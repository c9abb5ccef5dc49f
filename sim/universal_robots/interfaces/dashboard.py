"""Dashboard: lines of text, one answer each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from ronna_hw.wire import universal_robots_services as wire
from ronna_hw.wire.universal_robots import DASHBOARD_PORT, RuntimeState
from ronna_hw.wire.universal_robots_services import DashboardOrder, Query
from sim.universal_robots.connections import ClientConnection, Handler, HangUp, Poll, ServiceListener
from sim.universal_robots.controller import Controller
from sim.universal_robots.interfaces.state_packages import BUILD_DATE
from sim.universal_robots.programs.program import UrProgram
from sim.universal_robots.programs.recognition import endless, requested_program

LONGEST_LINE = 1000
PROGRAM_FOLDER = "/programs/"
EXTERNAL_CONTROL: Final = "external_control"  # begins the names of programs that request their script
TOO_EARLY: Final = (
    "Cannot unlock protective stop until 5s after occurrence. "
    "Always inspect cause of protective stop before unlocking"
)
NO_MODE, NO_ROLE = "NONE", "NONE"
OPERATIONAL_MODES: Final = ("MANUAL", "AUTOMATIC")  # stated only (U)
USER_ROLES: Final = ("PROGRAMMER", "OPERATOR", NO_ROLE, "LOCKED", "RESTRICTED")  # of CB3, stated only (U)
REPORT_ID, SUPPORT_FILE = 1, "ur_support_file.zip"  # named, not written (U)
NOT_ALLOWED: Final = "Command is not allowed due to safety reasons"  # in local mode (U)
STATES: Final = {
    RuntimeState.PLAYING: "PLAYING",
    RuntimeState.RESUMING: "PLAYING",
    RuntimeState.PAUSING: "PAUSED",
    RuntimeState.PAUSED: "PAUSED",
    RuntimeState.STOPPING: "STOPPED",
    RuntimeState.STOPPED: "STOPPED",
}


class Dashboard:
    """Carries out the commands of any number of clients."""

    def __init__(self, controller: Controller, address: str, poll: Poll) -> None:
        self._controller = controller
        self.silent = False  # fault: nothing is answered
        self._operational_mode = NO_MODE
        self._user_role = NO_ROLE
        orders: dict[DashboardOrder, Callable[[], object]] = {
            DashboardOrder.POWER_ON: controller.modes.power_on,
            DashboardOrder.POWER_OFF: controller.power_off,
            DashboardOrder.BRAKE_RELEASE: controller.modes.release_brakes,
            DashboardOrder.CLOSE_SAFETY_POPUP: lambda: None,
            DashboardOrder.RESTART_SAFETY: controller.modes.restart_safety,
            DashboardOrder.STOP: controller.stop,
        }
        self._commands: dict[str, Callable[[str], str]] = {
            Query.ROBOT_MODE: lambda _: f"{wire.ROBOT_MODE_HEAD} {controller.modes.robot_mode.name}",
            Query.SAFETY_MODE: lambda _: f"{wire.SAFETY_MODE_HEAD} {controller.modes.safety_mode.name}",
            "safetystatus": lambda _: f"Safetystatus: {controller.modes.safety_mode.name}",
            "polyscopeversion": lambda _: f"URSoftware {controller.model.version_text} ({BUILD_DATE[:11]})",
            "version": lambda _: controller.model.version_text,
            Query.SERIAL_NUMBER: lambda _: str(controller.parameters.serial_number),
            Query.ROBOT_MODEL: lambda _: controller.model.dashboard_name,
            Query.REMOTE_CONTROL: lambda _: str(not controller.modes.local).lower(),
            Query.RUNNING: lambda _: (
                f"{wire.RUNNING_HEAD} {str(STATES[controller.runtime_state] == 'PLAYING').lower()}"
            ),
            "programstate": lambda _: f"{STATES[controller.runtime_state]} {controller.loaded or 'null'}",
            "get loaded program": self._get_loaded,
            **{order: _accepting(order, do) for order, do in orders.items()},
            DashboardOrder.UNLOCK_PROTECTIVE_STOP: self._unlock,
            "close popup": lambda _: "closing popup",
            "popup": self._popup,
            "play": self._play,
            "pause": self._pause,
            "load": self._load,
            "isprogramsaved": lambda _: f"true {controller.loaded}" if controller.loaded else "false",
            "load installation": lambda name: f"Loading installation: {name}",
            "get operational mode": lambda _: self._operational_mode,
            "set operational mode": self._set_operational_mode,
            "clear operational mode": self._clear_operational_mode,
            "getuserrole": lambda _: self._user_role,
            "setuserrole": self._set_user_role,
            Query.ADD_TO_LOG.lower(): lambda _: "Added log message",
            "savelog": lambda _: "Log saved to disk",
            "generate flight report": lambda _: f"Flight Report generated with id: {REPORT_ID}",
            "generate support file": lambda folder: f"Completed successfully: {folder}/{SUPPORT_FILE}",
        }
        self._most_words = max(len(name.split()) for name in self._commands)
        self.listener = ServiceListener(address, DASHBOARD_PORT, poll, self._connect)

    def _connect(self, connection: ClientConnection) -> LineHandler:
        connection.send(f"{wire.BANNER}\n".encode())
        return LineHandler(self)

    def answer(self, line: str) -> str:
        """Carry out a command and return the answer."""
        words = line.split()
        for count in range(min(len(words), self._most_words), 0, -1):
            name = " ".join(words[:count]).lower()
            command = self._commands.get(name)
            if command is not None:
                only_queries = self._controller.parameters.local_mode_commands == "queries"
                if self._controller.modes.local and only_queries and name not in QUERIES:
                    return NOT_ALLOWED
                return command(line.strip()[len(name) :].strip())
        return f"could not understand: '{line.strip()}'"

    def _unlock(self, _: str) -> str:
        is_released = self._controller.unlock_protective_stop()
        return wire.ACCEPTED[DashboardOrder.UNLOCK_PROTECTIVE_STOP] if is_released else TOO_EARLY

    def _get_loaded(self, _: str) -> str:
        loaded = self._controller.loaded
        return f"Loaded program: {PROGRAM_FOLDER}{loaded}" if loaded else "No program loaded"

    def _load(self, name: str) -> str:
        controller = self._controller
        if name.rpartition("/")[2] not in controller.parameters.programs.split(","):
            return f"File not found: {name}"
        if controller.program is not None:
            return f"Error while loading program: {name}"
        controller.loaded = name.rpartition("/")[2]
        return f"Loading program: {name}"

    def _play(self, _: str) -> str:
        controller = self._controller
        if controller.program is not None:
            started = controller.resume() or controller.is_running
        else:
            started = bool(controller.loaded) and not controller.start(self._loaded_program())
        return "Starting program" if started else "Failed to execute: play"

    def _loaded_program(self) -> UrProgram:
        name, parameters = self._controller.loaded, self._controller.parameters
        if not name.startswith(EXTERNAL_CONTROL):
            return endless(name)
        return requested_program(name, parameters.external_control_host, parameters.external_control_port)

    def _pause(self, _: str) -> str:
        return "Pausing program" if self._controller.pause() else "Failed to execute: pause"

    def _set_operational_mode(self, mode: str) -> str:
        if mode.upper() not in OPERATIONAL_MODES:
            return f"Operational mode {mode} is not valid"
        self._operational_mode = mode.upper()
        return f"Operational mode {self._operational_mode} is set"

    def _clear_operational_mode(self, _: str) -> str:
        self._operational_mode = NO_MODE
        return f"No longer controlling the operational mode. Current operational mode: {NO_MODE}"

    def _set_user_role(self, role: str) -> str:
        if role.upper() not in USER_ROLES:
            return f"Failed setting user role: {role}"
        self._user_role = role.upper()
        return f"Setting user role: {self._user_role}"

    def _popup(self, text: str) -> str:
        self._controller.popup = text
        return "showing popup"


def _accepting(order: DashboardOrder, do: Callable[[], object]) -> Callable[[str], str]:
    def carry_out(_: str) -> str:
        do()
        return wire.ACCEPTED[order]

    return carry_out


QUERIES: Final = frozenset(
    {
        *(query.lower() for query in Query),
        "safetystatus",
        "polyscopeversion",
        "version",
        "programstate",
        "get loaded program",
        "isprogramsaved",
        "get operational mode",
        "getuserrole",
    }
)


class LineHandler(Handler):
    """Splits the bytes of one client into lines."""

    def __init__(self, dashboard: Dashboard) -> None:
        self._dashboard = dashboard
        self._rest = b""

    def receive(self, data: bytes) -> bytes:
        """Return the answers to all complete lines; raises HangUp."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if max(map(len, (*lines, self._rest))) > LONGEST_LINE:
            raise HangUp
        answers: list[str] = []
        for line in lines:
            text = line.decode("utf-8", "replace").strip()
            if text.lower() in ("quit", "exit"):
                raise HangUp("".join([*answers, "Disconnected\n"]).encode())
            if text:
                answers.append(f"{self._dashboard.answer(text)}\n")
        if self._dashboard.silent:
            return b""
        return "".join(answers).encode()

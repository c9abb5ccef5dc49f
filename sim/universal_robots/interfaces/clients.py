"""Primary, secondary and real-time interfaces: state and messages out, scripts in."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator

from ronna_hw.logs import logger
from ronna_hw.wire.universal_robots import PRIMARY_PORT, REALTIME_PORT, SECONDARY_PORT
from sim.universal_robots.connections import ClientConnection, Handler, HangUp, Poll, ServiceListener
from sim.universal_robots.controller import Controller
from sim.universal_robots.interfaces.state_packages import StatePackages
from sim.universal_robots.programs.recognition import name_of, recognise
from sim.universal_robots.programs.statements import UnknownStatement, require_known, run_at_once

MOST_SCRIPTS = 50  # received at once: each that is refused keeps the cycles for 0.1 ms
LOCAL_MODE_CODE = 210  # a script while in local mode
LOCAL_MODE_TEXT = "Cannot run script: the robot is not in remote control mode"
_STRING_OR_COMMENT = re.compile(r'"[^"\n]*"|#.*')
_BLOCK = re.compile(r"\b(def|sec|thread|if|while|for|end)\b")
_BEGINS = re.compile(r"\s*(def|sec)\b")


class ClientInterfaces:
    """The three ports that take scripts."""

    def __init__(self, controller: Controller, address: str, poll: Poll) -> None:
        self._controller = controller
        self._packages = StatePackages(controller)
        self._period = max(1, round(controller.parameters.state_period_s / controller.model.cycle_s))
        self._due_cycle, self._due_s = 0, 0.0  # of the next state; the latter in host time
        self._waiting: list[tuple[int, str]] = []  # scripts, with the cycles until they start
        news, packages = controller.news, self._packages

        def listen(port: int, *first: Callable[[], bytes]) -> ServiceListener:
            def connect(connection: ClientConnection) -> ScriptHandler:
                for message in first:
                    connection.send(message())
                return ScriptHandler(controller.parameters.longest_script_bytes, self.take)

            return ServiceListener(address, port, poll, connect)

        self.primary = listen(PRIMARY_PORT, packages.version, packages.state)
        self.secondary = listen(SECONDARY_PORT, packages.version, packages.state)
        self.realtime = listen(REALTIME_PORT)
        news.program.append(lambda what, name: self._tell(packages.key(f"PROGRAM_XXX_{what}", name)))
        news.safety.append(lambda mode: self._tell(self._state() + packages.safety_mode(mode)))
        news.failure.append(lambda text, place: self._tell(packages.runtime_exception(text, place)))
        news.text.append(lambda text: self._tell(packages.text(text)))
        news.error.append(lambda code, text: self._tell(packages.error(code, text)))

    @property
    def listeners(self) -> tuple[ServiceListener, ...]:
        """All ports."""
        return self.primary, self.secondary, self.realtime

    def _tell(self, message: bytes) -> None:
        """Send a message; secondary clients get none but the version."""
        for connection in self.primary.connections:
            connection.send(message)

    def send_state(self) -> None:
        """Send what is due in this cycle."""
        if self._waiting:
            self._start_waiting()
        if self._is_state_due():
            readers = [*self.primary.connections, *self.secondary.connections]
            if readers:
                state = self._state()
                for connection in readers:
                    connection.send(state)
        if self.realtime.connections:
            package = self._packages.realtime()
            for connection in self.realtime.connections:
                connection.send_while_read(package)

    def _state(self) -> bytes:
        self._controller.loads.publish_torques()
        return self._packages.state()

    def _is_state_due(self) -> bool:
        """Return whether a period has passed, in cycles or in host time, and begin the next one.

        Clients judge silence by the host's clock, and cycles of a resting lock-step are far apart on it.
        """
        cycles, now_s = self._controller.cycles, time.monotonic()
        if cycles < self._due_cycle and now_s < self._due_s:
            return False
        self._due_cycle = cycles + self._period
        self._due_s = now_s + self._controller.parameters.state_period_s
        return True

    # -- scripts

    def take(self, text: str) -> None:
        """Carry out a script or a command."""
        controller = self._controller
        if controller.modes.local:
            for tell in controller.news.error:
                tell(LOCAL_MODE_CODE, LOCAL_MODE_TEXT)
            return
        command = COMMANDS.get(" ".join(text.split()))
        if command is not None:
            command(controller)
        elif text.lstrip().startswith("sec"):
            try:
                require_known(text)
                run_at_once(controller.robot, text)
            except UnknownStatement as unknown:
                self._refuse(text, unknown)
            except (ArithmeticError, ValueError) as error:
                controller.news.tell_failure(str(error))
        else:
            delay = round(controller.parameters.script_start_s / controller.model.cycle_s)
            self._waiting.append((delay, text))
            if not delay:
                self._start_waiting()

    def _start_waiting(self) -> None:
        waiting, self._waiting = self._waiting, []
        for cycles, text in waiting:
            if cycles > 0:
                self._waiting.append((cycles - 1, text))
                continue
            controller = self._controller
            try:
                why_not = controller.start(recognise(text, controller.model.cycle_s))
            except UnknownStatement as unknown:
                self._refuse(text, unknown)
                continue
            except (ArithmeticError, ValueError) as error:
                why_not = str(error)
            if why_not:
                controller.news.tell_failure(f"{name_of(text)} cannot run: {why_not}")

    def _refuse(self, text: str, unknown: UnknownStatement) -> None:
        """Answer a script that is not simulated as a controller answers one that it cannot compile."""
        log = logger(device="ur")
        log.warning("a script that is not simulated was refused", script=name_of(text), why=str(unknown))
        self._controller.news.tell_failure(str(unknown), unknown.place)


class ScriptHandler(Handler):
    """Takes the scripts of one client."""

    def __init__(self, longest_bytes: int, take: Callable[[str], None]) -> None:
        self._text = ScriptText(longest_bytes)
        self._take = take

    def receive(self, data: bytes) -> bytes:
        """Execute each complete script received; raises HangUp for one without end, or a flood."""
        try:
            for number, text in enumerate(self._text.feed(data)):
                if number == MOST_SCRIPTS:
                    raise HangUp
                self._take(text)
        except ValueError:
            raise HangUp from None
        return b""


class ScriptText:
    """Splits the text that a client sends into programs, and lines that stand alone."""

    def __init__(self, longest_bytes: int) -> None:
        self._longest_bytes = longest_bytes
        self._rest = b""
        self._lines: list[str] = []
        self._depth = 0
        self._size = 0

    def feed(self, data: bytes) -> Iterator[str]:
        """Yield what is complete; raises ValueError for a text without end."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            if line.strip():
                yield from self._add(line.decode("utf-8", "replace").rstrip("\r"))
        if self._size + len(self._rest) > self._longest_bytes:
            raise ValueError("a script without end")

    def _add(self, line: str) -> Iterator[str]:
        code = _STRING_OR_COMMENT.sub("", line)
        if not self._lines:
            if not code.strip():  # a comment
                return
            if not _BEGINS.match(code):
                yield line.strip()
                return
        self._lines.append(line)
        self._size += len(line) + 1
        for word in _BLOCK.findall(code):
            self._depth += -1 if word == "end" else 1
        if self._depth <= 0:
            text = "\n".join(self._lines)
            self._lines, self._depth, self._size = [], 0, 0
            yield text


COMMANDS: dict[str, Callable[[Controller], object]] = {
    "stop program": Controller.stop,
    "pause program": Controller.pause,
    "resume program": Controller.resume,
    "power on": lambda controller: controller.modes.power_on(),
    "power off": Controller.power_off,
    "set robotmode run": lambda controller: controller.modes.release_brakes(),
    "set unlock protective stop": Controller.unlock_protective_stop,
}

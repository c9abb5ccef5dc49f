"""EKI channel client: commands with acknowledgements, and requested or unsolicited controller states."""

from __future__ import annotations

import itertools
import secrets
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeVar
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

from drivers.kuka_rsi.eki.telegrams import ControllerState, TelegramScanner, parse_telegram, read_state
from drivers.kuka_rsi.errors import BAD_EKI_TELEGRAM, COMMAND_REFUSED, EKI_LISTENS, STREAM_ERRORS
from ronna_hw.arm.pose import Pose
from ronna_hw.arm_stream.control_channel import BytesPassed, ControlChannel
from ronna_hw.arm_stream.errors import ControllerLost
from ronna_hw.devices.lifecycle import READABLE, Lifecycle, LifecycleGuard
from ronna_hw.wire.kuka_eki import ACK, CMD, STATE, AckCode, CommandName

ACKS_KEPT = 64
FIRST_NUMBERS = 1 << 30  # of a connection; an INT of the controller has 32 bits
REQUEST_PERIOD_S = 0.2  # two periods of the unsolicited state
T = TypeVar("T")
NOT_SERVED = (
    "A controller serves one program at a time: another run or another computer has the arm. Stop that "
    f"one, or wait; there is nothing to recover. Or this port is not the controller's: {EKI_LISTENS}."
)
AT_REST = (Lifecycle.CONNECTED, Lifecycle.CONFIGURED)  # no active corrections that a new frame could alter
DEFAULT_TIMEOUT_S = 5.0


class Ack(NamedTuple):
    """Controller's acknowledgement of a command."""

    code: AckCode
    text: str


class EkiClient(ControlChannel[ControllerState]):
    """Thread-safe EKI connection."""

    errors = STREAM_ERRORS
    thread_name = "eki reader"

    def __init__(self, host: str, port: int, timeout_s: float, on_bytes: BytesPassed | None = None) -> None:
        """Connect to the controller; raises EKI-001 on failure. `on_bytes` receives all traffic."""
        # The controller may still send what belongs to an earlier connection.
        self._numbers = itertools.count(1 + secrets.randbelow(FIRST_NUMBERS))
        self._sent: dict[int, CommandName] = {}
        self._scanner = TelegramScanner()
        self._acks: dict[int, Ack] = {}
        self._states: dict[int, ControllerState] = {}
        super().__init__(host, port, timeout_s, on_bytes)

    def status(self, timeout_s: float) -> ControllerState:
        """Request the controller state; raises EKI-003 on time-out, EKI-002 or EKI-004 on a broken link."""
        reply = self.await_reply(self.request_state(), timeout_s)
        return self._answered(CommandName.STATUS, reply, timeout_s)

    def request_state(self) -> int:
        """Request the state without waiting and return the request's number; raises EKI-002."""
        return self._send(CommandName.STATUS, {})

    def find_reply(self, number: int) -> ControllerState | None:
        """Return the state sent in reply to a request, or None if it has not arrived."""
        return self._states.get(number)

    def await_reply(self, number: int, timeout_s: float) -> ControllerState | None:
        """Wait for the reply to a request; returns None on time-out, raises EKI-002 or EKI-004."""
        return self._wait_for(lambda: self._states.get(number), timeout_s)

    def command(self, name: CommandName, timeout_s: float, **values: object) -> Ack:
        """Send a command and wait for its answer, of any code. Raises EKI-003, EKI-002 or EKI-004."""
        number = self._send(name, values)
        return self._answered(name, self._wait_for(lambda: self._acks.get(number), timeout_s), timeout_s)

    def require(self, name: CommandName, timeout_s: float, **values: object) -> None:
        """Send a command as `command` does; raises EKI-008 unless it is acknowledged with OK."""
        ack = self.command(name, timeout_s, **values)
        if ack.code is not AckCode.OK:
            raise COMMAND_REFUSED(f"the controller refused {name}", got=f"{ack.code.name} {ack.text}".strip())

    def await_state(
        self, condition: Callable[[ControllerState], bool], timeout_s: float
    ) -> ControllerState | None:
        """Wait for a state that meets a condition; returns None on time-out.

        States arrive unsolicited; one is nevertheless requested now and then.
        """

        def find_matching() -> ControllerState | None:
            latest = self.latest
            return latest if latest is not None and condition(latest) else None

        deadline = time.monotonic() + timeout_s
        while (remaining_s := deadline - time.monotonic()) > 0.0:
            if (found := self._wait_for(find_matching, min(remaining_s, REQUEST_PERIOD_S))) is not None:
                return found
            self._send(CommandName.STATUS, {})
        return find_matching()

    def _answered(self, name: CommandName, answer: T | None, timeout_s: float) -> T:
        if answer is None:
            raise STREAM_ERRORS.no_answer(f"{self.where} does not answer {name}", limit=f"{timeout_s:g} s")
        return answer

    def _send(self, name: CommandName, values: dict[str, object]) -> int:
        with self._arrived:
            number = next(self._numbers)
            _store(self._sent, number, name)
        attributes = "".join(f" {key}={quoteattr(str(value))}" for key, value in values.items())
        self._transmit(f'<{CMD} Id="{number}" Name="{name}"{attributes}></{CMD}>'.encode("ascii"))
        return number

    def _split(self, data: bytes) -> Iterator[bytes]:
        return self._scanner.feed(data)

    def _take(self, message: bytes) -> ControllerState | None:
        root = parse_telegram(message)
        try:
            number = int(root.get("Id") or 0)
            code = AckCode(int(root.get("Code") or 0))
        except ValueError as error:
            raise BAD_EKI_TELEGRAM(str(error), wire=ElementTree.tostring(root)) from error
        sent = self._sent.get(number)
        state = read_state(root, time.monotonic()) if root.tag == STATE else None
        if state is not None and sent is CommandName.STATUS:
            _store(self._states, number, state)
        elif root.tag == ACK and sent is not None:  # otherwise of an earlier connection, or of nobody
            if root.get("Cmd", sent) != sent:
                raise BAD_EKI_TELEGRAM(
                    f"{self.where} answers another command",
                    expected=sent,
                    got=root.get("Cmd"),
                    wire=ElementTree.tostring(root),
                )
            # A motion is answered twice; the caller waits for the first answer.
            _store(self._acks, number, Ack(code, root.get("Text") or ""))
        return state

    def _lost_error(self, how: str) -> ControllerLost:
        """Build the error for a broken connection, with other advice if no state ever arrived."""
        if self.latest is None:
            return STREAM_ERRORS.lost(f"{self.where}{how} before it sent anything", action=NOT_SERVED)
        return STREAM_ERRORS.lost(f"{self.where}{how}")


def _store(store: dict[int, T], number: int, value: T) -> None:
    store.setdefault(number, value)
    while len(store) > ACKS_KEPT:
        del store[next(iter(store))]


class ControllerCommands:
    """Controller commands for tool, base and override; excludes motion and the RSI stream.

    Each raises EKI-003 without an answer and EKI-008 when refused.
    """

    def __init__(self, guard: LifecycleGuard, eki: Callable[[], EkiClient]) -> None:
        """Create the commands; `eki` returns the open connection or raises EKI-001."""
        self._guard = guard
        self._eki = eki

    def state(self, timeout_s: float = DEFAULT_TIMEOUT_S) -> ControllerState:
        """Request the controller's current state."""
        self._guard.require("controller.state", (*READABLE, Lifecycle.FAULT))
        return self._eki().status(timeout_s)

    def set_tool(
        self,
        number: int,
        tool_in_flange: Pose,
        *,
        mass_kg: float,
        centre_of_mass_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> None:
        """Set a tool frame (number 1..16) with its load; at rest only."""
        frame = _frame_attributes(tool_in_flange)
        centre = dict(zip(("CX", "CY", "CZ"), centre_of_mass_mm, strict=True))
        self._send_command(CommandName.SET_TOOL, timeout_s, No=number, **frame, M=mass_kg, **centre)

    def set_base(self, number: int, base_in_world: Pose, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        """Set a base frame (number 1..32); at rest only."""
        self._send_command(CommandName.SET_BASE, timeout_s, No=number, **_frame_attributes(base_in_world))

    def set_override(self, percent: int, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        """Set the program override, 1..100; it does not scale RSI corrections."""
        self._send_command(CommandName.SET_OV, timeout_s, Val=percent)

    def _send_command(self, command: CommandName, timeout_s: float, **values: object) -> None:
        self._guard.require(f"controller {command}", AT_REST)
        self._eki().require(command, timeout_s, **values)


def _frame_attributes(pose: Pose) -> dict[str, object]:
    return {name: f"{value:.6f}" for name, value in zip("XYZABC", pose.to_kuka(), strict=True)}

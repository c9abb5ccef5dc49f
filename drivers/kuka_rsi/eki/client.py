"""EKI channel client: commands with acknowledgements, and requested or unsolicited controller states.

A thread reads everything the controller sends, since it closes the connection if unsolicited telegrams are
not read.
"""

from __future__ import annotations

import contextlib
import itertools
import socket
import struct
import threading
import time
from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeVar
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

from drivers.kuka_rsi.eki.telegrams import ControllerState, TelegramScanner, parse_telegram, read_state
from drivers.kuka_rsi.errors import (
    EKI_LISTENS,
    BadEkiTelegram,
    CommandRefused,
    ControllerLost,
    ControllerNotFound,
    NoAnswer,
)
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.capabilities import Direction
from ronna_hw.devices.lifecycle import READABLE, Lifecycle, LifecycleGuard
from ronna_hw.errors import RonnaError
from ronna_hw.wire.kuka_eki import ACK, CMD, STATE, AckCode, CommandName

RECEIVE_BYTES = 4096
CLOSE_TIMEOUT_S = 1.0
ACKS_KEPT = 64
REQUEST_PERIOD_S = 0.2  # two periods of the unsolicited state
READER_LIMIT_S = 2.0  # beyond its limit, in which a wait lets the reader take what has arrived by then
QUIET_S = 0.2  # the same: after such a silence a listener should check how long it has lasted
T = TypeVar("T")
NOT_SERVED = (
    "A controller serves one program at a time: another run or another computer has the arm. Stop that "
    f"one, or wait; there is nothing to recover. Or this port is not the controller's: {EKI_LISTENS}."
)
AT_REST = (Lifecycle.CONNECTED, Lifecycle.CONFIGURED)  # no active corrections that a new frame could alter
DEFAULT_TIMEOUT_S = 5.0
_TIMEVAL = struct.Struct("ll")


class Ack(NamedTuple):
    """Controller's acknowledgement of a command."""

    code: AckCode
    text: str


class Listener(Protocol):
    """Callbacks for EKI events, called on the reader thread; they must return quickly."""

    def on_state(self, state: ControllerState) -> None:
        """Handle a requested or unsolicited state."""
        ...

    def on_silence(self) -> None:
        """Handle another `QUIET_S` without data from the controller."""
        ...

    def on_loss(self, failure: RonnaError) -> None:
        """Handle the loss of the connection; not called when we close it."""
        ...


class EkiClient:
    """Thread-safe EKI connection."""

    def __init__(
        self,
        host: str,
        port: int,
        timeout_s: float,
        on_bytes: Callable[[Direction, bytes], None] | None = None,
    ) -> None:
        """Connect to the controller; raises EKI-001 on failure. `on_bytes` receives all traffic."""
        self._on_bytes = on_bytes
        self.where = f"tcp://{host}:{port}"
        try:
            self._socket = socket.create_connection((host, port), timeout=timeout_s)
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise ControllerNotFound(
                f"nothing answers at {self.where} ({reason})", limit=f"{timeout_s:g} s"
            ) from error
        self._socket.settimeout(None)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # Applies to receiving only: senders may wait longer.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIMEVAL.pack(0, round(QUIET_S * 1e6)))
        self._numbers = itertools.count(1)
        self._arrived = threading.Condition()
        self._sending = threading.Lock()
        self._acks: dict[int, Ack] = {}
        self._states: dict[int, ControllerState] = {}
        self.latest: ControllerState | None = None  # the last one sent, requested or unsolicited
        self.failure: RonnaError | None = None  # cause of the loss
        self._listened_s = 0.0  # host time up to which the reader has taken all that arrived
        self._listener: Listener | None = None
        self._closing = False
        self._reader = threading.Thread(target=self._read_telegrams, name="eki reader", daemon=True)
        self._reader.start()

    @property
    def silent_s(self) -> float:
        """Host time for which the reader has listened in vain for a state; the controller sends ten a second.

        The time in which this program did not run is no silence of the controller.
        """
        latest = self.latest
        return max(0.0, self._listened_s - latest.received_s) if latest is not None else 0.0

    def listen(self, listener: Listener) -> None:
        """Register a listener for states, silence and loss of the connection."""
        self._listener = listener
        if self.failure is not None and not self._closing:
            listener.on_loss(self.failure)

    def status(self, timeout_s: float) -> ControllerState:
        """Request the controller state; raises EKI-003 on time-out, EKI-002 or EKI-004 on a broken link."""
        state = self.await_reply(self.request_state(), timeout_s)
        if state is None:
            raise NoAnswer(f"{self.where} does not answer {CommandName.STATUS}", limit=f"{timeout_s:g} s")
        return state

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
        ack = self._wait_for(lambda: self._acks.get(number), timeout_s)
        if ack is None:
            raise NoAnswer(f"{self.where} does not answer {name}", limit=f"{timeout_s:g} s")
        return ack

    def require(self, name: CommandName, timeout_s: float, **values: object) -> None:
        """Send a command as `command` does; raises EKI-008 unless it is acknowledged with OK."""
        ack = self.command(name, timeout_s, **values)
        if ack.code is not AckCode.OK:
            raise CommandRefused(f"the controller refused {name}", got=f"{ack.code.name} {ack.text}".strip())

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
            found = self._wait_for(find_matching, min(remaining_s, REQUEST_PERIOD_S))
            if found is not None:
                return found
            self._send(CommandName.STATUS, {})
        return find_matching()

    def close(self) -> None:
        """Close the connection; never raises."""
        self._closing = True
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        if self._reader is not threading.current_thread():
            self._reader.join(CLOSE_TIMEOUT_S)

    def _send(self, name: CommandName, values: dict[str, object]) -> int:
        number = next(self._numbers)
        attributes = "".join(f" {key}={quoteattr(str(value))}" for key, value in values.items())
        telegram = f'<{CMD} Id="{number}" Name="{name}"{attributes}></{CMD}>'
        try:
            with self._sending:
                self._socket.sendall(sent := telegram.encode("ascii"))
                if self._on_bytes is not None:
                    self._on_bytes(Direction.SENT, sent)
        except OSError as error:
            raise self.failure or self._lost_error(f": {error.strerror or error}") from error
        return number

    def _wait_for(self, find: Callable[[], T | None], timeout_s: float) -> T | None:
        deadline = time.monotonic() + timeout_s
        with self._arrived:
            while True:
                found = find()
                if found is not None:
                    return found
                if self.failure is not None:
                    raise self.failure
                now_s = time.monotonic()
                # On a busy computer this thread may run first, while the answer waits in the socket.
                limit_s = deadline if self._listened_s >= deadline else deadline + READER_LIMIT_S
                if now_s >= limit_s:
                    return None
                self._arrived.wait((deadline if now_s < deadline else limit_s) - now_s)

    def _read_telegrams(self) -> None:
        scanner = TelegramScanner()
        failure: RonnaError
        try:
            while data := self._receive_bytes():
                received_s = time.monotonic()
                for telegram in scanner.feed(data):
                    self._handle_element(parse_telegram(telegram))
                if len(data) < RECEIVE_BYTES:  # nothing was left in the socket
                    self._tell_listened(received_s)
            failure = self._lost_error(" closed the connection")
        except RonnaError as error:
            failure = error
        except Exception as error:  # also a listener's: without a reader no emergency stop would arrive
            failure = self._lost_error(
                f": {getattr(error, 'strerror', None) or error or type(error).__name__}"
            )
        with self._arrived:
            self.failure = failure
            self._arrived.notify_all()
        if self._listener is not None and not self._closing:
            self._listener.on_loss(failure)

    def _lost_error(self, how: str) -> ControllerLost:
        """Build the error for a broken connection, with other advice if no state ever arrived."""
        if self.latest is None:
            return ControllerLost(f"{self.where}{how} before it sent anything", action=NOT_SERVED)
        return ControllerLost(f"{self.where}{how}")

    def _receive_bytes(self) -> bytes:
        """Receive the next bytes, or none once the controller has closed the connection."""
        while True:
            began_s = time.monotonic()
            try:
                data = self._socket.recv(RECEIVE_BYTES)
            except BlockingIOError:
                self._tell_listened(began_s + QUIET_S)
                if self._listener is not None:
                    self._listener.on_silence()
                continue
            if self._on_bytes is not None:
                self._on_bytes(Direction.RECEIVED, data)
            return data

    def _tell_listened(self, until_s: float) -> None:
        with self._arrived:
            self._listened_s = until_s
            self._arrived.notify_all()

    def _handle_element(self, root: ElementTree.Element) -> None:
        try:
            number = int(root.get("Id") or 0)
            code = AckCode(int(root.get("Code") or 0))
        except ValueError as error:
            raise BadEkiTelegram(str(error), wire=ElementTree.tostring(root)) from error
        state = read_state(root, time.monotonic()) if root.tag == STATE else None
        with self._arrived:
            if state is not None:
                self.latest = state
                _store_reply(self._states, number, state)
            elif root.tag == ACK:
                # A motion is answered twice; the caller waits for the first answer.
                _store_reply(self._acks, number, Ack(code, root.get("Text") or ""))
            self._arrived.notify_all()
        if state is not None and self._listener is not None:
            self._listener.on_state(state)


def _store_reply(store: dict[int, T], number: int, value: T) -> None:
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
        CX, CY, CZ = centre_of_mass_mm
        frame = _frame_attributes(tool_in_flange)
        self._send_command(
            CommandName.SET_TOOL, timeout_s, No=number, **frame, M=mass_kg, CX=CX, CY=CY, CZ=CZ
        )

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
    X, Y, Z, A, B, C = pose.to_kuka()
    values = {"X": X, "Y": Y, "Z": Z, "A": A, "B": B, "C": C}
    return {name: f"{value:.6f}" for name, value in values.items()}

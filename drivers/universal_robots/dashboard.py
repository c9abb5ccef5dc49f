"""Dashboard client: one line of text asks, one line answers.

A line does not say which question it answers. It counts only if nothing was unread before the question, it
has the form of an answer to it, and nothing follows it. Otherwise every later answer could be that to another
question: the next question then goes over a new connection.
"""

from __future__ import annotations

import contextlib
import re
import socket
import threading
import time
from collections.abc import Mapping
from typing import Final, TypeVar

from drivers.universal_robots.errors import BAD_BYTES, COMMAND_REFUSED, STREAM_ERRORS
from ronna_hw.arm_stream.control_channel import BytesPassed, describe, open_connection
from ronna_hw.arm_stream.errors import ControllerLost, MalformedMessage, NoAnswer
from ronna_hw.devices.capabilities import Direction
from ronna_hw.wire.universal_robots import RobotMode, SafetyMode
from ronna_hw.wire.universal_robots_services import (
    ACCEPTED,
    BANNER,
    ROBOT_MODE_HEAD,
    RUNNING_HEAD,
    SAFETY_MODE_HEAD,
    DashboardOrder,
    Query,
)

LONGEST_LINE_BYTES = 1000
RECEIVE_BYTES = 1024
T = TypeVar("T")
TRUTHS = {"true": True, "false": False}
_ORDERS: Final[dict[Query | DashboardOrder, str]] = {order: f"{head}.*" for order, head in ACCEPTED.items()}
_QUERIES: Final[dict[Query | DashboardOrder, str]] = {
    Query.ROBOT_MODE: f"{ROBOT_MODE_HEAD}.*",
    Query.SAFETY_MODE: f"{SAFETY_MODE_HEAD}.*",
    Query.ROBOT_MODEL: r"UR\d+\w*",
    Query.SERIAL_NUMBER: r"\d+",
    Query.REMOTE_CONTROL: "|".join(TRUTHS),
    Query.RUNNING: f"{RUNNING_HEAD}.*",
    Query.ADD_TO_LOG: r"\w+ log message.*",
}
_FORMS: Final = {asked: re.compile(form, re.IGNORECASE) for asked, form in (_ORDERS | _QUERIES).items()}


class DashboardClient:
    """Thread-safe connection to the dashboard server."""

    def __init__(self, host: str, port: int, timeout_s: float, on_bytes: BytesPassed | None = None) -> None:
        """Connect; raises URD-002 if no dashboard server answers. `on_bytes` receives all traffic."""
        self.where = f"tcp://{host}:{port}"
        self._address = host, port
        self._on_bytes = on_bytes
        self._asking = threading.Lock()
        self._closed = False
        self._socket: socket.socket
        self._open(timeout_s)

    def ask(self, question: Query | DashboardOrder, timeout_s: float, text: str = "") -> str:
        """Return the answer to a question, which a text may follow.

        Raises URD-014 on a broken connection, URD-015 on time-out, URD-016 for a line of another form,
        and after these two URD-002 if no dashboard server answers any more.
        """
        deadline = time.monotonic() + timeout_s
        if not self._asking.acquire(timeout=max(0.0, timeout_s)):  # also a signal handler's own thread has it
            raise STREAM_ERRORS.no_answer(
                f"{self.where} has not answered an earlier question", limit=f"{timeout_s:g} s"
            )
        try:
            if not self._is_in_step():
                self._disconnect()
                self._open(timeout_s)
            self._send(f"{question} {text}".strip().encode() + b"\n", timeout_s)
            try:
                return self._read_answer(question, deadline)
            except (NoAnswer, MalformedMessage):
                self._in_step = False  # a late answer would be taken for that to the next question
                raise
        finally:
            self._asking.release()

    def require(self, order: DashboardOrder, timeout_s: float) -> None:
        """Give an order; raises URD-017 unless it is carried out."""
        answer = self.ask(order, timeout_s)
        if not is_accepted(order, answer):
            raise COMMAND_REFUSED(
                f"the controller refused {order.value!r}", expected=ACCEPTED[order], got=answer
            )

    def robot_mode(self, timeout_s: float) -> RobotMode:
        """Return the robot mode."""
        return self._value(Query.ROBOT_MODE, ROBOT_MODE_HEAD, RobotMode.__members__, timeout_s)

    def safety_mode(self, timeout_s: float) -> SafetyMode:
        """Return the safety mode."""
        return self._value(Query.SAFETY_MODE, SAFETY_MODE_HEAD, SafetyMode.__members__, timeout_s)

    def is_remote(self, timeout_s: float) -> bool:
        """Return whether the controller is in remote control; e-Series only."""
        return self._value(Query.REMOTE_CONTROL, "", TRUTHS, timeout_s)

    def is_program_running(self, timeout_s: float) -> bool:
        """Return whether any program runs."""
        return self._value(Query.RUNNING, RUNNING_HEAD, TRUTHS, timeout_s)

    def close(self) -> None:
        """Close the connection; never raises."""
        self._closed = True
        self._disconnect()

    def _open(self, timeout_s: float) -> None:
        """Connect, and read the line with which a dashboard server begins."""
        self._received, self._in_step = b"", True
        self._socket = open_connection(*self._address, timeout_s, STREAM_ERRORS.not_found)
        try:
            banner = self._read_line(time.monotonic() + timeout_s)
        except (NoAnswer, ControllerLost, MalformedMessage) as error:
            self._disconnect()
            raise STREAM_ERRORS.not_found(
                f"{self.where} is open, but no dashboard server answers there", expected=BANNER
            ) from error
        if not banner.startswith(BANNER):
            self._disconnect()
            raise STREAM_ERRORS.not_found(f"{self.where} is no dashboard server", expected=BANNER, got=banner)

    def _disconnect(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def _is_in_step(self) -> bool:
        """Return whether what arrives next answers the next question; a closed connection stays closed."""
        if self._closed:
            return True
        try:
            self._socket.settimeout(0.0)
            return self._in_step and not self._received and not self._socket.recv(1, socket.MSG_PEEK)
        except OSError:  # nothing has arrived, or asking tells what is wrong
            return self._in_step

    def _read_answer(self, question: Query | DashboardOrder, deadline: float) -> str:
        answer = self._read_line(deadline)
        if self._received or not is_answer(question, answer):
            raise BAD_BYTES(
                f"{self.where} does not answer {question.value!r} with one line that belongs to it",
                got=answer,
                wire=self._received,
            )
        return answer

    def _value(self, command: Query, head: str, known: Mapping[str, T], timeout_s: float) -> T:
        answer = self.ask(command, timeout_s)
        word = answer[len(head) :].strip().lower()
        for name, value in known.items():
            if name.lower() == word:
                return value
        raise BAD_BYTES(f"{self.where} answers {command.value!r} unexpectedly", got=answer)

    def _send(self, data: bytes, timeout_s: float) -> None:
        try:
            self._socket.settimeout(timeout_s)
            self._socket.sendall(data)
        except OSError as error:
            raise self._lost_error(error) from error
        if self._on_bytes is not None:
            self._on_bytes(Direction.SENT, data)

    def _read_line(self, deadline: float) -> str:
        while b"\n" not in self._received:
            if len(self._received) > LONGEST_LINE_BYTES:
                raise BAD_BYTES(f"{self.where} sends an endless line", wire=self._received)
            try:
                # Past its limit it still takes an answer that has come while this program did not run.
                self._socket.settimeout(max(0.0, deadline - time.monotonic()))
                data = self._socket.recv(RECEIVE_BYTES)
            except (TimeoutError, BlockingIOError):
                raise STREAM_ERRORS.no_answer(f"{self.where} does not answer") from None
            except OSError as error:
                raise self._lost_error(error) from error
            if not data:
                raise STREAM_ERRORS.lost(f"{self.where} closed the connection")
            if self._on_bytes is not None:
                self._on_bytes(Direction.RECEIVED, data)
            self._received += data
        line, _, self._received = self._received.partition(b"\n")
        return line.decode(errors="replace").strip()

    def _lost_error(self, error: OSError) -> ControllerLost:
        return STREAM_ERRORS.lost(f"{self.where}: {describe(error)}")


def is_answer(question: Query | DashboardOrder, answer: str) -> bool:
    """Return whether an answer can be that to a question; an order is refused in any other words."""
    if _FORMS[question].fullmatch(answer):
        return True
    return isinstance(question, DashboardOrder) and not any(
        form.fullmatch(answer) for form in _FORMS.values()
    )


def is_accepted(order: DashboardOrder, answer: str) -> bool:
    """Return whether an answer says that an order is carried out."""
    return answer.lower().startswith(ACCEPTED[order].lower())

"""A serial line as a pseudo-terminal.

The unit keeps the host's end open, so hosts may connect, disconnect and be killed. Three substitutes replace
what a real line would show: the settings of the host's end can be read here (rate, stop bits, odd parity; the
kernel keeps neither data bits nor even parity); packet mode reports flushes, and flushing both directions
followed by silence represents a break, which no pseudo-terminal carries; inotify reports opening and closing.
"""

from __future__ import annotations

import os
import select
import termios
import time
import tty

from ronna_hw.wire.polaris import REPLY_RESET
from sim.polaris.errors import LineUnavailable
from sim.polaris.line.channel import RECEIVE_BYTES, Ready
from sim.polaris.line.framing import ascii_reply
from sim.polaris.line.host_side import HostLine, HostSideWatch, packet_mode
from sim.polaris.line.interpreter import CommandInterpreter
from sim.polaris.line.line_settings import LineSettings

FULL_PATIENCE_S = 0.5  # a serial line does not wait: anything unread by then is lost
THROTTLE_STEP_S = 0.01  # a throttled reply is sent in steps of this length
SLOW_ANSWER_S = 0.02  # if longer, the host may have sent a break in the meantime
UNNOTICED_S = 0.005  # waking up this late is no delay: a real unit takes some ms to reply
FLUSH_GAP_S = 0.005  # a flush of both directions may be reported in two parts
SEVEN_BITS = bytes(byte & 0x7F for byte in range(256))
UNREADABLE = bytes((byte * 0x9D + 0x37) & 0xFF | 0x80 for byte in range(256))  # as received at a wrong rate
_TERMIOS_INPUT_SPEED, _TERMIOS_OUTPUT_SPEED = 4, 5


class PseudoTerminal:
    """The unit's end of a serial line."""

    def __init__(self, interpreter: CommandInterpreter, *, throttle: bool) -> None:
        self._interpreter = interpreter
        self._behaviour = interpreter.unit.behaviour
        self._throttle = throttle
        try:
            self._master, self._host_end = os.openpty()
            self._path = os.ttyname(self._host_end)
            self._watch = HostSideWatch(self._path)
        except OSError as error:
            raise LineUnavailable(f"cannot create a pseudo-terminal: {error.strerror or error}") from error
        tty.setraw(self._host_end)
        settings = termios.tcgetattr(self._host_end)
        settings[_TERMIOS_INPUT_SPEED] = settings[_TERMIOS_OUTPUT_SPEED] = termios.B9600
        termios.tcsetattr(self._host_end, termios.TCSANOW, settings)
        self._host = HostLine(self._master)
        packet_mode(self._master)
        os.set_blocking(self._master, False)
        self._controls = select.poll()
        # In packet mode POLLPRI reports a flush.
        self._controls.register(self._master, select.POLLIN | select.POLLPRI)
        self._spoken_to = False  # since the line was opened
        self._opened_s = self._heard_s = 0.0
        self._arrived_s = 0.0  # when the last byte of a command arrived on a throttled line
        self._flushed_input_s = 0.0
        if self._behaviour.power_up_reset:
            self._write(ascii_reply(REPLY_RESET))  # read by a host that opens the line without flushing it

    @property
    def endpoint(self) -> str:
        """The address for hosts."""
        return f"serial://{self._path}"

    def files(self) -> tuple[int, ...]:
        return (self._master, self._watch.file)

    def receive(self, ready: Ready) -> bytes | None:
        if any(file == self._watch.file for file, _ in ready):
            self._look_who_is_there()
        while True:
            try:
                packet = os.read(self._master, RECEIVE_BYTES)
            except BlockingIOError:
                return b""
            if packet[:1] == b"\0":
                break
            self._controlled(packet[0])
        self._heard_s = time.monotonic()
        self._spoken_to = True
        self._interpreter.deny_break()
        if self._understands(self._interpreter.line):
            return packet[1:]
        if self._behaviour.wrong_line == "garbage" and b"\r" in packet:
            self._write(b"ERROR046802\r".translate(UNREADABLE))
        return b""

    def let_arrive(self, received_bytes: int, line: LineSettings) -> None:
        if self._throttle:
            self._arrived_s = max(self._heard_s, self._arrived_s) + received_bytes * line.seconds_per_byte
            time.sleep(max(0.0, self._arrived_s - time.monotonic()))

    def send(self, data: bytes, line: LineSettings) -> None:
        if time.monotonic() - self._heard_s > SLOW_ANSWER_S and self._broken_meanwhile():
            return
        if line.data_bits == 7 and self._behaviour.strips_eighth_bit:
            data = data.translate(SEVEN_BITS)
        if not self._throttle:
            self._write(data)
            return
        moment_s = time.monotonic()
        if moment_s - self._arrived_s < UNNOTICED_S:
            moment_s = self._arrived_s
        step = max(1, int(THROTTLE_STEP_S / line.seconds_per_byte))
        for start in range(0, len(data), step):
            piece = data[start : start + step]
            moment_s += len(piece) * line.seconds_per_byte
            time.sleep(max(0.0, moment_s - time.monotonic()))
            if self._broken_meanwhile():
                return
            self._write(piece)

    def close(self) -> None:
        """Close both ends."""
        self._watch.close()
        os.close(self._master)
        os.close(self._host_end)

    def _look_who_is_there(self) -> None:
        opened, left = self._watch.events()
        if left:
            self._interpreter.host_left()
        if opened:
            self._opened_s = time.monotonic()
            self._spoken_to = False

    def _understands(self, line: LineSettings) -> bool:
        return not self._behaviour.enforces_line or self._host.agrees(line)

    def _broken_meanwhile(self) -> bool:
        """Whether the host seems to have sent a break while its command was executed."""
        suspected = False
        while (events := self._controls.poll(0)) and events[0][1] & select.POLLPRI:
            suspected = self._controlled(os.read(self._master, 1)[0]) or suspected
        return suspected and not events  # a host that has sent more since did not send a break

    def _controlled(self, control: int) -> bool:
        """Handle a flush by the host: input only before a command, both directions before a break.

        True for a suspected break.
        """
        now_s = time.monotonic()
        input_too = control & termios.TIOCPKT_FLUSHREAD or now_s - self._flushed_input_s < FLUSH_GAP_S
        if control & termios.TIOCPKT_FLUSHREAD:
            self._flushed_input_s = now_s
        if not (control & termios.TIOCPKT_FLUSHWRITE and input_too and self._behaviour.break_from_flush):
            return False
        if not self._spoken_to or now_s - self._opened_s < self._behaviour.break_deaf_s:
            return False
        self._interpreter.suspect_break()
        return True

    def _write(self, data: bytes) -> None:
        deadline_s = 0.0
        while data:
            try:
                data = data[os.write(self._master, data) :]
            except BlockingIOError:
                now_s = time.monotonic()
                deadline_s = deadline_s or now_s + FULL_PATIENCE_S
                if now_s >= deadline_s:
                    return
                select.select([], [self._master], [], deadline_s - now_s)

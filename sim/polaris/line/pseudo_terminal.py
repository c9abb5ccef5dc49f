"""Serial line simulated by a pseudo-terminal.

The unit keeps the host's end open, so hosts may connect, disconnect and be killed. A pseudo-terminal
lacks three signals of a real line; their substitutes:
- line settings: read from the host's end (rate, stop bits, odd parity; the kernel keeps neither data bits nor
  even parity);
- break: a flush of both directions, reported by packet mode, followed by silence;
- open and close: reported by inotify.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import select
import struct
import termios
import time
import tty

from ronna_hw.wire.polaris import REPLY_RESET
from sim.polaris.errors import LINE_UNAVAILABLE
from sim.polaris.line.interpreter import CommandInterpreter
from sim.polaris.line.server import RECEIVE_BYTES, Ready
from sim.polaris.unit.framing import LineSettings, ascii_reply

# <asm-generic/ioctls.h> and <asm-generic/termbits.h>: settings with rates as plain numbers.
TCGETS2 = 0x802C542A
_termios2 = struct.Struct("<4IB19s2I")  # four flag words, line discipline, control characters, rates
CONTROL_FLAGS, INPUT_BAUD, OUTPUT_BAUD = 2, 6, 7
# <sys/inotify.h>
IN_CLOSE_WRITE, IN_CLOSE_NOWRITE, IN_OPEN = 0x8, 0x10, 0x20
_event = struct.Struct("<iIII")  # watch, event mask, cookie, length of the name that follows
EVENTS_BYTES = 4096

FULL_PATIENCE_S = 0.5  # a serial line does not wait: bytes unread by then are lost
THROTTLE_STEP_S = 0.01  # a throttled reply is sent in steps of this length
SLOW_ANSWER_S = 0.02  # above this the host may have sent a break meanwhile
UNNOTICED_S = 0.005  # a late wake-up below this is ignored: a real unit takes some ms to reply
FLUSH_GAP_S = 0.005  # a flush of both directions may be reported in two parts
SEVEN_BITS = bytes(byte & 0x7F for byte in range(256))
UNREADABLE = bytes((byte * 0x9D + 0x37) & 0xFF | 0x80 for byte in range(256))  # as received at a wrong rate
_TERMIOS_INPUT_SPEED, _TERMIOS_OUTPUT_SPEED = 4, 5


class PseudoTerminal:
    """Unit side of a serial line."""

    def __init__(self, interpreter: CommandInterpreter, *, throttle: bool) -> None:
        self._interpreter = interpreter
        self._behaviour = interpreter.unit.behaviour
        self._throttle = throttle
        try:
            self._master, self._host_end = os.openpty()
            self._path = os.ttyname(self._host_end)
            self._watch = HostSideWatch(self._path)
        except OSError as error:
            raise LINE_UNAVAILABLE(f"cannot create a pseudo-terminal: {error.strerror or error}") from error
        tty.setraw(self._host_end)
        settings = termios.tcgetattr(self._host_end)
        settings[_TERMIOS_INPUT_SPEED] = settings[_TERMIOS_OUTPUT_SPEED] = termios.B9600
        termios.tcsetattr(self._host_end, termios.TCSANOW, settings)
        self._host = HostLine(self._master)
        # Packet mode prefixes every read with a control byte: 0 for data, otherwise a flush or a stop.
        fcntl.ioctl(self._master, termios.TIOCPKT, struct.pack("i", 1))
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
        """Address for hosts: the pseudo-terminal's path."""
        return f"serial://{self._path}"

    def files(self) -> tuple[int, ...]:
        return (self._master, self._watch.file)

    def receive(self, ready: Ready) -> bytes | None:
        if any(file == self._watch.file for file, _ in ready):
            self._update_hosts()
        while True:
            try:
                packet = os.read(self._master, RECEIVE_BYTES)
            except BlockingIOError:
                return b""
            if packet[:1] == b"\0":
                break
            self._handle_flush(packet[0])
        self._heard_s = time.monotonic()
        self._spoken_to = True
        self._interpreter.dismiss_break()
        if not self._behaviour.enforces_line or self._host.agrees(self._interpreter.unit.line):
            return packet[1:]
        if self._behaviour.wrong_line == "garbage" and b"\r" in packet:
            self._write(b"ERROR046802\r".translate(UNREADABLE))
        return b""

    def wait_for_arrival(self, received_bytes: int, line: LineSettings) -> None:
        if self._throttle:
            self._arrived_s = max(self._heard_s, self._arrived_s) + received_bytes * line.seconds_per_byte
            time.sleep(max(0.0, self._arrived_s - time.monotonic()))

    def send(self, data: bytes, line: LineSettings) -> None:
        if time.monotonic() - self._heard_s > SLOW_ANSWER_S and self._suspects_break():
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
            if self._suspects_break():
                return
            self._write(piece)

    def close(self) -> None:
        """Close both ends."""
        self._watch.close()
        os.close(self._master)
        os.close(self._host_end)

    def _update_hosts(self) -> None:
        opened, closed = self._watch.events()
        if closed:
            self._interpreter.host_left()
        if opened:
            self._opened_s = time.monotonic()
            self._spoken_to = False

    def _suspects_break(self) -> bool:
        """Return whether the host appears to have sent a break during its command."""
        suspected = False
        while (events := self._controls.poll(0)) and events[0][1] & select.POLLPRI:
            suspected = self._handle_flush(os.read(self._master, 1)[0]) or suspected
        return suspected and not events  # a host that has sent more since did not send a break

    def _handle_flush(self, control: int) -> bool:
        """Handle a packet mode control byte and return whether it suggests a break.

        Hosts flush input alone before a command, and both directions before a break.
        """
        now_s = time.monotonic()
        input_too = control & termios.TIOCPKT_FLUSHREAD or now_s - self._flushed_input_s < FLUSH_GAP_S
        if control & termios.TIOCPKT_FLUSHREAD:
            self._flushed_input_s = now_s
        if not (control & termios.TIOCPKT_FLUSHWRITE and input_too and self._behaviour.break_from_flush):
            return False
        if not self._spoken_to or now_s - self._opened_s < self._behaviour.break_deaf_s:
            return False
        self._interpreter.note_possible_break()
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


class HostLine:
    """Host-side line settings, as far as a pseudo-terminal stores them."""

    def __init__(self, master: int) -> None:
        self._master = master
        self._judged: tuple[bytes, LineSettings] | None = None
        self._agreed = False

    def agrees(self, line: LineSettings) -> bool:
        """Return whether the line settings of host and unit could be compatible."""
        content = fcntl.ioctl(self._master, TCGETS2, bytes(_termios2.size))
        if self._judged is None or self._judged[1] is not line or self._judged[0] != content:
            self._judged = (content, line)
            fields = _termios2.unpack(content)
            same_rate = fields[INPUT_BAUD] == fields[OUTPUT_BAUD] == line.baud
            odd_enough = line.parity != "odd" or bool(fields[CONTROL_FLAGS] & termios.PARODD)
            self._agreed = same_rate and odd_enough
        return self._agreed


class HostSideWatch:
    """Detects opens and closes on the host side by inotify, excluding the unit's own descriptor."""

    def __init__(self, path: str) -> None:
        library = ctypes.CDLL(None, use_errno=True)
        self.file = library.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        events = IN_OPEN | IN_CLOSE_WRITE | IN_CLOSE_NOWRITE
        if self.file < 0 or library.inotify_add_watch(self.file, path.encode(), events) < 0:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), path)
        self._holders = 0

    def events(self) -> tuple[bool, bool]:
        """Return whether, since the last call, the host side was opened and the last host left."""
        try:
            content = os.read(self.file, EVENTS_BYTES)
        except BlockingIOError:
            return False, False
        opened = closed = False
        offset = 0
        while offset < len(content):
            _, what, _, name_length = _event.unpack_from(content, offset)
            offset += _event.size + name_length
            if what & IN_OPEN:
                self._holders += 1
                opened = True
            elif what & (IN_CLOSE_WRITE | IN_CLOSE_NOWRITE):
                self._holders = max(0, self._holders - 1)
                closed = closed or self._holders == 0
        return opened, closed

    def close(self) -> None:
        """Stop watching."""
        os.close(self.file)

"""GVCP control channel to one camera: commands with retries, control privilege, heartbeat.

A camera keeps the privilege of a dead client until that client's heartbeat times out.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack

from drivers.basler_stereo import gvcp
from drivers.basler_stereo.errors import CameraLost, CommandRefused, ControlLost, ControlTaken, NoReply
from ronna_hw.devices.capabilities import Direction
from ronna_hw.errors import RonnaError
from ronna_hw.host.port_users import LEAVE_A_CASE_ALONE, find_udp_clients
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap, GevStatus, GvcpCommand

FIRST_TRY_S = 0.2  # a camera replies within milliseconds; each retry waits twice as long
COMMAND_LIMIT_S = 1.5  # for one command including retries, unless the caller's deadline is earlier
REFUSED_PAUSE_S = 0.05  # between tries while the host reports a closed port
LAST_OWN_ID = gev.REQUEST_ID_LAST - 1  # the last id is reserved for the receiver process, for keep-alives
LAST_READ_S = 1e-3  # for a reply that arrived while the host stalled
Command = tuple[GvcpCommand, bytes]
"""A command and its payload."""
RETRY_PAUSE_S = 0.1
LAPSE_MARGIN_S = 0.5  # cameras check their timer only now and then
BEATS_PER_TIMEOUT = 4
SLOWEST_BEAT_S = 1.0
SILENT_BEATS = 2  # consecutive failures, including retries, before the camera may count as lost
ASK_LIMIT_S = 1.0
JOIN_LIMIT_S = 1.5


class CameraControl:
    """GVCP control channel that handles one command at a time; thread-safe.

    Retries reuse the request id, so that a device that replies late does not execute a command twice.
    """

    def __init__(
        self,
        address: str,
        *,
        port: int = gev.GVCP_PORT,
        monotonic: Callable[[], float] = time.monotonic,
        on_bytes: Callable[[Direction, bytes], None] = lambda _direction, _data: None,
    ) -> None:
        """Open the channel; `on_bytes` receives every datagram.

        Raises OSError without a route to the address.
        """
        self._passed = on_bytes
        # also used by the receiver process, which sends resend requests and keep-alives through it
        self.link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self.link.connect((address, port))  # datagrams from other addresses are filtered out
        except OSError:
            self.link.close()
            raise
        self.address = address
        self._monotonic = monotonic
        self._lock = threading.RLock()
        self._request_id = 0
        self.port_closed = False  # the address is reachable, but nothing listens on its GVCP port

    @property
    def peer_address(self) -> str:
        """Numeric address of the camera."""
        return str(self.link.getpeername()[0])

    @property
    def local_address(self) -> str:
        """Address of the host on the route to the camera."""
        return str(self.link.getsockname()[0])

    def close(self) -> None:
        """Close the socket."""
        self.link.close()

    def read_register(self, address: int, deadline_s: float) -> int:
        """Read one 32-bit register; raises GEV-006, GEV-007, GEV-008."""
        what = f"reading register 0x{address:X}"
        payload = self.ask(GvcpCommand.READREG, gvcp.read_register_command(address), deadline_s, what)
        return gvcp.register_value(payload, what)

    def write_register(self, address: int, value: int, deadline_s: float) -> None:
        """Write one 32-bit register; raises GEV-006, GEV-007."""
        what = f"writing 0x{value:X} to register 0x{address:X}"
        self.ask(GvcpCommand.WRITEREG, gvcp.write_register_command(address, value), deadline_s, what)

    def read_memory(self, address: int, count: int, deadline_s: float) -> bytes:
        """Read `count` bytes of memory, in several requests if needed; raises GEV-006, GEV-007, GEV-008."""
        data = bytearray()
        while len(data) < count:
            start = address + len(data)
            piece = min(gev.READMEM_LIMIT, -(-(count - len(data)) // 4) * 4)
            what = f"reading memory at 0x{start:X}"
            payload = self.ask(GvcpCommand.READMEM, gvcp.read_memory_command(start, piece), deadline_s, what)
            data += gvcp.memory_data(payload, start, piece)
        return bytes(data[:count])

    def write_memory(self, address: int, data: bytes, deadline_s: float) -> None:
        """Write a short block of memory, a multiple of 4 bytes; raises GEV-006, GEV-007."""
        what = f"writing memory at 0x{address:X}"
        self.ask(GvcpCommand.WRITEMEM, gvcp.write_memory_command(address, data), deadline_s, what)

    def ask(self, command: GvcpCommand, payload: bytes, deadline_s: float, what: str) -> bytes:
        """Send a command and return the payload of its acknowledge; raises GEV-006, GEV-007."""
        with self._lock:
            request_id, datagram = self._prepare(command, payload)
            self._send(datagram)
            return self._finish(command, request_id, datagram, deadline_s, what)

    def _prepare(self, command: GvcpCommand, payload: bytes) -> tuple[int, bytes]:
        self._request_id = self._request_id % LAST_OWN_ID + gev.REQUEST_ID_FIRST
        return self._request_id, gvcp.encode(command, self._request_id, payload)

    def _finish(
        self, command: GvcpCommand, request_id: int, datagram: bytes, deadline_s: float, what: str
    ) -> bytes:
        """Wait for the acknowledge of a command already sent, resending it as needed."""
        # a deadline that passed while waiting for the lock or the CPU still allows one try
        started_s = self._monotonic()
        deadline_s = max(deadline_s, started_s + FIRST_TRY_S)
        limit_s = min(deadline_s, started_s + COMMAND_LIMIT_S)
        patience_s = FIRST_TRY_S
        while True:
            until_s = min(limit_s, self._monotonic() + patience_s)
            if (acknowledge := self._receive(command, request_id, until_s, deadline_s)) is not None:
                return gvcp.require_success(acknowledge, f"{self.address}: {what}")
            if self._monotonic() >= limit_s:
                raise NoReply(f"{self.address}: no reply", expected=what, limit=f"{COMMAND_LIMIT_S} s")
            patience_s *= 2.0
            self._send(datagram)

    def _receive(
        self, command: GvcpCommand, request_id: int, until_s: float, deadline_s: float
    ) -> gvcp.GvcpAcknowledge | None:
        """Receive the acknowledge with this request id, or return None at `until_s`."""
        while True:
            # also after the deadline: data that arrived while the host stalled was in time
            if (remaining_s := until_s - self._monotonic()) < -COMMAND_LIMIT_S:
                return None  # only unrelated datagrams
            self.link.settimeout(max(LAST_READ_S, remaining_s))
            try:
                datagram = self.link.recv(gvcp.LARGEST_DATAGRAM_BYTES)
            except TimeoutError:
                return None
            except ConnectionRefusedError:  # the host at that address reports a closed port
                self.port_closed = True
                time.sleep(max(0.0, min(REFUSED_PAUSE_S, until_s - self._monotonic())))
                return None
            self._passed(Direction.RECEIVED, datagram)
            if (acknowledge := gvcp.decode(datagram)) is None or acknowledge.request_id != request_id:
                continue  # a late acknowledge of an earlier command
            if acknowledge.command == GvcpCommand.PENDING_ACK:
                wait_s = gvcp.pending_ms(acknowledge.payload) / 1000.0
                until_s = min(deadline_s, max(until_s, self._monotonic() + wait_s))
                continue
            if acknowledge.command == command + 1:
                return acknowledge

    def _send(self, datagram: bytes) -> None:
        # an error here (network down, closed port) shows up as a missing acknowledge, which is reported
        with contextlib.suppress(OSError):
            self.link.send(datagram)
            self._passed(Direction.SENT, datagram)


def register_write(address: int, value: int) -> Command:
    """Build a command that writes one register."""
    return GvcpCommand.WRITEREG, gvcp.write_register_command(address, value)


def send_together(
    commands: Sequence[tuple[CameraControl, Command]], deadline_s: float, what: str
) -> list[Exception | None]:
    """Send one command on each channel, as nearly simultaneously as possible.

    All commands are sent before the first acknowledge is awaited. Returns None or an error per channel.
    """
    results: list[Exception | None] = []
    with ExitStack() as locks:
        for channel, _ in commands:
            locks.enter_context(channel._lock)
        prepared = [
            (channel, code, *channel._prepare(code, payload)) for channel, (code, payload) in commands
        ]
        for channel, _, _, datagram in prepared:
            channel._send(datagram)
        for channel, code, request_id, datagram in prepared:
            try:
                channel._finish(code, request_id, datagram, deadline_s, what)
                results.append(None)
            except (NoReply, CommandRefused) as error:
                results.append(error)
    return results


def take_control(control: CameraControl, camera_name: str, deadline_s: float) -> None:
    """Take control of a camera; `camera_name` is its name in messages.

    Retries until the current controller's heartbeat time-out has passed, within the deadline (host monotonic
    time). Raises GEV-005 when that controller is alive or time is up, GEV-006, GEV-007.
    """
    give_up_s: float | None = None
    while (refusal := _try_control(control, deadline_s)) is not None:
        if give_up_s is None:
            give_up_s = _control_end_s(control, deadline_s)
        if time.monotonic() + 2 * RETRY_PAUSE_S >= give_up_s:  # time for one more try, not two
            raise _describe_taken(control, camera_name, refusal)
        time.sleep(RETRY_PAUSE_S)


def _describe_taken(control: CameraControl, camera_name: str, refusal: str) -> ControlTaken:
    """Build the error for a controlled camera; on this computer it names the programs that talk to it."""
    what = f"{camera_name} is controlled by another application"
    if not (users := find_udp_clients(control.peer_address, gev.GVCP_PORT)):
        return ControlTaken(what, got=refusal)
    got = f"{refusal}; in use by {' and '.join(map(str, users))}"
    return ControlTaken(what, got=got, action=f"{LEAVE_A_CASE_ALONE} Otherwise end it.")


def require_control(control: CameraControl, deadline_s: float) -> None:
    """Raise GEV-015 unless we still control the camera, GEV-007 if it does not reply."""
    try:
        privilege = control.read_register(Bootstrap.CCP, deadline_s)
    except CommandRefused as error:  # while another client has exclusive access, even reading is rejected
        raise ControlLost(f"{control.address} is controlled by another application") from error
    if not privilege & (gev.CCP_CONTROL | gev.CCP_EXCLUSIVE):
        raise ControlLost(f"{control.address} has released control", got=f"privilege {privilege}")


def _try_control(control: CameraControl, deadline_s: float) -> str | None:
    """Request control; returns the reason if the camera refuses, otherwise None."""
    try:
        control.write_register(Bootstrap.CCP, gev.CCP_CONTROL, deadline_s)
        privilege = control.read_register(Bootstrap.CCP, deadline_s)
    except CommandRefused as error:
        if error.status != GevStatus.ACCESS_DENIED:
            raise
        return "access denied"
    return None if privilege & gev.CCP_CONTROL else f"privilege {privilege}"


def _control_end_s(control: CameraControl, deadline_s: float) -> float:
    """Return when control lapses if its holder is dead, at most the deadline."""
    try:
        timeout_ms = control.read_register(Bootstrap.HEARTBEAT_TIMEOUT_MS, deadline_s)
    except CommandRefused:  # exclusive access: others cannot even read
        return deadline_s
    return min(deadline_s, time.monotonic() + timeout_ms / 1000.0 + LAPSE_MARGIN_S)


class Heartbeat:
    """Thread that keeps control by polling the privilege; calls `on_lost` once if control or camera is lost.

    A silent camera is lost only after its time-out: until then it keeps us as its controller. Any command
    would restart the camera's timer, but reading the privilege also shows whether the camera has restarted or
    dropped us, and every device counts it as a heartbeat.
    """

    def __init__(
        self,
        control: CameraControl,
        timeout_ms: int,
        on_lost: Callable[[RonnaError], None],
        name: str,
        *,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._control = control
        self._monotonic = monotonic
        self._timeout_s = timeout_ms / 1000.0
        self._period_s = min(SLOWEST_BEAT_S, self._timeout_s / BEATS_PER_TIMEOUT)
        self._on_lost = on_lost
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"{name}-heartbeat", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop the thread, within the time of one command to an unresponsive camera."""
        self._ending.set()
        if threading.current_thread() is not self._thread:
            self._thread.join(JOIN_LIMIT_S)

    def _run(self) -> None:
        silent, last_reply_s = 0, self._monotonic()
        while not self._ending.wait(self._period_s):
            try:
                require_control(self._control, self._monotonic() + ASK_LIMIT_S)
                silent, last_reply_s = 0, self._monotonic()
            except NoReply as error:
                silent += 1
                silent_s = self._monotonic() - last_reply_s
                if silent < SILENT_BEATS or silent_s < self._timeout_s or self._ending.is_set():
                    continue
                lost = CameraLost(
                    f"{self._control.address} does not reply to the heartbeat",
                    limit=f"{self._timeout_s:g} s",
                    got=f"silent for {silent_s:.1f} s",
                )
                lost.__cause__ = error
                self._on_lost(lost)
                return
            except (RonnaError, OSError) as error:
                if self._ending.is_set():
                    return
                if not isinstance(error, RonnaError):
                    error = CameraLost(f"the link to {self._control.address} broke", got=str(error))
                self._on_lost(error)
                return

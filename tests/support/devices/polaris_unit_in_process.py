"""Small Polaris unit in process, on a clock that only moves when somebody waits.

It is written from the protocol's reference, not from the driver's code.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from drivers.ndi_polaris import PolarisTracker
from drivers.ndi_polaris.errors import LinkLost
from ronna_hw.config import DeviceConfig
from ronna_hw.wire.polaris import MARKER_DIGITS, crc16

VERSION_TEXT = "\n".join(
    [
        "Polaris Spectra Control Firmware",
        "NDI S/N: P7-01234",
        "Characterization Date: 06/05/24",
        "Freeze Tag: Polaris Spectra Rev 007.000",
        "Freeze Date: 01/04/10",
        "(C) Northern Digital Inc.",
    ]
)
VOLUMES = (
    "25-240000-153200-095000+057200+039800+056946+024303+029773+999999+99999924\n"
    "5-300000-153200-095000+057200+039800+056946+024303+029773+999999+07350024\n"
)
NORMAL_PARAMETERS = {
    "Features.Firmware.Version": "007.000.012",
    "Param.Tracking.Illuminator Rate": "0",
    "Param.Tracking.Selected Volume": "0",
    "Param.Bump Detector.Bumped": "0",
    "Param.Bump Detector.Clear": "0",
    "Info.Status.Alerts": "0",
    "Info.Status.New Alerts": "0",
}

Deliveries = list[tuple[float, bytes]]  # delay in seconds, bytes
Handler = Callable[[str], str | bytes]  # a command's argument to its reply


def with_crc(text: str) -> bytes:
    data = text.encode("ascii")
    return data + f"{crc16(data):04X}".encode() + b"\r"


def binary(body: bytes) -> bytes:
    head = struct.pack("<HH", 0xA5C4, len(body))
    return head + struct.pack("<H", crc16(head)) + body + struct.pack("<H", crc16(body))


class UnitInProcess:
    """Unit with its line. Handles are given out from 01; loaded tools are seen 10 mm apart."""

    def __init__(self, baud: int | None = 9600) -> None:
        self.now_s = 0.0
        self.unit_baud = 9600
        self._host_baud = baud
        self.deliver: Callable[[str, bytes], Deliveries] = lambda command, reply: [(0.001, reply)]
        self.commands: list[str] = []
        self.parameters = dict(NORMAL_PARAMETERS)
        self.known_bauds = {"0": 9600, "3": 38400, "5": 115200}
        self.system_status = 0
        self.port_status = 0x31
        self.missing: set[int] = set()
        self.marker_digits = "3333"  # of every tool: all four are used
        self.strays: list[tuple[float, float, float]] = []
        self.answers_to: dict[str, str] = {}  # command name -> text instead of the usual answer
        self.silent = False
        self.closed = False
        self.breaks_work = True
        self.breaks = 0
        self.initialised = False
        self.tracking = False
        self.frame = -1
        self.handles: dict[int, set[str]] = {}
        self.memory: dict[int, bytearray] = {}
        self._overrides: dict[str, Handler] = {}
        self._arrivals: list[tuple[float, bytes]] = []
        self._typed = b""
        self._last_arrival_s = 0.0

    # --- the line -----------------------------------------------------------------------------------

    @property
    def baud(self) -> int | None:
        return self._host_baud

    def write(self, data: bytes) -> None:
        if self.closed:
            raise LinkLost("the line is closed")
        if self._host_baud is not None and self._host_baud != self.unit_baud:
            return
        self._typed += data
        while b"\r" in self._typed:
            line, _, self._typed = self._typed.partition(b"\r")
            self._command(line)

    def read(self, timeout_s: float) -> bytes:
        if self.closed:
            raise LinkLost("the line is closed")
        self._arrivals.sort(key=lambda item: item[0])
        if self._arrivals and self._arrivals[0][0] <= self.now_s + max(0.0, timeout_s):
            self.now_s = max(self.now_s, self._arrivals[0][0])
            due = [data for moment, data in self._arrivals if moment <= self.now_s]
            self._arrivals = [item for item in self._arrivals if item[0] > self.now_s]
            return b"".join(due)
        self.now_s += max(0.0, timeout_s)
        return b""

    def set_baud(self, baud: int) -> None:
        if self._host_baud is not None:
            self._host_baud = baud

    def send_break(self) -> None:
        self.breaks += 1
        if self.breaks_work:
            self.restart()
            self._arrivals.append((self.now_s + 3.0, with_crc("RESET")))

    def close(self) -> None:
        return

    def restart(self) -> None:
        self.unit_baud, self.initialised, self.tracking = 9600, False, False
        self.handles.clear()

    def send_unasked(self, data: bytes) -> None:
        """Send bytes that answer no command, with the next read."""
        self._arrivals.append((self.now_s, data))

    # --- the unit -----------------------------------------------------------------------------------

    def override(self, name: str, handler: Handler) -> None:
        """Answer a command by `handler` instead of as usual."""
        self._overrides[name] = handler

    def usual(self, name: str) -> Any:
        """Return the handler of a command, None for an unknown one."""
        return getattr(self, f"_do_{name.lower()}", None)

    def _command(self, line: bytes) -> None:
        text = line.decode("latin-1")
        if ":" in text:
            body, crc = text[:-4], text[-4:]
            intact = crc == f"{crc16(body.encode('latin-1')):04X}"
        else:
            body, intact = text, True
        name, _, argument = (
            body.replace(" ", ":", 1).partition(":") if ":" not in body else body.partition(":")
        )
        self.commands.append(f"{name}:{argument}")
        if self.silent:
            return
        reply = self._answer(name, argument) if intact else with_crc("ERROR04")
        for delay_s, data in self.deliver(name, reply):
            # one line, one unit: what was sent later never overtakes what was sent before
            self._last_arrival_s = max(self._last_arrival_s, self.now_s + delay_s)
            self._arrivals.append((self._last_arrival_s, data))

    def _answer(self, name: str, argument: str) -> bytes:
        if name in self.answers_to:
            return with_crc(self.answers_to[name])
        handler = self._overrides.get(name) or self.usual(name)
        if handler is None:
            return with_crc("ERROR01")
        if not self.initialised and name not in ("INIT", "APIREV", "VER", "ECHO", "COMM"):
            return with_crc("ERROR10")
        if (name in ("TX", "BX", "TSTOP")) != self.tracking and name in (
            "TX", "BX", "TSTOP", "TSTART", "PHSR", "PHRQ", "PHF", "PVWR", "PINIT", "PENA", "SFLIST", "VSEL",
        ):  # fmt: skip
            return with_crc("ERROR0C")
        said = handler(argument)
        return said if isinstance(said, bytes) else with_crc(said)

    def _do_apirev(self, _: str) -> str:
        return "G.001.005"

    def _do_init(self, _: str) -> str:
        self.initialised, self.tracking = True, False
        self.handles.clear()
        return "OKAY"

    def _do_echo(self, argument: str) -> str:
        return argument

    def _do_ver(self, argument: str) -> str:
        return "024" if argument == "5" else VERSION_TEXT

    def _do_get(self, name: str) -> str:
        if name not in self.parameters:
            return "ERROR34"
        value = self.parameters[name]
        if name == "Info.Status.New Alerts":
            self.parameters[name] = "0"
            self.system_status &= ~0x0100
        return f"{name}={value}"

    def _do_set(self, assignment: str) -> str:
        name, _, value = assignment.partition("=")
        if name not in self.parameters:
            return "ERROR34"
        self.parameters[name] = value
        if name == "Param.Bump Detector.Clear":
            self.parameters["Param.Bump Detector.Bumped"] = "0"
        return "OKAY"

    def _do_sflist(self, _: str) -> str:
        return VOLUMES

    def _do_vsel(self, argument: str) -> str:
        return "OKAY" if argument in ("1", "2") else "ERROR24"

    def _do_comm(self, argument: str) -> str:
        if argument[0] not in self.known_bauds:
            return "ERROR06"
        self.unit_baud = self.known_bauds[argument[0]]
        return "OKAY"

    def _do_phsr(self, option: str) -> str:
        wanted = {"02": {"occupied"}, "03": {"initialised"}, "04": {"enabled"}}.get(option)
        rows = []
        for handle, marks in sorted(self.handles.items()):
            status = 1 + 0x10 * ("initialised" in marks) + 0x20 * ("enabled" in marks)
            if option == "00" or (wanted and wanted <= marks):
                rows.append(f"{handle:02X}{status:03X}")
        return f"{len(rows):02X}" + "".join(rows)

    def _do_phrq(self, argument: str) -> str:
        handle = next(number for number in range(1, 256) if number not in self.handles)
        self.handles[handle] = {"occupied", "dummy"} if argument.endswith("01") else {"occupied"}
        self.memory[handle] = bytearray(2048)
        return f"{handle:02X}"

    def _do_phf(self, argument: str) -> str:
        return "OKAY" if self.handles.pop(int(argument, 16), None) is not None else "ERROR2B"

    def _do_pvwr(self, argument: str) -> str:
        handle, address = int(argument[:2], 16), int(argument[2:6], 16)
        self.memory[handle][address : address + 64] = bytes.fromhex(argument[6:])
        return "OKAY"

    def _do_pinit(self, argument: str) -> str:
        handle = int(argument, 16)
        memory = self.memory[handle]
        intact = memory[:3] == b"NDI" and sum(memory[6:]) & 0xFFFF == int.from_bytes(memory[4:6], "little")
        if "dummy" not in self.handles[handle] and not intact:
            return "ERROR13"
        self.handles[handle].add("initialised")
        return "OKAY"

    def _do_pena(self, argument: str) -> str:
        marks = self.handles[int(argument[:2], 16)]
        if "initialised" not in marks:
            return "ERROR0E"
        marks.add("enabled")
        return "OKAY"

    def _do_tstart(self, _: str) -> str:
        self.tracking, self.frame = True, -1
        return "OKAY"

    def _do_tstop(self, _: str) -> str:
        self.tracking = False
        return "OKAY"

    def pose_of(self, handle: int) -> tuple[float, ...]:
        """Return Q0 Qx Qy Qz Tx Ty Tz error of a handle; the depth carries the frame number."""
        return (1.0, 0.0, 0.0, 0.0, 10.0 * handle, -20.0, -1500.0 - self.frame / 100, 0.125)

    def _enabled(self) -> list[int]:
        return sorted(handle for handle, marks in self.handles.items() if "enabled" in marks)

    def _do_bx(self, _: str) -> bytes:
        self.frame += 1
        body = bytes([len(self._enabled())])
        for handle in self._enabled():
            digits = self.marker_digits.ljust(MARKER_DIGITS, "0")[::-1]
            tail = struct.pack("<II", self.port_status, self.frame) + b"\0" + bytes.fromhex(digits)
            if handle in self.missing:
                body += bytes([handle, 2]) + tail
            else:
                body += bytes([handle, 1]) + struct.pack("<8f", *self.pose_of(handle)) + tail
        body += bytes([len(self.strays)]) + bytes((len(self.strays) + 7) // 8)
        body += b"".join(struct.pack("<3f", *stray) for stray in self.strays)
        return binary(body + struct.pack("<H", self.system_status))

    def _do_tx(self, _: str) -> str:
        self.frame += 1
        text = f"{len(self._enabled()):02X}"
        for handle in self._enabled():
            tail = f"{self.port_status:08X}{self.frame:08X}00{self.marker_digits.ljust(MARKER_DIGITS, '0')}\n"
            pose = self.pose_of(handle)
            values = "".join(f"{round(v * 10000):+06d}" for v in pose[:4])
            values += "".join(f"{round(v * 100):+07d}" for v in pose[4:7]) + f"{round(pose[7] * 10000):+06d}"
            text += f"{handle:02X}" + ("MISSING" if handle in self.missing else values) + tail
        text += f"{len(self.strays):02X}" + "0" * ((len(self.strays) + 3) // 4)
        text += "".join(f"{round(v * 100):+07d}" for stray in self.strays for v in stray)
        return text + f"{self.system_status:04X}"


class StillClock:
    """Theatre time that a test sets by hand."""

    paced = False

    def __init__(self) -> None:
        self.time_s = 0.0

    def now_s(self) -> float:
        return self.time_s

    def sleep(self, duration_s: float) -> None:
        self.time_s += duration_s


def tracker_on(unit: UnitInProcess, clock: StillClock, endpoint: str, **options: Any) -> PolarisTracker:
    """Make a tracker whose line is the unit itself, and whose time limits count on the unit's clock."""
    options.setdefault("tools", [{"name": "robot_frame", "rom": "robot_frame.rom"}])
    return PolarisTracker(
        "tracker",
        DeviceConfig(driver="ndi_polaris", endpoint=endpoint, options=options),
        clock,
        transport=lambda endpoint, timeout_s: unit,
        monotonic=lambda: unit.now_s,
        pause=lambda duration_s: setattr(unit, "now_s", unit.now_s + duration_s),
    )


def configured(device: PolarisTracker, limit_s: float = 10.0) -> PolarisTracker:
    """Connect and configure the tracker, and return it."""
    device.connect()
    device.configure(limit_s)
    return device


def bring_up(device: PolarisTracker) -> PolarisTracker:
    """Bring the tracker to tracking, and return it."""
    configured(device).activate()
    return device

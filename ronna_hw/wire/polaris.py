"""NDI Polaris protocol constants (Spectra, Vicra, Vega): names, codes, bits, layouts and the CRC.

Constants only: no I/O and no decoding. A command is ASCII and ends in CR, either `NAME:args` + CRC + CR or
`NAME args` + CR. An ASCII reply is text + CRC + CR; a binary reply (BX) carries its own length and two CRCs.
"""

from __future__ import annotations

import struct
from enum import IntEnum, IntFlag, StrEnum
from types import MappingProxyType
from typing import Final


class PolarisModel(StrEnum):
    """Models of the family, each a word of the name by which a unit identifies itself."""

    SPECTRA = "spectra"
    VICRA = "vicra"
    VEGA = "vega"


CR: Final = b"\r"
LF: Final = "\n"  # separates records inside an ASCII reply
ASCII_CRC_DIGITS: Final = 4  # upper-case hex, high byte first
REPLY_OKAY: Final = "OKAY"
REPLY_RESET: Final = "RESET"  # sent after power-up, break or the RESET command, at 9600 baud
REPLY_ERROR: Final = "ERROR"  # followed by 2 hex digits
REPLY_WARNING: Final = "WARNING"  # followed by 2 hex digits on newer firmware; the command was executed
REPLY_UNOCCUPIED: Final = "UNOCCUPIED"
REPLY_MISSING: Final = "MISSING"
REPLY_DISABLED: Final = "DISABLED"

CRC16_POLYNOMIAL: Final = 0xA001  # reflected x16 + x15 + x2 + 1; initial value 0, no final inversion


def _crc16_table() -> tuple[int, ...]:
    table = []
    for index in range(256):
        value = index
        for _ in range(8):
            value = (value >> 1) ^ CRC16_POLYNOMIAL if value & 1 else value >> 1
        table.append(value)
    return tuple(table)


CRC16_TABLE: Final = _crc16_table()


# CRC of a 16-bit word whose high byte is zero, by its low byte. With `CRC16_TABLE` for the high byte this
# makes two bytes per step; a table of whole words is slower, because its megabytes leave the caches.
_CRC16_LOW_TABLE: Final = tuple((crc >> 8) ^ CRC16_TABLE[crc & 0xFF] for crc in CRC16_TABLE)


def crc16(data: bytes, start: int = 0) -> int:
    """Compute the CRC-16 of `data`, continuing from `start`. Binary replies store it low byte first.

    Processes two bytes at a time, because every tracker reply waits for this.
    """
    crc = start
    low, high = _CRC16_LOW_TABLE, CRC16_TABLE
    for word in struct.unpack_from(f"<{len(data) // 2}H", data):
        crc ^= word
        crc = low[crc & 0xFF] ^ high[crc >> 8]
    if len(data) % 2:
        crc = (crc >> 8) ^ high[(crc ^ data[-1]) & 0xFF]
    return crc


DEFAULT_BAUD: Final = 9600  # 8N1 without handshake, at power-up and after a reset
BITS_PER_BYTE_ON_LINE: Final = 10  # start bit, 8 data bits, stop bit

# First character of the argument of COMM.
COMM_BAUD_CODES: Final = MappingProxyType(
    {
        "0": 9600,
        "1": 14400,
        "2": 19200,
        "3": 38400,
        "4": 57600,
        "5": 115200,
        "6": 921600,
        "7": 1228739,
        "A": 230400,
    }
)
COMM_DATA_BITS: Final = MappingProxyType({"0": 8, "1": 7})
COMM_PARITY: Final = MappingProxyType({"0": "none", "1": "odd", "2": "even"})
COMM_STOP_BITS: Final = MappingProxyType({"0": 1, "1": 2})
COMM_HANDSHAKE: Final = MappingProxyType({"0": "off", "1": "rts/cts"})
COMM_ARGUMENT_DIGITS: Final = 5  # baud, data, parity, stop, handshake
COMM_DEFAULT_ARGUMENT: Final = "00000"

# Time limits of the unit itself, seconds, as read from `Info.Timeout.<name>` on a real unit.
COMMAND_TIMEOUT_S: Final = MappingProxyType(
    {
        "INIT": 4.0, "COMM": 2.0, "VER": 2.0, "PHRQ": 2.0, "PINIT": 6.0, "PENA": 2.0, "PDIS": 2.0,
        "PHF": 2.0, "PVWR": 2.0, "PHSR": 2.0, "PHINF": 2.0, "PFSEL": 2.0, "TSTART": 6.0, "TSTOP": 2.0,
        "TX": 4.0, "BX": 4.0, "DSTART": 6.0, "DSTOP": 2.0, "IRED": 2.0, "3D": 4.0, "PSTART": 6.0,
        "PSTOP": 2.0, "GP": 4.0, "GETLOG": 4.0, "SYSLOG": 8.0, "SFLIST": 2.0, "VSEL": 2.0, "SSTAT": 2.0,
        "IRATE": 2.0, "BEEP": 2.0, "HCWDOG": 2.0, "SENSEL": 2.0, "ECHO": 2.0, "SET": 8.0, "GET": 8.0,
        "GETINFO": 15.0, "DFLT": 2.0, "SAVE": 8.0, "RESET": 15.0, "APIREV": 2.0, "GETIO": 2.0,
        "SETIO": 2.0, "LED": 2.0, "PPRD": 4.0, "PPWR": 4.0, "PSEL": 2.0, "PSRCH": 4.0, "PURD": 4.0,
        "PUWR": 4.0, "TCTST": 2.0, "TTCFG": 2.0, "PSOUT": 2.0, "VSNAP": 2.0, "VGET": 2.0,
    }
)  # fmt: skip

TSTART_RESET_FRAME_COUNTER: Final = "80"
TSTART_FASTER: Final = "40"
PHRQ_ANY_PASSIVE: Final = "*********1****"  # any hardware device, wireless (passive) tool, any port
PHRQ_DUMMY_PASSIVE: Final = "*********1**01"  # port 01: no tool, only the illuminators of a passive one
PHRQ_ARGUMENT_CHARACTERS: Final = 14
PVWR_BLOCK_BYTES: Final = 64
PVWR_SPACE_BYTES: Final = 2048  # size of the virtual memory of one handle
HANDLE_DIGITS: Final = 2


class HandleQuery(IntEnum):
    """PHSR option: which handles to list."""

    ALL = 0x00
    TO_BE_FREED = 0x01
    OCCUPIED = 0x02  # occupied but not initialised
    INITIALISED = 0x03  # initialised but not enabled
    ENABLED = 0x04


class TrackingPriority:
    """Tracking priority: the last character of the PENA argument."""

    STATIC: Final = "S"
    DYNAMIC: Final = "D"
    BUTTON_BOX: Final = "B"


class ReplyOption(IntFlag):
    """Reply options of the TX and BX commands."""

    TRANSFORMS = 0x0001
    TOOL_INFORMATION = 0x0002
    STRAY_ACTIVE = 0x0004
    TOOL_MARKERS = 0x0008
    OUT_OF_VOLUME = 0x0800  # report transforms and strays outside the volume
    STRAY_PASSIVE = 0x1000


MAXIMUM_STRAYS: Final = 50

BX_START: Final = 0xA5C4  # sent low byte first
BX_HEADER_BYTES: Final = 6  # start, length of the body, CRC of both
BX_CRC_BYTES: Final = 2  # after the body


class HandleStatus(IntEnum):
    """Status byte of a handle in a BX reply."""

    VALID = 0x01
    MISSING = 0x02
    DISABLED = 0x04


TX_QUATERNION_CHARACTERS: Final = 6  # sign, 5 digits
TX_QUATERNION_SCALE: Final = 10_000
TX_POSITION_CHARACTERS: Final = 7  # sign, 6 digits
TX_POSITION_SCALE: Final = 100  # per mm
TX_ERROR_CHARACTERS: Final = 6
TX_ERROR_SCALE: Final = 10_000  # per mm
TX_PORT_STATUS_DIGITS: Final = 8
TX_FRAME_DIGITS: Final = 8
TX_SYSTEM_STATUS_DIGITS: Final = 4


class PortStatus(IntFlag):
    """Handle status in TX and BX replies; the low byte is that of PHSR and PHINF."""

    OCCUPIED = 0x0001
    SWITCH_1 = 0x0002
    SWITCH_2 = 0x0004
    SWITCH_3 = 0x0008
    INITIALISED = 0x0010
    ENABLED = 0x0020
    OUT_OF_VOLUME = 0x0040
    PARTIALLY_OUT_OF_VOLUME = 0x0080
    ALGORITHM_LIMIT = 0x0100
    IR_INTERFERENCE = 0x0200
    PROCESSING_EXCEPTION = 0x1000


class SystemStatus(IntFlag):
    """System status, the last field of TX and BX replies."""

    SYNC_ERROR = 0x0001
    TOO_MUCH_INFRARED = 0x0002
    CRC_ERROR = 0x0004
    RECOVERABLE_EXCEPTION = 0x0008
    HARDWARE_FAILURE = 0x0010
    HARDWARE_CHANGE = 0x0020
    PORT_OCCUPIED = 0x0040
    PORT_UNOCCUPIED = 0x0080
    DIAGNOSTICS_PENDING = 0x0100  # an alert changed; cleared by reading New Alerts; no transforms while set
    TEMPERATURE = 0x0200  # out of range or not warmed up; no transforms while set


class ToolInformation(IntFlag):
    """Tool information, the first byte of the section added by option 0002."""

    BAD_FIT = 0x01
    TOO_FEW_MARKERS = 0x02


MARKER_DIGITS: Final = 20  # option 0002 always sends this many, after one byte of tool information


class MarkerState(IntEnum):
    """Marker state, one digit per marker in the section added by option 0002."""

    MISSING = 0
    BEYOND_ANGLE = 1
    BEYOND_ERROR = 2
    USED = 3


class Alert(IntFlag):
    """Alert bits of Info.Status.Alerts and Info.Status.New Alerts (decimal in the reply)."""

    FATAL_PARAMETER = 1 << 0
    SENSOR_PARAMETER = 1 << 1
    MAIN_VOLTAGE = 1 << 2
    SENSOR_VOLTAGE = 1 << 3
    ILLUMINATOR_VOLTAGE = 1 << 4
    ILLUMINATOR_CURRENT = 1 << 5
    LEFT_SENSOR_TEMPERATURE = 1 << 6
    RIGHT_SENSOR_TEMPERATURE = 1 << 7
    MAIN_BOARD_TEMPERATURE = 1 << 8
    BATTERY = 1 << 20
    BUMP = 1 << 21
    CABLE = 1 << 22
    FIRMWARE_INCOMPATIBLE = 1 << 23
    NON_FATAL_PARAMETER = 1 << 24
    FLASH_FULL = 1 << 25
    LASER_BATTERY = 1 << 26
    TOO_HOT = 1 << 29
    TOO_COLD = 1 << 30


PARAMETER_MODEL: Final = "Features.Hardware.Model"
PARAMETER_SERIAL: Final = "Features.Hardware.Serial Number"
PARAMETER_FIRMWARE: Final = "Features.Firmware.Version"
PARAMETER_ILLUMINATOR_RATE: Final = "Param.Tracking.Illuminator Rate"
PARAMETER_SELECTED_VOLUME: Final = "Param.Tracking.Selected Volume"  # 0-based
PARAMETER_ALERTS: Final = "Info.Status.Alerts"
PARAMETER_NEW_ALERTS: Final = "Info.Status.New Alerts"
PARAMETER_BUMPED: Final = "Param.Bump Detector.Bumped"
PARAMETER_BUMP_CLEAR: Final = "Param.Bump Detector.Clear"
PARAMETER_TIMEOUT_PREFIX: Final = "Info.Timeout."

FRAME_RATE_HZ: Final = 60.0  # the frame number counts at this rate, whatever the illuminator rate
ILLUMINATOR_RATES_HZ: Final = MappingProxyType({0: 20, 1: 30, 2: 60})

# Answer to SFLIST 03: one digit count, then this many characters per volume, the last one LF.
SFLIST_VOLUMES: Final = "03"
SFLIST_VOLUME_CHARACTERS: Final = 74
SFLIST_DIMENSIONS: Final = 10  # D1..D10, each sign and 6 digits
SFLIST_DIMENSION_CHARACTERS: Final = 7
SFLIST_DIMENSION_SCALE: Final = 100  # per mm; slopes are per 1000

ERROR_MEANINGS: Final = MappingProxyType(
    {
        0x01: "unknown command",
        0x02: "command too long",
        0x03: "command too short",
        0x04: "command arrived with a wrong CRC",
        0x05: "command timed out inside the unit",
        0x06: "the unit cannot set those communication parameters",
        0x07: "wrong number of parameters",
        0x08: "bad port handle",
        0x09: "bad tracking priority",
        0x0A: "bad LED number",
        0x0B: "bad LED state",
        0x0C: "not valid in the current mode of the unit",
        0x0D: "no tool on that handle",
        0x0E: "handle not initialised",
        0x0F: "handle not enabled",
        0x10: "unit not initialised",
        0x11: "cannot stop tracking",
        0x12: "cannot start tracking",
        0x13: "cannot initialise the tool: its definition is faulty",
        0x14: "bad sensor characterisation data",
        0x15: "cannot initialise the unit",
        0x16: "cannot start diagnostic mode",
        0x17: "cannot stop diagnostic mode",
        0x18: "infrared check failed",
        0x19: "cannot read a firmware version",
        0x1A: "internal error of the unit",
        0x1B: "infrared detection not initialised",
        0x1C: "bad marker firing signature",
        0x1D: "no tool memory found",
        0x1E: "cannot read the tool's memory",
        0x1F: "cannot write the tool's memory",
        0x20: "cannot select the tool's memory",
        0x21: "tool current test failed",
        0x22: "the selected volume does not support the wavelength of an enabled tool",
        0x23: "parameter out of range",
        0x24: "cannot select that volume",
        0x25: "feature list unavailable",
        0x26: "reserved code 26",
        0x27: "reserved code 27",
        0x28: "too many tools enabled, or a tool type that is not supported",
        0x29: "firmware corrupt",
        0x2A: "the unit is out of memory",
        0x2B: "handle was never allocated",
        0x2C: "handle became unoccupied",
        0x2D: "no port handles left",
        0x2E: "incompatible firmware versions",
        0x2F: "bad port description",
        0x30: "port already has a handle",
        0x31: "reserved code 31",
        0x32: "operation not valid for the device on that handle",
        0x33: "feature not available",
        0x34: "no such user parameter",
        0x35: "wrong type of value",
        0x36: "value out of range",
        0x37: "array index out of range",
        0x38: "wrong size",
        0x39: "permission denied: the parameter is read-only",
        0x3A: "reserved code 3A",
        0x3B: "file not found",
        0x3C: "file write error",
        0x3D: "file read or remove error",
        0x3E: "reserved code 3E",
        0x3F: "reserved code 3F",
        0x40: "tool definition corrupt",
        0x41: "tool definition exceeds the limits of markers, faces or groups",
        0x42: "a required device is not connected",
        0xF1: "too much ambient infrared",
        0xF4: "flash erase failed",
        0xF5: "flash write failed",
        0xF6: "flash read failed",
    }
)

WARNING_MEANINGS: Final = MappingProxyType(
    {
        0x01: "possible hardware fault",
        0x02: "tool breaks the unique-geometry rules",
        0x03: "tool conflicts with another loaded tool",
        0x04: "tool breaks the unique-geometry rules and conflicts with another loaded tool",
        0x05: "tool specifies no wavelength; the default is used",
    }
)

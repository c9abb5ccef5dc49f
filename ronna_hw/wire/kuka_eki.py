"""Vocabulary of the project's EKI channel: elements, attributes, commands, codes and their meanings.

The controller is the TCP server. A client writes `<Cmd Id= Name= ...></Cmd>`; every command is answered by
`<Ack Id= Cmd= Code= Text=></Ack>`, STATUS by `<State ...><Axis .../><Pos .../></State>`, which is also sent
unsolicited on a change and every 100 ms. Elements are closed by a separate end tag, as EthernetKRL writes
them. Attribute values are text: BOOL "1"/"0", numbers with a decimal point. No encoding or decoding here.
"""

from __future__ import annotations

from enum import IntEnum, StrEnum

PROJECT_PORT = 54602  # EKI reserves ports 54600 to 54615 on a KR C4; 54600 is the control SDK's
STATE_PERIOD_MS = 100
FIRST_REQUEST_LIMIT_MS = 10_000  # a client without any request since it connected is disconnected

CMD = "Cmd"
ACK = "Ack"
STATE = "State"
AXIS = "Axis"
POS = "Pos"

AXIS_ATTRIBUTES = ("A1", "A2", "A3", "A4", "A5", "A6")  # deg
POS_ATTRIBUTES = ("X", "Y", "Z", "A", "B", "C", "S", "T")  # mm, deg, status and turn as integers


class CommandName(StrEnum):
    """Values of a Cmd's Name attribute."""

    STATUS = "STATUS"
    RSI_START = "RSI_START"  # Cycle 4|12, Ref ABS|REL, Corr AXIS|POS
    RSI_STOP = "RSI_STOP"
    DRIVES = "DRIVES"  # On 0|1
    SET_OV = "SET_OV"  # Val 1..100
    SET_TOOL = "SET_TOOL"  # No 1..16, X..C, M, CX CY CZ
    SET_BASE = "SET_BASE"  # No 1..32, X..C
    PTP_AXIS = "PTP_AXIS"  # A1..A6, Vel, Acc in percent
    PTP_POS = "PTP_POS"  # X..C, S, T, Tool, Base
    LIN = "LIN"  # X..C, S, T, Tool, Base, Vel in m/s
    STOP = "STOP"  # Kind PATH|FAST
    ACK_ERRORS = "ACK_ERRORS"
    SELECT = "SELECT"
    CANCEL = "CANCEL"


class AckCode(IntEnum):
    """Values of an Ack's Code attribute."""

    OK = 0
    REFUSED = 1  # in this state
    BAD_VALUE = 2
    LIMIT = 3
    BUSY = 4
    NOT_READY = 5  # drives, emergency stop, guard
    TIMEOUT = 6
    ABORTED = 7


class StateAttribute(StrEnum):
    """Attributes of a State element, in the order written by the controller."""

    ID = "Id"
    MODE = "Mode"  # OperationMode
    DRIVES = "Drives"
    ESTOP = "EStop"
    GUARD = "Guard"
    PRO_STATE = "ProState"
    MOVING = "Moving"
    OVERRIDE = "Ov"  # percent
    ERROR = "Err"  # number of the active message, 0 is none
    RSI = "RSI"  # RsiState
    TOOL = "Tool"  # tool number reported by the tool changer's inputs, 0 is none
    BASE = "Base"
    STOPMESS = "Stopmess"
    REFERENCE = "Ref"  # Reference
    HOLDON = "HoldOn"  # 1 if every correction channel keeps its value over a missing reply
    CYCLE = "Cycle"  # ms
    CONTEXT_HASH = "CtxHash"  # ronna_hw.wire.kuka_context.context_hash of the context that the program loads
    VARIANT = "Variant"  # name in ronna_hw.arm.catalogue
    SERIAL = "Serial"  # of the arm; 0 if the controller does not have it
    BRAKES = "Brakes"  # one bit for each axis, A1 the lowest; set if the brake is open


class OperationMode(StrEnum):
    """Positions of the controller's mode switch."""

    T1 = "T1"
    T2 = "T2"
    AUT = "AUT"
    EXT = "EXT"


class ProState(StrEnum):
    """Values of $PRO_STATE1."""

    FREE = "P_FREE"
    RESET = "P_RESET"
    ACTIVE = "P_ACTIVE"
    STOP = "P_STOP"
    END = "P_END"


class RsiState(IntEnum):
    """States of the RSI program."""

    IDLE = 0
    ON = 1  # streaming, corrections not effective yet
    MOVECORR = 2  # corrections are effective
    FAULT = 3  # cleared by ACK_ERRORS


class Reference(StrEnum):
    """How corrections accumulate: relative or absolute."""

    ABSOLUTE = "ABS"
    RELATIVE = "REL"


class Correction(StrEnum):
    """Corrected quantity."""

    AXIS = "AXIS"
    POSITION = "POS"


class StopRequest(StrEnum):
    """Kinds of STOP."""

    PATH = "PATH"
    FAST = "FAST"

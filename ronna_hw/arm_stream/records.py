"""Data exchanged between driver and real-time process: settings, orders, commands, states, results."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from enum import IntEnum
from typing import Annotated, Any, NamedTuple, Self

from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.clearance.live_watch import ViolationKind
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.motion.planning import MotionPlan
from ronna_hw.arm_stream.drill_feed import BINS, DrillWatch
from ronna_hw.arm_stream.guided import GuideLimits
from ronna_hw.host.row_codec import IPV4_HOST, one_of
from ronna_hw.vectors import JointVector, Vector3

VIOLATIONS = ("", *ViolationKind)
NOTHING_AROUND = Surroundings()
NO_DESCRIPTOR = -1
STOP_KIND_BITS = 3  # lowest bits of the stop word: its kind; above them its number
STOP_KIND = (1 << STOP_KIND_BITS) - 1
LOAD_SIGNALS = 15  # currents and expected currents of six axes, force on the tool
AXES = 6  # of the arms whose links these rows are of
Joints = Annotated[JointVector, f"{AXES}d"]
_ZEROS: JointVector = (0.0,) * AXES


@dataclass(frozen=True, kw_only=True)
class StreamSettings:
    """Settings of the real-time process that every protocol needs; a driver adds its own."""

    parent_pid: int
    mailbox_fd: int = NO_DESCRIPTOR
    event_fd: int = NO_DESCRIPTOR
    silence_limit_s: float
    heartbeat_limit_s: float
    settle_tolerance_deg: float
    real_time_priority: int
    rehearsal_lead_us: int = 0  # how long before its telegram is due the reply is rehearsed; 0 is never
    keeps_pace: bool = True  # telegrams may come at the host's pace; False: theatre time does not follow it
    force_filter_s: float = 0.0  # of the estimated force on the tool; 0: the arm estimates none
    force_at_rest_N: float = 0.0  # above, no motion with a force limit starts
    keeps_bytes: bool = False  # telegrams and replies are kept for the driver to fetch

    def to_json(self) -> str:
        """Encode as one line of JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, line: str) -> Self:
        """Decode a line from `to_json`; raises TypeError or ValueError if it is invalid."""
        values: dict[str, Any] = json.loads(line)
        if not isinstance(values, dict):
            raise TypeError("the settings are not an object")
        values = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
        return cls(**values)


class StopOrder(IntEnum):
    """Stop kinds as in `ronna_hw.devices.StopKind`, in ascending order of strength."""

    HOLD = 1
    PROTECTIVE = 2
    LINK = 3
    DRIVES_OFF = 4


class StreamPhase(IntEnum):
    """Phase of the real-time process."""

    STARTING = 0
    IDLE = 1  # no stream: telegrams are not answered
    ARMED = 2  # a stream is open, the first telegram has not arrived
    RUNNING = 3
    FAULT = 4  # latched: stopping or at rest, telegrams are answered with the last point
    ENDING = 5  # Stop is being sent
    SILENT = 6  # replies have been stopped on request
    FAILED = 7  # could not start; `errno` is the reason


class LinkFault(IntEnum):
    """Cause of a latched FAULT."""

    NONE = 0
    MONITOR = 1
    SILENCE = 2
    HEARTBEAT = 3
    PROTECTIVE = 4
    LINK_STOP = 5
    DRIVES_OFF = 6
    PATH = 7
    RESTARTED = 8
    BASE = 9  # the first telegram's axes are outside the joint ranges
    LOSSES = 10  # too many cycles without an effective reply
    CONTROLLER = 11  # the controller reports in its telegrams that it has stopped the arm, or our program
    BROKEN = 12  # the connection ended, or carried something that is no telegram


class MotionResult(IntEnum):
    """Outcome of the last motion."""

    NONE = 0
    RUNNING = 1
    DONE = 2  # the path ended and the arm settled, if it was to
    STOPPED = 3  # stopped on the way, and settled
    REFUSED_BUSY = 4
    REFUSED_START = 5  # planned from a different position
    REFUSED_PHASE = 6
    REFUSED_NUMBERS = 7
    REFUSED_STOP = 8  # a stop was ordered after the motion was planned
    REFUSED_LOADED = 9  # a force acts on the tool, or is not known
    FORCE = 10  # stopped on the way by its force limit, and settled
    THROUGH = 11  # stopped on the way because a drill broke through, and settled
    STALLED = 12  # stopped on the way because a drill did not cut, and settled
    BONELESS = 13  # stopped on the way because a drill had met no bone, and settled
    ASIDE = 14  # stopped on the way because a force across its axis pushed a drill, and settled
    HIDDEN = 15  # stopped on the way because such a force hid whether bone resists, and settled

    @property
    def is_refused(self) -> bool:
        """Whether the motion has not begun."""
        return self.name.startswith("REFUSED_")

    @property
    def is_by_force(self) -> bool:
        """Whether a force on the tool stopped the motion, with nothing known to be well."""
        return self in (MotionResult.FORCE, MotionResult.STALLED, MotionResult.ASIDE, MotionResult.HIDDEN)


class Choice(IntEnum):
    """Set-point selected for a reply."""

    GO = 0
    STOP = 1
    REPEAT = 2  # the last point again: it was not accepted, and the path waits for it
    HOLD = 3  # the point that the controller holds: only correct after it has held it for some cycles


class Orders(NamedTuple):
    """Order words that the real-time process reads in every cycle."""

    heartbeat: int
    stop_word: int
    command_number: int


class OpenStream(NamedTuple):
    """Answer the next telegrams; the first correction is zero."""

    limits: MotionLimits  # of the whole stream
    axes_rad: JointVector | None = None  # recognise the controller's first telegram; None: any


class ForceLimit(NamedTuple):
    """Limit of the change of the force on the tool during a motion."""

    limit_N: float = 0.0  # 0: none
    goes_on: bool = False  # with the motion before: its tare is kept, so what presses at rest counts
    drill: DrillWatch | None = None  # of a drill, whose feed follows the force


NO_LIMIT = ForceLimit()


class Move(NamedTuple):
    """Follow a planned path to its end, and until the arm has settled there."""

    plan: MotionPlan
    force: ForceLimit = NO_LIMIT
    settles: bool = True


class GuideByHand(NamedTuple):
    """Follow a hand until stopped."""

    limits: GuideLimits
    force_limit_N: float


@dataclass(frozen=True)
class EndStream:
    """At rest, send Stop until the telegrams cease."""


@dataclass(frozen=True)
class CloseStream:
    """Stop answering; clears a fault."""


Request = OpenStream | Move | GuideByHand | EndStream | CloseStream


class Command(NamedTuple):
    """Command to the real-time process."""

    number: int
    request: Request
    stop_number: int = 0  # the last stop known when it was written: a later stop overrides a motion
    surroundings: Surroundings = NOTHING_AROUND  # used to monitor a motion


@dataclass(slots=True)
class LinkState:
    """State of the real-time process, published once per cycle; angles in rad.

    Not frozen: the process fills it by name in every cycle, at a fraction of the cost of a call by name.
    """

    cycles: Annotated[int, "Q"] = 0
    device_clock: Annotated[int, "Q"] = 0  # of the last telegram, in the controller's own unit
    received_ns: Annotated[int, "q"] = 0
    phase: Annotated[StreamPhase, "B"] = StreamPhase.STARTING
    fault: Annotated[LinkFault, "B"] = LinkFault.NONE
    result: Annotated[MotionResult, "B"] = MotionResult.NONE
    degraded: bool = False
    moving: bool = False
    settled: bool = False
    real_time: bool = False
    locked: bool = False
    command_number: Annotated[int, "Q"] = 0
    stop_number: Annotated[int, "Q"] = 0  # the last stop order seen
    late: Annotated[int, "Q"] = 0  # the controller's count
    lost: Annotated[int, "Q"] = 0  # telegrams that never arrived, from the gap in the device clock
    rejected: Annotated[int, "Q"] = 0
    dropped: Annotated[int, "Q"] = 0  # older ones queued up behind a stall
    foreign: Annotated[int, "Q"] = 0  # from senders other than the controller
    foreign_host: Annotated[str, IPV4_HOST] = ""  # of the last such sender, or the next one; "" for none
    disagreeing: Annotated[int, "Q"] = 0  # reported other axes than expected before the stream began
    measured_rad: Joints = _ZEROS
    commanded_rad: Joints = _ZEROS
    base_rad: Joints = _ZEROS
    violation_kind: Annotated[str, one_of(VIOLATIONS)] = ""
    violation_axis: Annotated[int, "I"] = 0
    violation_value: float = 0.0
    violation_limit: float = 0.0
    speed_share: float = 1.0  # of the planned speed, that the controller and losses leave
    controller_word: Annotated[int, "Q"] = 0  # what the controller reports, as its driver packs it
    force_N: Vector3 = (0.0, 0.0, 0.0)  # on the tool, in the robot base, filtered
    is_force_known: bool = True  # the last telegram had a force
    peak_force_N: float = 0.0  # largest change during the last motion with a force limit
    drilled_cycles: Annotated[int, "Q"] = 0  # of the last motion of a drill
    slowed_cycles: Annotated[int, "Q"] = 0  # of these, with less than the planned feed
    drilled_N: Annotated[tuple[float, ...], f"{BINS}d"] = (0.0,) * BINS  # largest forces along its path
    side_force_N: float = 0.0  # largest change across the axis of the last motion of a drill
    is_in_bone: bool = False  # it has met bone
    is_through: bool = False  # it has broken through
    free_share: float = 0.0  # way up to where it is on which nothing resisted, of that of a breakthrough
    carries_loads: bool = False  # the last telegram has signals of the load
    load_since: Annotated[int, "Q"] = 0  # first cycle of the present standstill whose load signals are summed
    load_cycles: Annotated[int, "Q"] = 0  # how many they are by now; 0 while the arm moves
    load_sums: Annotated[tuple[float, ...], f"{LOAD_SIGNALS}d"] = (0.0,) * LOAD_SIGNALS
    errno: Annotated[int, "i"] = 0


NO_STATE = LinkState()


class RecordedCycle(NamedTuple):
    """Flight recorder entry for one cycle; times are host monotonic."""

    cycle: Annotated[int, "Q"]
    device_clock: Annotated[int, "Q"]
    received_ns: Annotated[int, "q"]
    turnaround_us: float
    measured_rad: Joints
    sent_rad: Joints
    choice: Annotated[Choice, "B"]

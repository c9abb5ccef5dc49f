"""Common device interface and lifecycle, and activation for the duration of a block.

DISCONNECTED -> CONNECTED (identity and version checked) -> CONFIGURED -> ACTIVE <-> HOLD; FAULT is latched
and cleared only by an explicit `recover`, which re-reads the device; CLOSED is final. Reading is allowed from
CONNECTED, motion only in ACTIVE.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, Protocol, Self, TypeVar, runtime_checkable
from unicodedata import category

from ronna_hw.devices.capabilities import Fact
from ronna_hw.devices.errors import OTHER_PROCESS, THEATRE_CLOSED, PersonNotNamed, WrongState
from ronna_hw.errors import RonnaError
from ronna_hw.host.process import defer_interruption
from ronna_hw.logs import logger

LONGEST_NAME = 60  # characters of a person's name
LINE_SIGNS = ("Zl", "Zp")  # categories of Unicode
JOINERS = "\u200c\u200d"  # parts of names in some scripts
HELD = "An arm goes on after `resume`, without a motion; a tracker that is too warm or cold by itself."
R = TypeVar("R")
R_co = TypeVar("R_co", covariant=True)


class Lifecycle(StrEnum):
    """Lifecycle states of a device."""

    DISCONNECTED = "disconnected"
    CONNECTED = "connected"
    CONFIGURED = "configured"
    ACTIVE = "active"
    HOLD = "hold"
    FAULT = "fault"
    CLOSED = "closed"


RUNNING = frozenset({Lifecycle.ACTIVE, Lifecycle.HOLD})
READABLE = frozenset({Lifecycle.CONNECTED, Lifecycle.CONFIGURED, Lifecycle.ACTIVE, Lifecycle.HOLD})
_NEXT = {  # the call that leads on; from the others there is a choice, or none
    Lifecycle.DISCONNECTED: "connect",
    Lifecycle.CONNECTED: "configure",
    Lifecycle.CONFIGURED: "activate",
}
_ALLOWED: dict[Lifecycle, set[Lifecycle]] = {  # and from each but CLOSED to CLOSED
    Lifecycle.DISCONNECTED: {Lifecycle.CONNECTED},
    Lifecycle.CONNECTED: {Lifecycle.CONFIGURED, Lifecycle.DISCONNECTED},
    Lifecycle.CONFIGURED: {Lifecycle.ACTIVE, Lifecycle.CONNECTED, Lifecycle.DISCONNECTED},
    Lifecycle.ACTIVE: {Lifecycle.HOLD, Lifecycle.CONFIGURED, Lifecycle.DISCONNECTED},
    Lifecycle.HOLD: {Lifecycle.ACTIVE, Lifecycle.CONFIGURED, Lifecycle.DISCONNECTED},
    # A fault is cleared only by `recover`, which ends in the state of the re-read device.
    Lifecycle.FAULT: {Lifecycle.CONNECTED, Lifecycle.CONFIGURED},
    Lifecycle.CLOSED: set(),
}


@dataclass(frozen=True)
class Identity:
    """Device identity as read on connecting, never taken from the configuration."""

    vendor: str
    model: str
    serial: str
    firmware: str
    details: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class LastKnown(Generic[R_co]):
    """Last known state, latched fault and reading; the reading's stamp tells its age."""

    state: Lifecycle
    fault: RonnaError | None
    reading: R_co | None
    says: tuple[Fact, ...] = ()  # what the device reported unsolicited
    stopped: bool = False  # by a fault that is not latched yet, as its cause is still being asked for


@runtime_checkable
class Device(Protocol):
    """Common interface of all devices. Calls are synchronous, with time limits in seconds."""

    @property
    def name(self) -> str:
        """Device name in the theatre file, such as `tracker` or `robot.master`."""

    @property
    def wire_protocol(self) -> str:
        """Wire protocol, such as `ndi-polaris`, which selects the byte-level conformance cases.

        Empty if the conformance suite does not know it.
        """

    @property
    def state(self) -> Lifecycle:
        """Current lifecycle state."""

    @property
    def fault(self) -> RonnaError | None:
        """Error that latched FAULT, or None in any other state."""

    @property
    def notices(self) -> tuple[str, ...]:
        """Non-error observations from `configure` of interest to the operator."""

    def observe(self) -> LastKnown[object]:
        """State, fault and latest reading as last seen. Allowed in any state, including
        CLOSED, and any thread.

        Passive: sends nothing to the device, latches nothing, never raises.
        """

    def active(self, timeout_s: float = 10.0) -> AbstractContextManager[Self]:
        """Activate the device for a `with` block, whatever its state, and deactivate it on exit.

        `hold_active` implements this for every driver.
        """

    def connect(self, timeout_s: float = 10.0) -> Identity:
        """Open the connection and check identity and version.

        Raises ConnectError when nothing, or a different device, replies.
        """

    def configure(self, timeout_s: float = 10.0) -> None:
        """Apply a known, verified configuration: CONNECTED -> CONFIGURED."""

    def activate(self, timeout_s: float = 10.0) -> None:
        """Start measuring or streaming: CONFIGURED -> ACTIVE."""

    def deactivate(self, timeout_s: float = 10.0) -> None:
        """Stop measuring or streaming: ACTIVE or HOLD -> CONFIGURED."""

    def recover(self, acknowledged_by: str, timeout_s: float = 10.0) -> None:
        """Re-read and reconfigure the device after a fault: FAULT -> CONFIGURED. Call `activate` next.

        Moves nothing. Raises DEV-006 without a name.
        """

    def close(self) -> None:
        """Close the connection in bounded time; a vanished peer raises no error."""


D = TypeVar("D", bound=Device)


@contextmanager
def hold_active(device: D, timeout_s: float = 10.0) -> Iterator[D]:
    """Connect and configure as needed, activate, and deactivate on leaving the block.

    `timeout_s` limits each of these calls. A device in HOLD is restarted; one that is already active is used
    as it is and left active. An error in the block is never masked: a failure to deactivate is added to it as
    a note. Raises the errors of `connect`, `configure` and `activate`, DEV-001 for a device in FAULT, and
    DEV-010 for one that is closed.
    """
    if device.state is Lifecycle.ACTIVE:  # activated by someone else, who also deactivates it
        yield device
        return
    _activate(device, timeout_s)
    try:
        yield device
    except BaseException as problem:  # including interruptions: the device stops whatever ended the block
        with defer_interruption():
            try:
                _deactivate(device, timeout_s)
            except Exception as error:
                problem.add_note(f"{device.name} could not be deactivated: {error}")
        raise
    with defer_interruption():
        _deactivate(device, timeout_s)


def _activate(device: Device, timeout_s: float) -> None:
    if device.state is Lifecycle.HOLD:
        device.deactivate(timeout_s)
    if device.state is Lifecycle.DISCONNECTED:
        device.connect(timeout_s)
    if device.state is Lifecycle.CONNECTED:
        device.configure(timeout_s)
    device.activate(timeout_s)


def _deactivate(device: Device, timeout_s: float) -> None:
    """Deactivate, except in FAULT, where the device has already stopped and needs `recover`."""
    if device.state in RUNNING:
        device.deactivate(timeout_s)


def require_person(name: str) -> str:
    """Validate and return a person's name; raises DEV-006 for one that does not name anybody.

    A name is printed, and written into records: it may neither steer a terminal nor look like two lines, or
    like the name of another person.
    """
    needed, got = "the name of a person is needed", repr(name) if name.strip() else "nothing"
    if not any(map(str.isalpha, name)):
        raise PersonNotNamed(needed, expected="letters", got=got)
    if any(_is_hidden(letter) for letter in name):
        expected = "a name without control characters and invisible signs"
        raise PersonNotNamed(needed, expected=expected, got=got)
    if len(name) > LONGEST_NAME:
        raise PersonNotNamed(needed, limit=f"{LONGEST_NAME} characters", got=f"{len(name)} characters")
    return name


def _is_hidden(letter: str) -> bool:
    """Whether a character is a control, format or line character, and no joiner of a name."""
    kind = category(letter)
    return (kind.startswith("C") or kind in LINE_SIGNS) and letter not in JOINERS


class LifecycleGuard:
    """State machine of a driver: refuses forbidden calls, latches faults, logs transitions."""

    def __init__(self, device: str) -> None:
        self.log = logger(device=device)
        self._device = device
        self._process = os.getpid()
        # One value, replaced atomically: another thread never sees half of a change.
        self._now: tuple[Lifecycle, RonnaError | None] = (Lifecycle.DISCONNECTED, None)
        self._changing = threading.RLock()  # a signal handler may interrupt a change of its own thread

    @property
    def state(self) -> Lifecycle:
        return self._now[0]

    @property
    def fault(self) -> RonnaError | None:
        """Error that latched FAULT, if any."""
        return self._now[1]

    def last_known(
        self, reading: R | None, says: tuple[Fact, ...] = (), *, stopped: bool = False
    ) -> LastKnown[R]:
        """Build the result of `Device.observe` with the driver's latest reading."""
        return LastKnown(*self._now, reading, says, stopped)

    def require(self, call: str, allowed: Iterable[Lifecycle]) -> None:
        """Raise DEV-001 unless the state is one of `allowed`, DEV-010 once the device is closed.

        After a latched fault the error quotes it, and has its exit code. Raises DEV-016 in another process.
        """
        self.require_own_process(call)
        states = tuple(allowed)
        state, fault = self._now
        if state in states:
            return
        if state is Lifecycle.CLOSED:
            raise THEATRE_CLOSED(f"{self._device}: {call} came after it was closed with its theatre")
        cause, following = f" ({fault})" if fault else "", _NEXT.get(state)
        refused = WrongState(
            f"{self._device}: {call} is not allowed now",
            expected=" or ".join(sorted(states)),
            got=f"{state}{cause}",
            action=HELD
            if state is Lifecycle.HOLD
            else following and f"Once {state}, `{following}` comes next.",
        )
        if fault is not None:
            refused.exit_code = fault.exit_code
        raise refused

    def require_own_process(self, call: str) -> None:
        """Raise DEV-016 in a process that did not open the device: its threads and links are not there."""
        if os.getpid() != self._process:
            raise OTHER_PROCESS(
                f"{self._device}: {call} came in process {os.getpid()}",
                expected=f"process {self._process}, which opened it",
            )

    def enter(self, state: Lifecycle, **facts: object) -> None:
        """Enter `state` and log it with `facts`; raises DEV-001 for a forbidden transition."""
        with self._changing:
            before = self.state
            if state is before:
                return
            is_closing = state is Lifecycle.CLOSED and before is not Lifecycle.CLOSED
            if not is_closing and state not in _ALLOWED[before]:
                raise WrongState(f"{self._device}: cannot go from {before} to {state}")
            self._now = (state, None)
        self.log.info(state, before=before, **facts)

    def exchange(self, before: Lifecycle, after: Lifecycle) -> bool:
        """Enter `after` if the state is still `before`; returns whether it was."""
        with self._changing:
            if self.state is not before:
                return False
            self.enter(after)
            return True

    def latch(self, cause: RonnaError) -> None:
        """Enter FAULT from any state except CLOSED, keeping the first cause."""
        with self._changing:
            before = self.state
            if before in (Lifecycle.CLOSED, Lifecycle.FAULT):
                return
            self._now = (Lifecycle.FAULT, cause)
        self.log.error(Lifecycle.FAULT, before=before, cause=cause)


class GuardedDevice:
    """Base of a driver: its name, and the state that its guard keeps."""

    def __init__(self, name: str, guard: LifecycleGuard) -> None:
        self._name, self._guard = name, guard

    @property
    def name(self) -> str:
        return self._name

    @property
    def state(self) -> Lifecycle:
        return self._guard.state

    @property
    def fault(self) -> RonnaError | None:
        """Error that latched FAULT, if any."""
        return self._guard.fault

    def __repr__(self) -> str:
        fault = f": {self._guard.fault}" if self._guard.fault else ""
        return f"<{type(self).__name__} {self._name}: {self._guard.state}{fault}>"

    def active(self: D, timeout_s: float = 10.0) -> AbstractContextManager[D]:
        return hold_active(self, timeout_s)

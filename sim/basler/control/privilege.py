"""The control channel privilege (CCP) of a camera, and its heartbeat time-out."""

from __future__ import annotations

from collections.abc import Callable

from ronna_hw.wire.gige_vision import CCP_CONTROL, CCP_EXCLUSIVE, CCP_OPEN, HEARTBEAT_MINIMUM_MS, GevStatus

DEFAULT_HEARTBEAT_MS = 3000

Peer = tuple[str, int]
"""Address and port of an application."""

OTHER_APPLICATION: Peer = ("0.0.0.0", 0)
"""The application put in control by a fault; it never times out."""


class Privilege:
    """The application in control and its heartbeat, renewed by each of its commands.

    `released` is called when control ends, by request or by time-out; `now_s` is the host's monotonic clock.
    """

    def __init__(self, now_s: Callable[[], float], released: Callable[[], None]) -> None:
        self._now_s = now_s
        self._released = released
        self._heartbeat_ms = DEFAULT_HEARTBEAT_MS
        self.owner: Peer | None = None  # the application in control
        self.value = CCP_OPEN  # content of the CCP register
        self._refreshed_s = 0.0

    @property
    def heartbeat_ms(self) -> int:
        """Time without a command after which the owner loses control."""
        return self._heartbeat_ms

    @heartbeat_ms.setter
    def heartbeat_ms(self, value: int) -> None:
        self._heartbeat_ms = max(HEARTBEAT_MINIMUM_MS, value)

    def may_read(self, peer: Peer) -> bool:
        """Return whether no other application has exclusive access."""
        return self.owner in (None, peer) or not self.value & CCP_EXCLUSIVE

    def may_write(self, peer: Peer) -> bool:
        """Return whether this application is in control."""
        return self.owner == peer

    def request(self, peer: Peer, value: int) -> GevStatus:
        """Write the CCP register and return the GVCP status."""
        if self.owner not in (None, peer):
            return GevStatus.ACCESS_DENIED
        if value & ~(CCP_EXCLUSIVE | CCP_CONTROL):
            return GevStatus.INVALID_PARAMETER  # no switch-over
        if value == CCP_OPEN:
            self.drop()
            return GevStatus.SUCCESS
        self.owner, self.value = peer, value
        self._refreshed_s = self._now_s()
        return GevStatus.SUCCESS

    def refresh_heartbeat(self, peer: Peer) -> None:
        """Record a command from this application."""
        if peer == self.owner:
            self._refreshed_s = self._now_s()

    def seize(self, is_seized: bool) -> None:
        """Give control to another application while `is_seized`, regardless of the present owner."""
        if is_seized and self.owner != OTHER_APPLICATION:
            self.drop()
            self.owner, self.value = OTHER_APPLICATION, CCP_CONTROL
        elif not is_seized and self.owner == OTHER_APPLICATION:
            self.drop()

    def drop(self) -> None:
        """Release control on behalf of the owner."""
        if self.owner is not None:
            self._release()

    def seconds_left(self) -> float | None:
        """Return the seconds until the owner loses control, or None if no heartbeat is expected."""
        if self.owner in (None, OTHER_APPLICATION):
            return None
        return self._refreshed_s + self._heartbeat_ms / 1e3 - self._now_s()

    def expire(self) -> None:
        """Withdraw control from an owner whose heartbeat has timed out."""
        left_s = self.seconds_left()
        if left_s is not None and left_s <= 0.0:
            self._release()

    def _release(self) -> None:
        self.owner, self.value = None, CCP_OPEN
        self._heartbeat_ms = DEFAULT_HEARTBEAT_MS
        self._released()

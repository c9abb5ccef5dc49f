"""Checkpoints of a case: between steps, before each motion, and after an interrupted motion.

The operator asks for a rest from any thread, by `pause` or `abort`; the engine's own thread rests at the next
checkpoint. A watch stops the arm by itself, and its error is raised when the motion that `watching` holds has
ended.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol, runtime_checkable

from procedures.operator.errors import GuardUnmet, OperatorAborted
from procedures.operator.question import Question, Topic
from ronna_hw.clock import Clock

PAUSED, SUSPENDED = "paused", "suspended"  # how a case may rest: states of its chart
CONTINUE, WAIT, ABORT, LEAVE = "continue", "wait", "abort", "leave"
CHOICES = "wait continues as soon as the condition is met, leave ends the step here with the arm at rest"
WITHOUT = "continue proceeds without it for {:.0f} s of the next motion or wait, then asks again"
LOOK_AGAIN_S = 0.05  # theatre time between two looks at a guard
PATIENCE_S = 20.0  # theatre time for a guard to be met by itself before the operator is asked


class Guard(Protocol):
    """Condition that must hold while the arm works."""

    @property
    def name(self) -> str:
        """Name, such as `disk space` or `line of sight`."""
        ...

    def unmet(self) -> str | None:
        """Check the condition. Return in plain words why the case cannot continue, or None if it can.

        No query: a guard may read devices for a second, record findings, void results and put a check of the
        tool in doubt. Raises only what ends the step.
        """
        ...


@runtime_checkable
class DispensableGuard(Guard, Protocol):
    """Guard that the operator may excuse temporarily."""

    @property
    def topic(self) -> Topic:
        """Topic of the question."""
        ...

    @property
    def patience_s(self) -> float:
        """Theatre time to wait before asking the operator, overriding `PATIENCE_S`."""
        ...

    @property
    def excused_for_s(self) -> float:
        """Theatre time of the next motion or wait for which `excuse` remains valid."""
        ...

    def excuse(self) -> None:
        """Excuse the guard temporarily."""
        ...


class Checkpoint:
    """Checkpoint that rests a case on request or for an unmet guard, and asks before it continues."""

    def __init__(
        self,
        ask: Callable[[Question], str],
        rest: Callable[[str, str], AbstractContextManager[None]],
        clock: Clock,
    ) -> None:
        """Set up the checkpoint. The context `rest(state, reason)` is active while the case rests."""
        self.guards: list[Guard] = []
        self.beside: Callable[[], AbstractContextManager[None]] = nullcontext  # held while guards look
        # Held, with what is done and the kind of motion, also while an instrument is at its target (None).
        self.watching: Callable[[str, str | None], AbstractContextManager[None]] = lambda _what, _motion: (
            nullcontext()
        )
        self._ask = ask
        self._rest = rest
        self._clock = clock
        self._lock = threading.RLock()  # reentrant: a signal handler may interrupt its holder
        self._pause: str | None = None
        self.firm = False  # of the pause
        self._abort = False

    def pause(self, reason: str = "the operator asked for a pause", *, firm: bool = False) -> None:
        """Request a pause at the next checkpoint. A `firm` one, as after a stop, cannot be withdrawn."""
        with self._lock:
            self._pause = reason
            self.firm = self.firm or firm

    def withdraw_pause(self) -> bool:
        """Withdraw a pause request. Return False if there is none or it is firm."""
        with self._lock:
            if self.firm:
                return False
            wanted, self._pause = self._pause is not None, None
        return wanted

    def abort(self) -> None:
        """End the case at the next checkpoint."""
        with self._lock:
            self._abort = True

    @property
    def wanted(self) -> bool:
        """Whether a pause or abort is requested for the next checkpoint."""
        with self._lock:
            return self._abort or self._pause is not None

    def here(self, point: str) -> None:
        """Rest here if requested or if a guard is unmet.

        Raises PRO-004 when the case is to end, and PRO-017 when a guard is not restored and the operator
        leaves the step.
        """
        self._meet_requests(point)
        with self.beside():
            for guard in self.guards:
                self._meet(guard, point)

    def rest_after_stop(self, what: str, redo: str) -> None:
        """Rest after a motion was stopped externally, and return when it is to be replanned.

        Raises PRO-004, PRO-017.
        """
        if not self.wanted and not self._any_unmet():
            self.pause(f"{what} was stopped")
        self.here(f"{what} was stopped; continuing {redo}")

    def _meet_requests(self, point: str) -> None:
        self._meet_abort()
        with self._lock:
            reason, self._pause, self.firm = self._pause, None, False
        if reason is None:
            return
        with self._rest(PAUSED, reason):
            question = Question(Topic.PAUSE, f"Paused: {reason}", point, (CONTINUE, ABORT), timeout_s=None)
            if self._ask(question) != CONTINUE:
                raise OperatorAborted("the operator ended the procedure while it was paused")
        self._meet_requests(point)  # somebody may have requested another one meanwhile

    def _meet_abort(self) -> None:
        with self._lock:
            abort, self._abort = self._abort, False  # met once: the way home is still to come
            if abort:
                self._pause, self.firm = None, False  # it is not for the way home
        if abort:
            raise OperatorAborted("the operator ended the procedure")

    def _any_unmet(self) -> bool:
        with self.beside():
            return any(guard.unmet() is not None for guard in self.guards)

    def _meet(self, guard: Guard, point: str) -> None:
        reason = guard.unmet()
        if reason is None:
            return
        patience_s = guard.patience_s if isinstance(guard, DispensableGuard) else PATIENCE_S
        with self._rest(SUSPENDED, f"{guard.name}: {reason}"):
            since_s = self._clock.now_s()  # a look takes its time as well
            while (reason := guard.unmet()) is not None:
                self._meet_abort()  # a pause may wait: the arm rests
                if self._clock.now_s() - since_s >= patience_s:
                    answer = self._ask(_question(guard, reason, point))
                    if answer == CONTINUE and isinstance(guard, DispensableGuard):
                        guard.excuse()
                        continue
                    if answer != WAIT:
                        raise GuardUnmet(f"{guard.name}: {reason}")
                    since_s, patience_s = self._clock.now_s(), PATIENCE_S
                self._clock.sleep(LOOK_AGAIN_S)


def _question(guard: Guard, reason: str, point: str) -> Question:
    subject = f"{guard.name}: {reason}"
    if isinstance(guard, DispensableGuard):
        without = WITHOUT.format(guard.excused_for_s)
        return Question(guard.topic, subject, f"{point}; {CHOICES}; {without}", (WAIT, CONTINUE, LEAVE))
    return Question(Topic.GUARD, subject, f"{point}; {CHOICES}", (WAIT, LEAVE))

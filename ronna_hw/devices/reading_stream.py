"""Streams of device readings, for a loop, a task or a function.

    for frame in tracker.stream():  # the newest; what came meanwhile is counted in `dropped`
        print(frame.stamp.theatre_time_s)

    with tracker.stream(every=True).calling(record):
        ...

A thread of its own reads the device, so a slow consumer delays no reading. The device must be ACTIVE, an arm
CONNECTED, and is left as it was. Deactivating or closing the device ends its stream.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from inspect import iscoroutinefunction, signature
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

from ronna_hw.arguments import WrongArgument, require_time_s, show
from ronna_hw.devices.errors import (
    CALL_GOES_ON,
    DEVICE_STREAMS,
    NO_NEW_STATE,
    STREAM_BEHIND,
    STREAM_TAKEN,
)
from ronna_hw.devices.readings import ArmReading, StampedReading

MOST_WAITING = 1000  # readings, where every one is wanted: 17 s of a tracker
A_READING = (None,)  # one argument
NO_CLOCK = 0  # of a state that was asked for by EKI, outside of a running stream
BETWEEN_REQUESTS_S = 0.02  # host time: requests of a state leave the controller to others
END_LIMIT_S = 10.0  # host time, after a block, for calls of a function with what waits
ASK_AGAIN_S = 0.002  # host time between two looks whether an arm has moved on; a cycle of RSI takes 4 ms
R = TypeVar("R", bound=StampedReading)
R_co = TypeVar("R_co", covariant=True)


@runtime_checkable
class StreamsReadings(Protocol):
    """Device whose readings come as a stream."""

    def stream(self) -> Iterable[StampedReading]: ...


class NextReading(Protocol[R_co]):
    """Function that waits for a device's next reading."""

    def __call__(self, timeout_s: float) -> R_co: ...


class ReadingStream(Generic[R]):
    """Stream of one device's readings."""

    def __init__(
        self, read: NextReading[R], *, every: bool = False, timeout_s: float = 1.0, turn: Turn | None = None
    ) -> None:
        """Stream what `read` returns: the newest, or with `every` all of them, at most `MOST_WAITING` behind.

        `timeout_s` is host time for one reading. `turn` is that of a device for one thread at a time.
        """
        if not isinstance(every, bool):
            raise WrongArgument("every of a stream", expected="True or False", got=show(every))
        self._read, self._every = read, every
        self._timeout_s = require_time_s(timeout_s, "timeout_s of a stream")
        self._turn = Turn("the stream") if turn is None else turn
        self.dropped = 0  # readings that a newer one has replaced before they were taken

    def __iter__(self) -> Generator[R, None, None]:
        """Yield readings until the loop is left, the generator closed, or the device deactivated.

        Raises the device's errors, DEV-011 if every reading was asked for and too many wait, and DEV-013.
        """
        with self._reading() as session, suppress(_StreamEnded):
            while True:
                yield session.take()

    async def __aiter__(self) -> AsyncIterator[R]:
        """Yield readings to a task, whose event loop goes on meanwhile, also while the stream ends."""
        import asyncio  # not in a process of a case

        session = self._begin()
        try:
            with suppress(_StreamEnded):
                while True:
                    yield await asyncio.to_thread(session.take)
        finally:
            session.stop()
            await asyncio.to_thread(session.join)

    @contextmanager
    def calling(self, function: Callable[[R], object], *, end_limit_s: float = END_LIMIT_S) -> Iterator[None]:
        """Call a function with each reading, in a thread, while a block runs.

        An error of the function ends the stream, and is raised where the block ends. If every reading was
        asked for, those that wait are delivered there. Raises DEV-015 if that or the last call takes longer
        than `end_limit_s` of host time; what is not delivered counts as dropped. After an error in the block
        nothing more is delivered, and the function's error is a note on it.
        """
        _require_consumer(function)
        errors: list[BaseException] = []
        session = self._begin()

        def deliver() -> None:
            try:
                while True:
                    function(session.take())
            except _StreamEnded:
                pass
            except BaseException as error:  # whatever the function raises, also SystemExit
                errors.append(error)
                session.stop()

        thread = threading.Thread(target=deliver, name="reading consumer", daemon=True)
        thread.start()
        try:
            yield
        except BaseException as problem:
            self._end_calls(thread, session, end_limit_s)
            for error in errors:
                problem.add_note(f"The function that gets the readings raised {error!r}.")
            raise
        if self._every:
            session.finish()
            thread.join(end_limit_s)
        undelivered = self._end_calls(thread, session, end_limit_s if not self._every else self._timeout_s)
        if errors:
            raise errors[0]
        if undelivered or thread.is_alive():
            going = "a call of the function goes on, and " if thread.is_alive() else ""
            raise CALL_GOES_ON(
                f"{going}{undelivered} readings are not delivered", limit=f"{end_limit_s:g} s after the block"
            )

    def _end_calls(self, thread: threading.Thread, session: _Session[R], limit_s: float) -> int:
        """End a stream and wait for the function's last call; return how many readings it does not get."""
        session.stop()
        session.join()
        undelivered = session.count_waiting() if self._every else 0
        self.dropped += undelivered
        thread.join(limit_s)
        return undelivered

    @contextmanager
    def _reading(self) -> Iterator[_Session[R]]:
        """Read the device in a thread while the block runs. Raises DEV-013 if a stream reads it already."""
        session = self._begin()
        try:
            yield session
        finally:
            session.stop()
            session.join()

    def _begin(self) -> _Session[R]:
        session = _Session(self._read, self._every, self._timeout_s, self._count_dropped)
        self._turn.take(session)
        return session

    def _count_dropped(self) -> None:
        self.dropped += 1


def _require_consumer(function: object) -> None:
    """Raise ARG-001 for anything but a function of one reading that is called, not awaited."""
    if callable(function) and not iscoroutinefunction(function):
        try:
            signature(function).bind(*A_READING)
            return
        except TypeError:
            pass
        except ValueError:  # a built-in function without a signature
            return
    raise WrongArgument(
        "the function of a stream cannot be called with a reading",
        expected="a function of one argument, not an async one",
        got=show(function),
        action="A task reads with: async for reading in device.stream().",
    )


class Turn:
    """Right to call a device that serves one thread at a time; a stream has it from its start to its end."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._taking = threading.Lock()
        self._calling = threading.Lock()
        self._session: _Session[Any] | None = None

    def take(self, session: _Session[Any]) -> None:
        """Give the turn to a session and start it. Raises DEV-013 while another stream reads."""
        with self._taking:
            if self._session is not None and self._session.is_reading:
                raise STREAM_TAKEN(f"{self._name} is read already")
            self._session = session
            session.start()

    def require(self, call: str) -> None:
        """Raise DEV-014 while a stream reads the device, unless the stream itself is calling."""
        session = self._session
        if session is not None and session.is_reading and not session.is_own_thread:
            raise DEVICE_STREAMS(f"{self._name}: {call} came while a stream reads the device")

    @contextmanager
    def call(self, call: str) -> Iterator[None]:
        """Call the device for the length of a block. Raises DEV-014 while a stream or another thread does."""
        self.require(call)
        if not self._calling.acquire(blocking=False):
            raise DEVICE_STREAMS(f"{self._name}: {call} came while another thread reads the device")
        try:
            yield
        finally:
            self._calling.release()

    def end_stream(self) -> None:
        """End the stream that reads the device, if any; its consumer's loop ends without an error."""
        if (session := self._session) is not None:
            session.stop()
            session.join()


class _Session(Generic[R]):
    """One reading thread of a stream, from its start to its end, and the readings that wait."""

    def __init__(
        self, read: NextReading[R], every: bool, timeout_s: float, count_dropped: Callable[[], None]
    ) -> None:
        self._read, self._every, self._timeout_s = read, every, timeout_s
        self._count_dropped = count_dropped
        self._changed = threading.Condition()
        self._waiting: deque[R] = deque(maxlen=MOST_WAITING if every else 1)
        self._error: Exception | None = None
        self._ending = threading.Event()
        self._stopped = False  # what waits is not taken any more
        self._thread = threading.Thread(target=self._read_on, name="reading stream", daemon=True)

    @property
    def is_reading(self) -> bool:
        return self._thread.is_alive()

    @property
    def is_own_thread(self) -> bool:
        return threading.current_thread() is self._thread

    def start(self) -> None:
        self._thread.start()

    def take(self) -> R:
        """Wait for a reading, oldest first. Raises the device's error, or that the stream has ended."""
        with self._changed:
            self._changed.wait_for(lambda: bool(self._waiting) or self._error is not None)
            if self._waiting and not self._stopped:
                return self._waiting.popleft()
            assert self._error is not None
            raise self._error

    def stop(self) -> None:
        """Tell thread and consumer to end; returns immediately."""
        self._stopped = True
        self._ending.set()
        self._end(_StreamEnded())

    def finish(self) -> None:
        """End the thread, then the consumer once it has taken what waits."""
        self._ending.set()
        self.join()
        self._end(_StreamEnded())

    def count_waiting(self) -> int:
        """Count the readings that nobody has taken."""
        with self._changed:
            return len(self._waiting)

    def join(self) -> None:
        """Wait for the reading that is under way, which its time limit bounds."""
        self._thread.join(2.0 * self._timeout_s)

    def _read_on(self) -> None:
        try:
            while not self._ending.is_set():
                try:
                    reading = self._read(timeout_s=self._timeout_s)
                except Exception:
                    if self._ending.is_set():  # nobody wants what has not come by now
                        return
                    raise
                with self._changed:
                    if len(self._waiting) == self._waiting.maxlen:
                        if self._every:
                            raise STREAM_BEHIND(f"{MOST_WAITING} readings wait for a consumer")
                        self._count_dropped()
                    self._waiting.append(reading)
                    self._changed.notify_all()
        except Exception as error:  # whatever the device raises: raised to the consumer, in its thread
            self._end(error)

    def _end(self, error: Exception) -> None:
        with self._changed:
            self._error = self._error or error
            self._changed.notify_all()


class _StreamEnded(Exception):
    """End of a stream that its consumer has left, or that ended with its device's activity."""


class StatefulArm(Protocol):
    """Arm whose state can be read."""

    @property
    def name(self) -> str: ...

    def read_state(self, timeout_s: float = 1.0) -> ArmReading: ...


class NextArmState:
    """Reader of an arm's states, each once: `read_state` repeats the latest of a running stream."""

    def __init__(self, arm: StatefulArm) -> None:
        self._arm = arm
        self._last = NO_CLOCK

    def __call__(self, timeout_s: float) -> ArmReading:
        """Wait for a state of another cycle; one without a clock was asked for, and is new.

        Raises DEV-012 if none comes in time, and as `read_state`.
        """
        deadline_s = time.monotonic() + timeout_s
        while True:
            reading = self._arm.read_state(timeout_s)
            clock = reading.stamp.device_clock
            if clock == NO_CLOCK:
                time.sleep(BETWEEN_REQUESTS_S)
                return reading
            if clock != self._last:
                self._last = clock
                return reading
            if time.monotonic() > deadline_s:
                raise NO_NEW_STATE(f"{self._arm.name} delivers no new state", limit=f"{timeout_s:g} s")
            time.sleep(ASK_AGAIN_S)

"""Turnaround of a client, as its controller sees it, and figures of several clients beside an echo."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import Self

from benchmarks.figures import Figure

REPLY_LIMIT_S = 0.2
MEDIAN_ABOVE_ECHO_GOAL_US = 15.0
P99_OVER_ECHO_GOAL = 3.0


class Turnarounds(ABC):
    """Stand-in for a controller that sends messages and measures the time until their replies."""

    def __init__(self) -> None:
        self.turnarounds_s: list[float] = []
        self.unanswered = 0

    def block(self, count: int, pace_s: float) -> list[float]:
        """Send `count` messages `pace_s` apart on an absolute schedule. Return the turnarounds in s."""
        found: list[float] = []
        due_s = time.perf_counter()
        for _ in range(count):
            due_s = max(due_s + pace_s, time.perf_counter())
            message = self.next_message()
            pause_s = due_s - time.perf_counter()
            if pause_s > 0.0:
                time.sleep(pause_s)
            began_s = time.perf_counter()
            reply = self.ask(message)
            if reply is None:
                self.unanswered += 1
                continue
            found.append(time.perf_counter() - began_s)
            self.follow(reply)
        self.turnarounds_s += found
        return found

    def share(self, share: float) -> float:
        """Return the quantile `share` (0..1) of all turnarounds, in seconds."""
        return sorted(self.turnarounds_s)[int(share * len(self.turnarounds_s))]

    @abstractmethod
    def next_message(self) -> bytes:
        """Return the message of the next cycle."""

    @abstractmethod
    def ask(self, message: bytes) -> bytes | None:
        """Send a message and return its reply, or None if that is lost."""

    @abstractmethod
    def follow(self, reply: bytes) -> None:
        """Take a set-point, as the controller does; an echo commands nothing."""

    @abstractmethod
    def close(self) -> None: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def compare_with_echo(
    what: str,
    controllers: Mapping[str, Turnarounds],
    echo: str,
    above_echo_goals_us: Mapping[str, float],
    *,
    cycle_s: float | None = None,
) -> Iterator[Figure]:
    """Yield each client's median and tail over all messages, and lost replies; goals for those named.

    `cycle_s`: count the longer turnarounds too.
    """
    echo_median_s, echo_p99_s = controllers[echo].share(0.5), controllers[echo].share(0.99)
    for who, controller in controllers.items():
        goal_us = above_echo_goals_us.get(who)
        if who != echo:
            above_us = (controller.share(0.5) - echo_median_s) * 1e6
            above = Figure(f"median above echo, {what}", who, above_us, "µs")
            yield above if goal_us is None else above.at_most(goal_us)
        p99_s = controller.share(0.99)
        ratio, base = (None, "") if who == echo else (p99_s / echo_p99_s, echo)
        tail = Figure(f"99th percentile, {what}", who, p99_s * 1e6, "µs", ratio, base)
        yield tail if goal_us is None else tail.ratio_at_most(P99_OVER_ECHO_GOAL)
        if cycle_s is not None:
            longer = sum(turnaround_s > cycle_s for turnaround_s in controller.turnarounds_s)
            name = f"longer than a cycle of {1e3 * cycle_s:g} ms, {what}"
            yield Figure(name, who, float(longer), "")
        lost = Figure(f"replies lost, {what}", who, float(controller.unanswered), "")
        yield lost if goal_us is None else lost.at_most(0.0)

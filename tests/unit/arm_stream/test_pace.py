"""Rehearsals, and which telegrams were queued, by the pace of the controller: exact moments, no clock."""

from __future__ import annotations

import errno
from collections.abc import Iterable

import pytest

from ronna_hw.arm_stream.pace import AWAKE_NS, MOST_MISSING, STEADY_ARRIVALS, Pace, PacedReceiver

CYCLE_NS = 4_000_000
LEAD_NS = 500_000
LOOK_NS = 500
IDLE_NS = 10_000_000  # a blocking call gives up
CONTROLLER = ("127.0.0.1", 40000)
BEGIN_NS = 1_000_000_000


class FakeTime:
    """Sockets and a clock in one: telegrams come when the test says so."""

    is_connected = True

    def __init__(self, arrivals_ns: Iterable[int]) -> None:
        self.now_ns = BEGIN_NS
        self.looks = 0
        self.arrivals_ns = list(arrivals_ns)
        self.rehearsed_ns: list[int] = []

    def receive(self) -> tuple[bytes, tuple[str, int]]:
        if not self._is_there(self.now_ns + IDLE_NS):
            self.now_ns += IDLE_NS
            raise OSError(errno.EAGAIN, "the time ran out")
        self.now_ns = max(self.now_ns, self.arrivals_ns.pop(0))
        return b"telegram", CONTROLLER

    def sleep(self, limit_s: float) -> bool:
        end_ns = self.now_ns + round(limit_s * 1e9)
        came = self._is_there(end_ns)
        self.now_ns = max(self.now_ns, self.arrivals_ns[0]) if came else end_ns
        return came

    def has_datagram(self) -> bool:
        self.looks += 1
        return self._is_there(self.now_ns)

    def rehearse(self) -> None:
        self.rehearsed_ns.append(self.now_ns)

    def reception(self, lead_ns: int = LEAD_NS) -> PacedReceiver:
        return PacedReceiver(
            self,  # type: ignore[arg-type]
            lead_ns=lead_ns,
            rehearse=self.rehearse,
            now_ns=lambda: self.now_ns,
        )

    def _is_there(self, moment_ns: int) -> bool:
        return bool(self.arrivals_ns) and self.arrivals_ns[0] <= moment_ns


def arrivals_ns(count: int, cycle_ns: float = CYCLE_NS) -> list[int]:
    """Return the arrivals of an absolute schedule."""
    return [BEGIN_NS + round(cycle_ns * k) for k in range(1, count + 1)]


def pace(reception: PacedReceiver, count: int) -> None:
    for _ in range(count):
        reception.next()
        reception.note_paced()


def served(world: FakeTime, reception: PacedReceiver) -> int:
    """Receive telegrams until nothing has come three times; each after a whole cycle."""
    count = nothing = 0
    while nothing < 3:
        if reception.next() is None:
            nothing += 1
        else:
            count += 1
            nothing = 0
            reception.note_paced()
    return count


@pytest.mark.parametrize("cycle_ns", [1_000_000, 4_000_000, 8_000_000])
def test_each_reply_is_rehearsed_one_lead_ahead_once_the_pace_is_known(cycle_ns: int) -> None:
    due_ns = arrivals_ns(60, cycle_ns)
    world = FakeTime(due_ns)
    assert served(world, world.reception()) == 60
    learning = STEADY_ARRIVALS + 2
    awaited_ns = [*due_ns[learning:], due_ns[-1] + cycle_ns]  # the last one never comes
    assert world.rehearsed_ns == pytest.approx([due - LEAD_NS for due in awaited_ns], abs=1_000)


def test_a_cycle_longer_than_the_idle_poll_is_rehearsed_too() -> None:
    due_ns = arrivals_ns(60, 12_000_000)
    world = FakeTime(due_ns)
    reception = world.reception()
    for _ in due_ns:
        while reception.next() is None:
            pass
        reception.note_paced()
    learning = STEADY_ARRIVALS + 2
    assert world.rehearsed_ns == pytest.approx([due - LEAD_NS for due in due_ns[learning:]], abs=1_000)


def test_a_wait_without_telegrams_returns_within_twice_the_idle_time() -> None:
    world = FakeTime(arrivals_ns(30))
    reception = world.reception()
    served(world, reception)
    begun_ns = world.now_ns
    assert reception.next() is None
    assert world.now_ns - begun_ns <= 2 * IDLE_NS


def test_a_lead_of_zero_rehearses_nothing() -> None:
    world = FakeTime(arrivals_ns(40))
    assert served(world, world.reception(lead_ns=0)) == 40
    assert world.rehearsed_ns == []


def test_rehearsals_end_when_the_controller_starts_to_hurry() -> None:
    paced = arrivals_ns(20)
    hurried = [paced[-1] + 120_000 * k for k in range(1, 100)]
    world = FakeTime(paced + hurried)
    reception = world.reception()
    pace(reception, len(paced))
    for _ in hurried:
        assert reception.next() is not None
        reception.note_lock_step()
    assert [moment for moment in world.rehearsed_ns if moment > paced[-1]] == []


def test_a_controller_that_pauses_keeps_its_pace_and_one_that_hurries_loses_it() -> None:
    before = arrivals_ns(STEADY_ARRIVALS + 2)
    after = [moment + 3_000_000_000 for moment in before]
    world = FakeTime(before + after)
    reception = world.reception()
    said = []
    while world.arrivals_ns:
        if reception.next() is not None:
            said.append(reception.note_paced())
    assert said == [False] * (STEADY_ARRIVALS + 1) + [True] * (STEADY_ARRIVALS + 3)
    reception.note_lock_step()
    assert not reception.note_paced()


def test_the_queue_of_a_controller_that_waits_for_each_reply_is_not_looked_at_until_it_pauses() -> None:
    world = FakeTime([BEGIN_NS + 120_000 * k for k in range(1, 100)])
    reception = world.reception()
    for _ in range(99):
        assert reception.next() is not None
        reception.note_lock_step()
    assert world.looks == STEADY_ARRIVALS + 1
    reception.note_paced()
    reception.next()
    assert world.looks == STEADY_ARRIVALS + 2


class TimeOfLooks(FakeTime):
    """A look at what is pending takes time, as a system call does."""

    def has_datagram(self) -> bool:
        there = super().has_datagram()
        self.now_ns += LOOK_NS
        return there


@pytest.mark.parametrize(("pause_ns", "looks"), [(20 * LOOK_NS, 21), (2 * AWAKE_NS, AWAKE_NS // LOOK_NS)])
def test_an_awake_process_looks_for_the_next_telegram_and_sleeps_if_it_does_not_follow(
    pause_ns: int, looks: int
) -> None:
    hurried = [BEGIN_NS + 120_000 * k for k in range(1, STEADY_ARRIVALS + 2)]
    world = TimeOfLooks(hurried)
    reception = world.reception()
    for _ in hurried:
        assert reception.next() is not None
        reception.note_lock_step(stays_awake=True)
    world.looks, world.arrivals_ns = 0, [world.now_ns + pause_ns]
    assert reception.next() is not None
    assert world.looks == looks
    reception.note_lock_step()
    world.looks, world.arrivals_ns = 0, [world.now_ns + pause_ns]
    assert reception.next() is not None
    assert world.looks == 0


def test_an_early_telegram_is_received_on_arrival_without_a_rehearsal() -> None:
    due_ns = arrivals_ns(30)
    due_ns[-1] -= 700_000
    world = FakeTime(due_ns)
    reception = world.reception()
    pace(reception, len(due_ns))
    assert reception.received_ns == due_ns[-1]
    assert max(world.rehearsed_ns) < due_ns[-2]


def test_telegrams_queued_during_a_stall_are_distinguished_from_awaited_ones() -> None:
    due_ns = arrivals_ns(40)
    world = FakeTime([*due_ns, *[due_ns[-1] + 5 * CYCLE_NS] * 5])
    reception = world.reception()
    for _ in due_ns:
        assert reception.next() is not None
        reception.note_paced()
        assert not reception.was_queued
    world.now_ns += 6 * CYCLE_NS  # the host stalls
    for _ in range(5):
        assert reception.next() is not None
        assert reception.was_queued


def test_the_schedule_tolerates_missing_and_late_telegrams() -> None:
    pace = Pace()
    due_ns = arrivals_ns(80)
    for number, due in enumerate(due_ns):
        if number % 5 == 3:
            continue
        pace.note_arrival(due + 300_000 * (number % 7 == 2))
    assert pace.due_ns - (due_ns[-1] + CYCLE_NS) == pytest.approx(0, abs=75_000)


def test_the_schedule_follows_clock_drift() -> None:
    pace = Pace()
    drifted_ns = arrivals_ns(2000, CYCLE_NS * 1.0002)
    for moment in drifted_ns:
        pace.note_arrival(moment)
    assert pace.due_ns - (drifted_ns[-1] + CYCLE_NS * 1.0002) == pytest.approx(0, abs=2_000)


@pytest.mark.parametrize("jump_ns", [CYCLE_NS // 2, (MOST_MISSING + 2) * CYCLE_NS])
def test_a_jump_in_the_schedule_discards_the_learnt_one(jump_ns: int) -> None:
    pace = Pace()
    for moment in arrivals_ns(20):
        pace.note_arrival(moment)
    assert pace.due_ns
    pace.note_arrival(arrivals_ns(20)[-1] + jump_ns)
    assert pace.due_ns == 0

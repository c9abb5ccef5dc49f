"""Reception stays awake for a telegram that is due, and at no other time. Time is told, never measured."""

from __future__ import annotations

import errno
import socket
import time
from collections.abc import Iterable

import pytest
from rsi_loop import CYCLE_MS, FIRST_IPOC, InProcessLink, telegram

from drivers.kuka_rsi.link_state import StopOrder
from drivers.kuka_rsi.pace import MOST_MISSING, STEADY_ARRIVALS, Pace
from drivers.kuka_rsi.reception import (
    COST_ON_TRIAL,
    GOOD_TELEGRAMS,
    MOST_COST,
    REST_TELEGRAMS,
    VAIN_COST,
    Reception,
    bind,
)

CYCLE_NS = 4_000_000
LEAD_NS = 150_000
LOOK_NS = 1_000  # what one question costs
IDLE_NS = 10_000_000  # a blocking call gives up
CONTROLLER = ("127.0.0.1", 40000)
BEGIN_NS = 1_000_000_000


class ToldTime:
    """A socket, a clock and sleep in one: telegrams come when the test says so."""

    def __init__(self, arrivals_ns: Iterable[int]) -> None:
        self.now_ns = BEGIN_NS
        self.arrivals_ns = list(arrivals_ns)
        self.awake_ns: list[int] = []  # moments of questions that were not answered
        self.rehearsals = 0

    def recvfrom(self, _size: int, flags: int = 0) -> tuple[bytes, tuple[str, int]]:
        self.now_ns += LOOK_NS
        if flags & socket.MSG_DONTWAIT:
            if not self._is_there(self.now_ns):
                self.awake_ns.append(self.now_ns)
                raise BlockingIOError
        elif not self._is_there(self.now_ns + IDLE_NS):
            self.now_ns += IDLE_NS
            raise OSError(errno.EAGAIN, "the time ran out")
        self.now_ns = max(self.now_ns, self.arrivals_ns.pop(0))
        return b"telegram", CONTROLLER

    def sleep(self, _link: object, limit_s: float) -> bool:
        end_ns = self.now_ns + round(limit_s * 1e9)
        came = self._is_there(end_ns)
        self.now_ns = max(self.now_ns, self.arrivals_ns[0]) if came else end_ns
        return came

    def rehearse(self) -> None:
        self.rehearsals += 1

    def reception(self, lead_ns: int = LEAD_NS) -> Reception:
        return Reception(
            self,  # type: ignore[arg-type]
            lead_ns=lead_ns,
            rehearse=self.rehearse,
            now_ns=lambda: self.now_ns,
            sleep=self.sleep,
            lies_there=lambda _link: self._is_there(self.now_ns),
        )

    def _is_there(self, moment_ns: int) -> bool:
        return bool(self.arrivals_ns) and self.arrivals_ns[0] <= moment_ns


def places(count: int, cycle_ns: int = CYCLE_NS) -> list[int]:
    """An absolute schedule."""
    return [BEGIN_NS + cycle_ns * k for k in range(1, count + 1)]


def served(world: ToldTime, reception: Reception) -> int:
    """Telegrams received until nothing has come three times; each after a whole cycle."""
    count = nothing = 0
    while nothing < 3:
        if reception.next() is None:
            nothing += 1
        else:
            count += 1
            nothing = 0
            reception.paced()
    return count


@pytest.mark.parametrize("cycle_ns", [1_000_000, 4_000_000])
def test_awake_from_the_lead_on_before_each_telegram_once_the_pace_is_known(cycle_ns: int) -> None:
    due_ns = places(60, cycle_ns)
    world = ToldTime(due_ns)
    reception = world.reception()
    assert served(world, reception) == 60
    learning = STEADY_ARRIVALS + 2
    assert not [moment for moment in world.awake_ns if moment < due_ns[learning] - LEAD_NS]
    for due in due_ns[learning:]:
        looks = [moment for moment in world.awake_ns if abs(moment - due) <= LEAD_NS + LOOK_NS]
        assert len(looks) == pytest.approx(LEAD_NS / LOOK_NS, abs=2)
    assert world.rehearsals == len(due_ns[learning:]) + 1  # and once for the telegram that never came


def test_when_the_telegrams_cease_one_more_is_waited_for_and_then_all_sleep() -> None:
    due_ns = places(30)
    world = ToldTime(due_ns)
    reception = world.reception()
    served(world, reception)
    after = [moment for moment in world.awake_ns if moment > due_ns[-1]]
    assert min(after) >= due_ns[-1] + CYCLE_NS - LEAD_NS
    assert max(after) <= due_ns[-1] + CYCLE_NS + LEAD_NS + 2 * LOOK_NS
    assert len(after) == pytest.approx(2 * LEAD_NS / LOOK_NS, abs=2)


def test_orders_and_silence_are_looked_at_as_often_as_without() -> None:
    world = ToldTime(places(30))
    reception = world.reception()
    served(world, reception)
    begun_ns = world.now_ns
    assert reception.next() is None
    assert world.now_ns - begun_ns <= IDLE_NS + LOOK_NS


def test_a_lead_of_zero_never_stays_awake() -> None:
    world = ToldTime(places(40))
    assert served(world, world.reception(lead_ns=0)) == 40
    assert world.awake_ns == []
    assert world.rehearsals == 0


def test_telegrams_that_follow_on_the_heels_of_the_reply_are_slept_for() -> None:
    world = ToldTime([BEGIN_NS + 120_000 * k for k in range(1, 200)])
    reception = world.reception()
    while world.arrivals_ns:
        reception.next()
        reception.hurried()
    assert world.awake_ns == []


def test_a_controller_that_begins_to_hurry_is_slept_for_from_then_on() -> None:
    paced = places(20)
    hurried = [paced[-1] + 120_000 * k for k in range(1, 100)]
    world = ToldTime(paced + hurried)
    reception = world.reception()
    for _ in paced:
        reception.next()
        reception.paced()
    for _ in hurried:
        assert reception.next() is not None
        reception.hurried()
    assert [moment for moment in world.awake_ns if moment > paced[-1]] == []


def test_an_early_telegram_is_taken_when_it_comes() -> None:
    due_ns = places(30)
    due_ns[-1] -= 700_000
    world = ToldTime(due_ns)
    reception = world.reception()
    for _ in due_ns:
        reception.next()
        reception.paced()
    assert reception.received_ns - due_ns[-1] <= LOOK_NS


class HeldUp:
    """A controller whose telegrams come when reception has gone to sleep, where the test says so."""

    def __init__(self) -> None:
        self.world = ToldTime([])
        self.reception = self.world.reception()
        self.due_ns = BEGIN_NS

    def telegram(self, *, in_vain: bool) -> bool:
        """Send one; True when reception was awake for it."""
        self.due_ns += CYCLE_NS
        awake = len(self.world.awake_ns)
        held_up_ns = LEAD_NS + 5 * LOOK_NS if in_vain and self.reception._pace.due_ns else 0
        self.world.arrivals_ns.append(max(self.due_ns, self.reception._pace.due_ns) + held_up_ns)
        assert self.reception.next() is not None
        self.reception.paced()
        if not held_up_ns:
            self.due_ns = self.reception.received_ns
        return len(self.world.awake_ns) > awake

    def learn(self) -> None:
        while not self.reception._pace.due_ns:
            self.telegram(in_vain=False)


def test_in_vain_some_times_it_leaves_off_each_time_for_twice_as_long() -> None:
    controller = HeldUp()
    controller.learn()
    trial = (MOST_COST - COST_ON_TRIAL) // VAIN_COST
    for rest in (REST_TELEGRAMS, 2 * REST_TELEGRAMS, 4 * REST_TELEGRAMS):
        assert all([controller.telegram(in_vain=True) for _ in range(trial)])
        assert not any(
            [controller.telegram(in_vain=False) for _ in range(rest - 1)]
        )  # the last in vain counts


def test_one_in_vain_now_and_then_is_no_reason_to_leave_off() -> None:
    controller = HeldUp()
    controller.learn()
    assert all([controller.telegram(in_vain=n % (2 * VAIN_COST) == 0) for n in range(500)])


def test_a_link_that_has_proved_well_bears_twice_as_many_in_a_row_in_vain() -> None:
    controller = HeldUp()
    controller.learn()
    assert all([controller.telegram(in_vain=False) for _ in range(COST_ON_TRIAL)])
    assert all([controller.telegram(in_vain=True) for _ in range(MOST_COST // VAIN_COST)])
    assert not controller.telegram(in_vain=False)


def test_after_a_good_while_the_next_rest_is_short_again() -> None:
    controller = HeldUp()
    controller.learn()
    for _ in range(2):
        while controller.telegram(in_vain=True):
            pass
        while not controller.telegram(in_vain=False):
            pass
    assert all([controller.telegram(in_vain=False) for _ in range(GOOD_TELEGRAMS)])
    assert all([controller.telegram(in_vain=True) for _ in range(MOST_COST // VAIN_COST)])
    assert not any([controller.telegram(in_vain=False) for _ in range(REST_TELEGRAMS - 1)])
    assert controller.telegram(in_vain=False)


def test_the_schedule_survives_telegrams_that_never_come_and_those_that_come_late() -> None:
    pace = Pace()
    due_ns = places(80)
    for number, due in enumerate(due_ns):
        if number % 5 == 3:
            continue
        pace.arrived(due + 300_000 * (number % 7 == 2))
    assert pace.due_ns - (due_ns[-1] + CYCLE_NS) == pytest.approx(0, abs=LEAD_NS / 2)


def test_two_clocks_that_drift_apart_are_followed() -> None:
    pace = Pace()
    drifted_ns = [BEGIN_NS + round(CYCLE_NS * 1.0002 * k) for k in range(1, 2000)]
    for moment in drifted_ns:
        pace.arrived(moment)
    assert pace.due_ns - (drifted_ns[-1] + CYCLE_NS * 1.0002) == pytest.approx(0, abs=2_000)


@pytest.mark.parametrize("jump_ns", [CYCLE_NS // 2, (MOST_MISSING + 2) * CYCLE_NS])
def test_another_schedule_is_learnt_anew(jump_ns: int) -> None:
    pace = Pace()
    for moment in places(20):
        pace.arrived(moment)
    assert pace.due_ns
    pace.arrived(places(20)[-1] + jump_ns)
    assert pace.due_ns == 0


def test_a_rehearsal_changes_nothing_and_sends_nothing() -> None:
    link = InProcessLink()
    try:
        link.open()
        link.receive(telegram(FIRST_IPOC))
        link.receive(telegram(FIRST_IPOC + CYCLE_MS))
        session = link.loop.session
        before = (session.state(real_time=False, locked=False), session.ready, session.cycles)
        sent, memory = len(link.replies.sent), link.mailbox.read_state()
        link.loop._rehearse()
        assert (session.state(real_time=False, locked=False), session.ready, session.cycles) == before
        assert (len(link.replies.sent), link.mailbox.read_state()) == (sent, memory)
        link.stop(StopOrder.PROTECTIVE)
        link.loop._rehearse()  # an order that has come meanwhile is not taken by it
        assert session.state(real_time=False, locked=False) == before[0]
        link.receive(telegram(FIRST_IPOC + 2 * CYCLE_MS))
        assert session.state(real_time=False, locked=False).stop_number == 1
    finally:
        link.close()


def test_what_came_while_nobody_waited_is_known_from_what_was_waited_for() -> None:
    due_ns = places(40)
    world = ToldTime([*due_ns, *[due_ns[-1] + 5 * CYCLE_NS] * 5])
    reception = world.reception()
    for _ in due_ns:
        assert reception.next() is not None
        reception.paced()
        assert not reception.queued
    world.now_ns += 6 * CYCLE_NS  # the host stalls
    for _ in range(5):
        assert reception.next() is not None
        assert reception.queued


def slowly(_link: object, _limit_s: float) -> bool:
    """Something has come; a busy computer takes long to say so."""
    time.sleep(0.001)
    return True


@pytest.mark.parametrize("stays_awake", [False, True])
@pytest.mark.parametrize("late", [False, True])
def test_of_telegrams_that_were_held_up_only_the_newest_is_taken(stays_awake: bool, late: bool) -> None:
    with bind("127.0.0.1", 0) as link, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as controller:
        own = InProcessLink(link=link, stays_awake=stays_awake)
        own.open()
        now_ns = time.monotonic_ns()
        for place in reversed(range(40)):  # the pace is known, and the next one due in a moment
            own.loop._reception._pace.arrived(now_ns - place * CYCLE_NS)
        own.loop._reception._sleep = slowly
        own.loop._answered_ns = 0 if late else now_ns + CYCLE_NS
        held = [telegram(FIRST_IPOC + CYCLE_MS * k) for k in range(5)]
        for each in held:
            controller.sendto(each, link.getsockname())
        taken = own.loop._receive()
        assert taken is not None
        assert taken[0] == held[-1]
        assert own.loop.session.dropped == 4
        own.close()

"""Orders over HTTP: what an operator may order, what a viewer may not, and what is out of date."""

from __future__ import annotations

import itertools
import json
import random
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from console_requests import ORIGIN, Console
from plain_steps import plain_order
from recording_cell import RecordingCell
from waiting import eventually

from console.guard import ORDERS_PER_SECOND
from procedures.runs.operator_station import OperatorStation, PendingOrder
from procedures.runs.orders import Next

ORDERS = [
    {"kind": "claim", "name": "Ana"},
    {"kind": "renew"},
    {"kind": "release"},
    {"kind": "next", "upcoming": "image"},
    {"kind": "run_to", "upcoming": "image", "step": "fit:T1"},
    {"kind": "pause"},
    {"kind": "resume", "upcoming": "image"},
    {"kind": "stop"},
    {"kind": "abort"},
    {"kind": "acknowledge"},
    {"kind": "answer", "question": 1, "answer": "yes", "shown": "0" * 64},
]


@pytest.fixture
def console() -> Console:
    return Console()


@dataclass
class Waiting(Console):
    """A console whose engine waits between steps, with Ana in the seat."""

    station: OperatorStation = field(
        default_factory=lambda: OperatorStation(waits=False, now_s=lambda: 0.0)
    )  # the seat never lapses
    pending: list[PendingOrder | None] = field(default_factory=list)
    cookie_of_ana: str = ""


@contextmanager
def waiting_in(folder: Path) -> Iterator[Waiting]:
    folder.mkdir(exist_ok=True)
    console = Waiting()
    console.station.attach(RecordingCell(folder).engine(plain_order()))
    thread = threading.Thread(target=lambda: console.pending.append(console.station.next_order("image")))
    thread.start()
    try:
        eventually(lambda: console.station.waiting_for == "image")
        console.cookie_of_ana = console.operator()
        assert console.order(console.cookie_of_ana, kind="claim", name="Ana").status == 200
        yield console
    finally:
        console.station.leave()
        thread.join()


@pytest.fixture
def waiting(tmp_path: Path) -> Iterator[Waiting]:
    with waiting_in(tmp_path) as console:
        yield console


@pytest.mark.parametrize("order", ORDERS, ids=lambda order: order["kind"])
def test_a_viewer_cannot_give_orders(console: Console, order: dict[str, object]) -> None:
    answer = console.order(console.viewer(), **order)
    assert answer.status == 403
    assert answer.refused == "viewers cannot give orders"


@pytest.mark.parametrize(
    "order", [one for one in ORDERS[2:] if one["kind"] != "stop"], ids=lambda order: order["kind"]
)
def test_an_operator_outside_the_seat_cannot_steer(waiting: Waiting, order: dict[str, object]) -> None:
    answer = waiting.order(waiting.operator(), **order)
    assert (answer.status, answer.refused) == (409, "you are not in the operator's seat")
    assert waiting.pending == []


def test_any_operator_can_stop_the_arm_without_the_seat(waiting: Waiting) -> None:
    assert waiting.order(waiting.operator(), kind="stop").status == 200


def test_a_second_claim_is_refused_and_names_who_has_the_seat(waiting: Waiting) -> None:
    answer = waiting.order(waiting.operator(), kind="claim", name="Ben")
    assert (answer.status, answer.refused) == (409, "the seat is taken by Ana")


def test_next_is_carried_out_once_and_only_for_the_step_that_was_shown(waiting: Waiting) -> None:
    cookie = waiting.cookie_of_ana
    stale = waiting.order(cookie, kind="next", upcoming="fit:T1", nonce="nonce-01")
    assert (stale.status, stale.refused) == (409, "out of date: the next step is now image")
    repeated = waiting.order(cookie, kind="next", upcoming="image", nonce="nonce-01")
    assert repeated.refused == "this order was already given"
    assert waiting.order(cookie, kind="next", upcoming="image", nonce="nonce-02").status == 200
    eventually(lambda: [one and (type(one.order), one.by) for one in waiting.pending] == [(Next, "Ana")])


def test_more_orders_per_second_than_a_person_gives_are_refused(waiting: Waiting) -> None:
    cookie = waiting.cookie_of_ana
    answers = [waiting.order(cookie, kind="pause").refused for _ in range(ORDERS_PER_SECOND + 1)]
    assert answers[-1] == "too many orders in one second"


def mutated(body: bytes, draw: random.Random) -> bytes:
    """One order with a few bytes changed, cut out, doubled or put in."""
    content = bytearray(body)
    for _ in range(draw.randint(1, 4)):
        place = draw.randrange(len(content) + 1)
        match draw.randrange(4):
            case 0 if place < len(content):
                content[place] = draw.randrange(256)
            case 1:
                del content[place : place + draw.randint(1, 8)]
            case 2:
                content[place:place] = content[place : place + 12]
            case _:
                content[place:place] = bytes([draw.randrange(256)])
        if not content:
            break
    return bytes(content)


ODD = ("Z", "é", " ", "\0", '"', "\u2028", "x" * 300)  # in no name of a step or an answer


def altered(order: dict[str, object], draw: random.Random) -> bytes:
    """One order, still JSON, with one of its values changed or put in."""
    name = draw.choice([*order, "more"])
    value = order.get(name)
    if isinstance(value, str):
        place = draw.randrange(len(value) + 1)
        value = value[:place] + draw.choice(ODD) + value[place + draw.randrange(2) :]
    else:
        value = draw.choice((None, True, -1, 2, 1e308, "", [], {}))
    return json.dumps(order | {name: value}).encode()


def hammered(folder: Path, count: int) -> int:
    """Send so many spoilt orders from the operator's own session; returns how many reached the station.

    An accepted one must be one of the orders as they were; after it a new console takes the next ones.
    """
    draw, left, reached = random.Random(7), count, 0
    while left:
        with waiting_in(folder / str(left)) as console:
            console.hub._now_s = itertools.count(1.0).__next__  # slowly enough for a person
            headers = {"cookie": console.cookie_of_ana, "origin": ORIGIN}
            sessions = console.sessions
            secrets = [console.cookie_of_ana.partition("=")[2].encode(), str(folder).encode()]
            secrets += [one.encode() for one in (sessions.operator_token, sessions.viewer_token)]
            secrets += [one.identifier.encode() for one in sessions._sessions.values()]
            accepted = False
            while left and not accepted:
                left -= 1
                order = draw.choice(ORDERS)
                body = mutated(json.dumps(order).encode(), draw) if left % 2 else altered(order, draw)
                answer = console.request("POST", "/orders", headers=headers, body=body)
                status = answer.status
                assert not any(one in answer.body for one in secrets), body
                accepted, reached = status == 200, reached + (status != 400)
                if accepted:
                    assert as_ordered(body) in ORDERS, body
                else:
                    assert status in (400, 409), body
                    assert console.pending == [], body
    return reached


def as_ordered(body: bytes) -> dict[str, object]:
    """An accepted order; whatever name the operator took."""
    order: dict[str, object] = json.loads(body)
    return order | {"name": "Ana"} if order["kind"] == "claim" else order


def test_two_thousand_spoilt_orders_of_the_operator_are_refused_unless_they_say_what_one_says(
    tmp_path: Path,
) -> None:
    assert hammered(tmp_path, 2000) > 100


@pytest.mark.soak
@pytest.mark.timeout(1200)
def test_a_hundred_thousand_spoilt_orders_of_the_operator_are_refused_unless_they_say_what_one_says(
    tmp_path: Path,
) -> None:
    assert hammered(tmp_path, 100_000) > 5000

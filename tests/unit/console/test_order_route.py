"""Orders over HTTP: what an operator may order, what a viewer may not, and what is out of date."""

from __future__ import annotations

import json
import random
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from console_requests import ORIGIN, Console
from plain_steps import plain_order
from recording_cell import RecordingCell
from waiting import eventually

from console.sessions import ORDERS_PER_SECOND
from procedures.cli.console.desk import Wish

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


@pytest.fixture
def waiting(console: Console, tmp_path: Path) -> Iterator[Console]:
    """A console whose engine waits between steps, with Ana in the seat."""
    console.desk.attach(RecordingCell(tmp_path).engine(plain_order()))
    wishes: list[Wish | None] = []
    thread = threading.Thread(target=lambda: wishes.append(console.desk.wish("image")))
    thread.start()
    eventually(lambda: console.desk._waiting_for == "image")
    console.cookie_of_ana = console.operator()  # type: ignore[attr-defined]  # of this fixture alone
    assert console.order(console.cookie_of_ana, kind="claim", name="Ana").status == 200  # type: ignore[attr-defined]  # of this fixture alone
    console.wishes = wishes  # type: ignore[attr-defined]  # of this fixture alone
    yield console
    console.desk.leave()
    thread.join()


@pytest.mark.parametrize("order", ORDERS, ids=lambda order: order["kind"])
def test_a_viewer_cannot_give_orders(console: Console, order: dict[str, object]) -> None:
    answer = console.order(console.viewer(), **order)
    assert answer.status == 403
    assert answer.refused == "viewers cannot give orders"


@pytest.mark.parametrize("order", ORDERS[2:], ids=lambda order: order["kind"])
def test_an_operator_outside_the_seat_cannot_steer(waiting: Console, order: dict[str, object]) -> None:
    if order["kind"] == "stop":
        return
    answer = waiting.order(waiting.operator(), **order)
    assert (answer.status, answer.refused) == (409, "you are not in the operator's seat")
    assert waiting.wishes == []  # type: ignore[attr-defined]  # of this fixture alone


def test_any_operator_can_stop_the_arm_without_the_seat(waiting: Console) -> None:
    assert waiting.order(waiting.operator(), kind="stop").status == 200


def test_a_second_claim_is_refused_and_names_who_has_the_seat(waiting: Console) -> None:
    answer = waiting.order(waiting.operator(), kind="claim", name="Ben")
    assert (answer.status, answer.refused) == (409, "the seat is taken by Ana")


def test_next_is_carried_out_once_and_only_for_the_step_that_was_shown(waiting: Console) -> None:
    cookie = waiting.cookie_of_ana  # type: ignore[attr-defined]  # of this fixture alone
    stale = waiting.order(cookie, kind="next", upcoming="fit:T1", nonce="nonce-01")
    assert (stale.status, stale.refused) == (409, "out of date: the next step is now image")
    repeated = waiting.order(cookie, kind="next", upcoming="image", nonce="nonce-01")
    assert repeated.refused == "this order was already given"
    assert waiting.order(cookie, kind="next", upcoming="image", nonce="nonce-02").status == 200
    eventually(lambda: waiting.wishes == [Wish("next", by="Ana")])  # type: ignore[attr-defined]  # of this fixture alone


def test_more_orders_per_second_than_a_person_gives_are_refused(waiting: Console) -> None:
    cookie = waiting.cookie_of_ana  # type: ignore[attr-defined]  # of this fixture alone
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


def hammered(console: Console, count: int) -> set[int]:
    """The statuses with which so many mutated orders of nobody in the seat are answered."""
    draw, cookie = random.Random(7), console.operator()
    bodies = [json.dumps(order).encode() for order in ORDERS[2:] if order["kind"] != "stop"]
    headers = {"cookie": cookie, "origin": ORIGIN}
    return {
        console.request("POST", "/orders", headers=headers, body=mutated(draw.choice(bodies), draw)).status
        for _ in range(count)
    }


def test_two_thousand_mutated_orders_are_refused_and_have_no_effect(waiting: Console) -> None:
    assert hammered(waiting, 2000) <= {400, 409}
    assert waiting.wishes == []  # type: ignore[attr-defined]  # of this fixture alone


@pytest.mark.soak
@pytest.mark.timeout(1200)
def test_a_hundred_thousand_mutated_orders_are_refused_and_have_no_effect(waiting: Console) -> None:
    assert hammered(waiting, 100_000) <= {400, 409}
    assert waiting.wishes == []  # type: ignore[attr-defined]  # of this fixture alone

"""Orders received over a socket or in a request, and the digest that an answer quotes."""

from __future__ import annotations

import pytest

from procedures.engine.events import Questioned
from procedures.engine.events.event_types import shown_digest
from procedures.operator.question import Evidence
from procedures.runs.orders import LONGEST_BYTES, Stop, read_order

GOOD = '"nonce":"nonce-0001","session":"session-1"'


def test_a_valid_order_is_read() -> None:
    assert read_order(f'{{"kind":"stop",{GOOD}}}') == Stop(nonce="nonce-0001", session="session-1")


@pytest.mark.parametrize("name", ["Ana Novak", "王\u3000伟", "Ana\u00a0N.", "علی\u200cرضا", "O'Brien-Šimić"])
def test_the_names_of_people_are_taken(name: str) -> None:
    assert read_order(f'{{"kind":"claim","name":"{name}",{GOOD}}}').kind == "claim"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        f'{{"kind":"jog",{GOOD}}}',
        f'{{"kind":"stop","more":1,{GOOD}}}',
        '{"kind":"stop","session":"session-1"}',
        f'{{"kind":"answer","question":"1","answer":"yes","shown":"{"0" * 64}",{GOOD}}}',
        f'{{"kind":"answer","question":1,"answer":"yes","shown":"short",{GOOD}}}',
        f'{{"kind":"claim","name":"{"a" * LONGEST_BYTES}",{GOOD}}}',
        f'{{"kind":"claim","name":" ",{GOOD}}}',
        f'{{"kind":"claim","name":"Ana\\u202eneB",{GOOD}}}',
        f'{{"kind":"claim","name":"Ana\\u001b[2J",{GOOD}}}',
        f'{{"kind":"stop","expires_s":NaN,{GOOD}}}',
        "[" * 5000,
    ],
)
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(ValueError):  # noqa: PT011
        read_order(text)


def test_the_digest_covers_everything_a_decision_is_based_on_and_nothing_else() -> None:
    table = Evidence(title="budget", head=("source", "mm"), rows=(("CT", "0.01"),))
    asked = Questioned(
        question=1, topic="park", subject="park", value="12 mm", answers=("yes", "no"), timeout_s=60.0
    )
    changed = [
        asked.model_copy(update=one)
        for one in (
            {"question": 2},
            {"subject": "parks"},
            {"value": "13 mm"},
            {"answers": ("no", "yes")},
            {"evidence": (table,)},
            {"read_back": "how many"},
        )
    ]
    assert len({shown_digest(one) for one in (asked, *changed)}) == len(changed) + 1
    assert shown_digest(asked.model_copy(update={"timeout_s": 1.0})) == shown_digest(asked)

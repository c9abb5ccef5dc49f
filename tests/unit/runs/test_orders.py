"""Orders received over a socket or in a request, and the digest that an answer quotes."""

from __future__ import annotations

import pytest

from procedures.engine.events import Questioned
from procedures.engine.events.event_types import digest_of_question
from procedures.operator.question import Evidence
from procedures.runs.orders import COMMANDS, LONGEST_BYTES, PAUSED, SentOrder, Stop, read_order

GOOD = '"nonce":"nonce-0001","session":"session-1"'


def test_a_valid_order_is_read() -> None:
    assert read_order(f'{{"kind":"stop",{GOOD}}}') == SentOrder(
        nonce="nonce-0001", session="session-1", order=Stop()
    )


def test_an_order_is_written_as_it_is_read() -> None:
    text = f'{{"kind":"answer","question":1,"answer":"yes","shown":"{"0" * 64}","readings":[0.5,1],{GOOD}}}'
    assert read_order(read_order(text).model_dump_json()) == read_order(text)


def test_the_commands_of_a_prompt_keep_their_words_and_only_looks_and_answers_count_in_a_pause() -> None:
    assert " ".join(COMMANDS) == (
        "list next run to back why dry pause stop resume home acknowledge abort help quit"
    )
    paused = [name for name, rule in COMMANDS.items() if PAUSED in rule.at_prompt]
    assert paused == ["list", "why", "dry", "resume", "acknowledge", "abort", "help"]


@pytest.mark.parametrize("name", ["Ana Novak", "王\u3000伟", "Ana\u00a0N.", "علی\u200cرضا", "O'Brien-Šimić"])
def test_the_names_of_people_are_taken(name: str) -> None:
    assert read_order(f'{{"kind":"claim","name":"{name}",{GOOD}}}').order.kind == "claim"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        f'{{"kind":"jog",{GOOD}}}',
        f'{{"kind":"stop","more":1,{GOOD}}}',
        f'{{"kind":"stop","order":{{}},{GOOD}}}',
        f'{{"kind":"stop","upcoming":"image",{GOOD}}}',
        f'{{"kind":"next",{GOOD}}}',
        f'{{"kind":"home",{GOOD}}}',
        f'{{"kind":"acknowledge","by":"Ben",{GOOD}}}',
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
    assert len({digest_of_question(one) for one in (asked, *changed)}) == len(changed) + 1
    assert digest_of_question(asked.model_copy(update={"timeout_s": 1.0})) == digest_of_question(asked)

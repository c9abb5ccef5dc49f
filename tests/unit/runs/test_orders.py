"""Orders received over a socket or in a request, and the digest that an answer quotes."""

from __future__ import annotations

import pytest

from procedures.engine.events import Questioned
from procedures.engine.events.event_types import digest_of_question
from procedures.engine.questions import as_shown
from procedures.operator.question import Evidence, Identity, Picture, PredictedError, Question, Topic
from procedures.runs.orders import (
    ASKING,
    COMMANDS,
    LONGEST_BYTES,
    PAUSED,
    RUNNING,
    WAITING,
    CaseActivity,
    SentOrder,
    Stop,
    activity_of,
    explain_invalid_order,
    read_order,
)
from ronna_hw.devices.lifecycle import LONGEST_NAME

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


@pytest.mark.parametrize(
    ("topic", "is_waiting", "activity"),
    [
        ("pause", True, PAUSED),
        ("approach", True, ASKING),  # a question comes first
        (None, True, WAITING),
        (None, False, RUNNING),
    ],
)
def test_the_activity_of_a_case_follows_its_open_question_and_the_step_that_it_waits_for(
    topic: str | None, is_waiting: bool, activity: CaseActivity
) -> None:
    assert activity_of(topic, is_waiting=is_waiting) is activity


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
        f'{{"kind":"claim","name":"{"a" * (LONGEST_NAME + 1)}",{GOOD}}}',
        f'{{"kind":"claim","name":"Ana\\u202eneB",{GOOD}}}',
        f'{{"kind":"claim","name":"Ana\\u001b[2J",{GOOD}}}',
        f'{{"kind":"stop","expires_s":NaN,{GOOD}}}',
        "[" * 5000,
    ],
)
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(ValueError):  # noqa: PT011
        read_order(text)


@pytest.mark.parametrize(
    ("name", "reason"), [("Bell\x07", "control characters"), ("A" * 61, "limit 60"), (" ", "got nothing")]
)
def test_a_refused_name_is_told_its_reason_on_the_page(name: str, reason: str) -> None:
    assert reason in explain_invalid_order({"kind": "claim", "name": name})


PREDICTED = PredictedError(target="T1", rms_mm=0.4, limit_mm=0.8, confidence=0.95, margin_mm=2.0)


def test_the_identity_is_in_no_serialized_event_and_only_its_salted_digest_is_signed() -> None:
    rows = (("name", "Secret, Name"),)
    one, other = Identity(rows=rows), Identity(rows=rows)
    assert one.sha256 != other.sha256  # nobody who guesses the name can confirm it from a record
    asked = Question(Topic.PATIENT, "Is this the patient?", "T1", identity=one)
    event = as_shown(asked, 1)
    assert event.identity == one
    assert event.identity_sha256 == one.sha256
    for shown in (event.model_dump_json(), repr(event), repr(asked), repr(one)):
        assert "Secret" not in shown
        assert one.salt not in shown


@pytest.mark.parametrize(
    ("rms_mm", "limit_mm", "words"),
    [
        (0.4, 0.8, "within the margin; 95% of such errors stay within 0.80 mm"),
        (1.9, 2.6, "rms within the margin, but its 95% limit, 2.60 mm, is beyond it"),
        (2.1, 2.9, "BEYOND the margin; 95% of such errors stay within 2.90 mm"),
    ],
)
def test_the_verdict_on_a_prediction_tells_also_when_only_its_limit_is_beyond_the_margin(
    rms_mm: float, limit_mm: float, words: str
) -> None:
    assert PREDICTED.model_copy(update={"rms_mm": rms_mm, "limit_mm": limit_mm}).sentence == words


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
            {"emphasis": "moves 12 mm"},
            {"predicted": (PREDICTED,)},
            {"pictures": (Picture(name="plan-T1.png", sha256="0" * 64),)},
            {"identity_sha256": "0" * 64},
        )
    ]
    assert len({digest_of_question(one) for one in (asked, *changed)}) == len(changed) + 1
    assert digest_of_question(asked.model_copy(update={"timeout_s": 1.0})) == digest_of_question(asked)

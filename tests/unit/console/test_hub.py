"""The hub: stale data is shown as stale, and every order gets an answer or a refusal."""

from __future__ import annotations

import asyncio
import io
import socket
from datetime import UTC, datetime
from pathlib import Path

import pytest
from coded_errors import raises

from console.app import follow_engine, review
from console.errors import NOTHING_TO_SHOW, PORT_TAKEN
from console.guard import MOST_SESSIONS, Session, SessionRole, Sessions
from console.hub import NOT_RUNNING, SILENT_FILE_S, SILENT_S, Hub
from console.listening import HOST, listen
from console.recorded_case import RecordedCase
from procedures.engine.events import (
    CaseState,
    DeviceAge,
    DeviceState,
    Event,
    EventContent,
    JournalLine,
    Pose,
    Seat,
)
from procedures.engine.questions import as_shown
from procedures.operator.question import Identity, Question, Topic
from procedures.runs.console_link import event_lines
from procedures.runs.orders import OrderReply, SentOrder, read_order

OPERATOR = Session(SessionRole.OPERATOR, "session-1")


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_a_silent_engine_is_reported() -> None:
    clock = Clock()
    hub = Hub(Path(), clock)
    hub.live = True
    assert hub.frozen == ""
    clock.now_s = SILENT_S + 2.0
    assert "NO DATA FROM" in hub.frozen
    hub.note_heartbeat()
    assert hub.frozen == ""


def test_arm_data_without_updates_ages_while_the_engine_is_alive() -> None:
    clock = Clock()
    hub = Hub(Path(), clock)
    hub.live = True
    for number, what in enumerate(
        (
            DeviceState(device="arm", state="active"),
            DeviceAge(device="arm", age_s=0.1),
            Pose(arm="arm", joints_rad=(0.0,) * 6, age_s=0.1),
        )
    ):
        hub.take(event(number, what))
    clock.now_s = 0.5
    assert hub.aged_view is hub.view
    clock.now_s = 7.0
    hub.note_heartbeat()
    assert "arm" in hub.aged_view.poses
    assert hub.aged_view.theatre_time_s - hub.aged_view.poses["arm"].reported_s == 7.0
    assert hub.aged_view.devices["arm"].age_s == 7.1


def test_a_case_under_review_whose_engine_ended_without_closing_it_says_so() -> None:
    hub = Hub(Path())
    hub.review = RecordedCase()
    hub.take(event(1, CaseState(state="held")))
    assert hub.frozen == ""
    hub.review.is_over = True
    assert "THE ENGINE HAS ENDED" in hub.frozen
    hub.take(event(2, JournalLine(line={"entry": "closed", "outcome": "done"})))
    assert hub.frozen == ""


def test_a_case_under_review_with_open_devices_and_no_more_events_is_reported_and_its_data_age() -> None:
    clock = Clock()
    hub = Hub(Path(), clock)
    hub.review = RecordedCase()
    hub.take(event(1, DeviceState(device="arm", state="active")))
    clock.now_s = 60.0
    assert hub.frozen == ""  # nothing is due yet
    hub.note_heartbeat()
    hub.take(event(2, Pose(arm="arm", joints_rad=(0.0,) * 6, age_s=0.1)))
    hub.take(event(3, DeviceAge(device="arm", age_s=0.1)))
    assert hub.frozen == ""
    clock.now_s += SILENT_FILE_S + 1.0
    assert "NO DATA FROM THE ENGINE FOR 4 s" in hub.frozen
    assert "arm" in hub.aged_view.poses
    assert hub.aged_view.theatre_time_s - hub.aged_view.poses["arm"].reported_s == 4.0
    hub.note_heartbeat()
    hub.take(event(4, DeviceState(device="arm", state="closed")))
    clock.now_s += SILENT_FILE_S + 1.0
    assert hub.frozen == ""


def event(number: int, what: EventContent) -> Event:
    return Event(number=number, host_time=datetime.now(UTC), theatre_time_s=1.0, what=what)


def fed(*lines: bytes) -> Hub:
    """A hub whose engine sent these lines and closed its end."""
    ours, theirs = socket.socketpair()
    hub = Hub(Path())
    with ours:
        ours.sendall(b"\n".join(lines) + b"\n")
        ours.shutdown(socket.SHUT_WR)
        asyncio.run(follow_engine(theirs.detach(), hub))
    return hub


def line(number: int, what: EventContent) -> bytes:
    return b'{"event":' + event(number, what).model_dump_json().encode() + b"}"


def test_an_engine_that_ends_before_closing_its_journal_leaves_a_banner() -> None:
    hub = fed(line(1, CaseState(state="held")), b'{"beat":1}')
    assert hub.view.state == "held"
    assert "THE ENGINE HAS ENDED" in hub.frozen
    closed = fed(line(1, JournalLine(line={"entry": "closed", "outcome": "done"})))
    assert (closed.frozen, closed.view.outcome) == ("", "done")


@pytest.mark.parametrize("bad", [b"nonsense", b'{"event":{}}', b"\xff\xfe", b'{"nonce":1}'])
def test_an_invalid_line_from_the_engine_ends_the_feed_but_not_the_console(bad: bytes) -> None:
    hub = fed(line(1, CaseState(state="held")), bad, line(2, CaseState(state="finished")))
    assert (hub.view.state, hub.has_ended) == ("held", True)


def test_a_question_gets_the_identity_that_was_sent_with_it_and_no_other() -> None:
    identity = Identity(rows=(("name", "Secret, Name"),))
    asked = as_shown(Question(Topic.PATIENT, "Is this the patient?", "T1", identity=identity), 1)
    sent = [line.encode() for line in event_lines(event(1, asked))]
    assert fed(*sent).view.question == asked
    swapped = Identity(rows=(("name", "Other, Name"),))
    for others in ([], [b'{"identity":' + swapped.model_dump_json().encode() + b"}"]):
        question = fed(*others, sent[-1]).view.question
        assert question is not None
        assert question.identity is None


def test_orders_are_sent_to_the_engine_and_return_its_answer() -> None:
    ours, theirs = socket.socketpair()
    hub = Hub(Path())

    async def give() -> tuple[str, str]:
        feed = asyncio.create_task(follow_engine(theirs.detach(), hub))
        reader, writer = await asyncio.open_connection(sock=ours)

        async def engine() -> None:
            for words in ("", "the seat is taken by Ana"):
                order = read_order((await reader.readline()).strip())
                writer.write(OrderReply(nonce=order.nonce, refused=words).model_dump_json().encode() + b"\n")

        task = asyncio.create_task(engine())
        await asyncio.sleep(0)
        said = [await hub.order(OPERATOR, {"kind": "claim", "name": name}) for name in ("Ana", "Ben")]
        await task
        writer.close()
        await feed
        return said[0], said[1]

    assert asyncio.run(give()) == ("", "the seat is taken by Ana")


def test_a_claim_is_known_though_its_reply_overtakes_what_came_before_it() -> None:
    hub = Hub(Path())
    hub.take(event(1, Seat(holder="Ana")))

    async def carry_out(order: SentOrder) -> None:
        hub.reply(OrderReply(nonce=order.nonce))

    hub.connect(carry_out)
    assert asyncio.run(hub.order(OPERATOR, {"kind": "claim", "name": " Ben "})) == ""
    for number, holder in enumerate(("", "Ben"), start=2):
        hub.take(event(number, Seat(holder=holder)))
        assert hub.seated_session == OPERATOR.identifier
    hub.take(event(4, Seat(holder="Cleo")))
    assert hub.seated_session == ""


def test_an_order_is_refused_when_no_case_is_running() -> None:
    assert asyncio.run(Hub(Path()).order(OPERATOR, {"kind": "pause"})) == NOT_RUNNING


def test_sessions_are_limited_and_a_new_one_replaces_the_oldest_of_its_role() -> None:
    sessions = Sessions()
    operator = sessions.open(sessions.operator_token)
    cookies = [sessions.open(sessions.viewer_token) for _ in range(MOST_SESSIONS + 1)]
    assert sessions.find(cookies[0]) is None
    assert sessions.find(cookies[-1]) is not None
    assert sessions.find(None) is None
    assert sessions.find(operator) is not None


def test_a_port_in_use_is_reported() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with raises(PORT_TAKEN) as refused:
            listen(HOST, taken.getsockname()[1])
    assert "CON-001" in str(refused.value)


def test_a_folder_that_is_not_a_run_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    with raises(NOTHING_TO_SHOW, match="CON-002"):
        review(tmp_path, 0)
    (tmp_path / "events.jsonl").touch()
    with raises(NOTHING_TO_SHOW, match="has no events yet"):
        review(tmp_path, 0)


def test_an_unreadable_event_file_is_reported_on_the_page_with_its_code() -> None:
    hub = Hub(Path("nowhere"))
    assert hub.frozen == ""
    hub.break_off("PRO-018: line 7 was written by another version. Use the version that wrote it.")
    assert hub.frozen.startswith("PRO-018: line 7 was written by another version.")

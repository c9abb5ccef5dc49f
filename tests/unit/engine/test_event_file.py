"""The event stream on disk, and readers that follow it from outside."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import pytest
from bounded_cost import bounded_cost
from coded_errors import raises

from procedures.cli.runs.showing import line_of
from procedures.engine.errors import EVENTS_UNREADABLE
from procedures.engine.events import CaseState, Event, EventStream, JournalLine, Pose, SignalsLost, StepState
from procedures.engine.events.event_file import EventFile, FollowedRun
from ronna_hw.command_line.errors import PATH_PROBLEM
from ronna_hw.evidence.lost_journal_end import EVENTS_FILE


def pose(joint_rad: float) -> Pose:
    return Pose(arm="master", joints_rad=(joint_rad,), age_s=0.0)


def written(folder: Path) -> list[Event]:
    return [Event.model_validate_json(line) for line in (folder / EVENTS_FILE).read_bytes().splitlines()]


@contextmanager
def recorded(folder: Path, **options: int) -> Iterator[EventStream]:
    """A stream whose events are in the file of that folder at the end."""
    stream = EventStream()
    file = EventFile(folder, stream, **options)
    yield stream
    ended(stream, file)


def ended(stream: EventStream, file: EventFile) -> None:
    stream.end()
    file.join()


def test_a_follower_that_looks_at_the_wrong_instant_keeps_no_events_from_the_file(tmp_path: Path) -> None:
    path = tmp_path / EVENTS_FILE
    looking = os.open(path, os.O_RDWR | os.O_CREAT)
    fcntl.flock(looking, fcntl.LOCK_SH)
    tried: list[int] = []

    def lets_go(_s: float) -> None:
        tried.append(fcntl.flock(looking, fcntl.LOCK_UN) or 1)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("procedures.engine.events.event_file.time.sleep", lets_go)
        stream = EventStream()
        file = EventFile(tmp_path, stream)
    stream.publish(CaseState(state="idle"))
    ended(stream, file)
    os.close(looking)
    assert [event.what for event in written(tmp_path)] == [CaseState(state="idle")]


def test_the_file_contains_every_fact_and_the_last_of_a_burst_of_poses(tmp_path: Path) -> None:
    with recorded(tmp_path) as stream:
        stream.publish(pose(-1.0))
        for number in range(300):
            stream.publish(CaseState(state=str(number)))
            stream.publish(pose(float(number)))
    happened = [event.what for event in written(tmp_path)]
    assert [what.state for what in happened if isinstance(what, CaseState)] == [str(n) for n in range(300)]
    poses = [what for what in happened if isinstance(what, Pose)]
    assert len(poses) <= 2
    assert poses[-1] == pose(299.0)
    assert happened[-1] == SignalsLost(count=301 - len(poses))
    (present,) = FollowedRun(tmp_path).batches()
    assert f"{301 - len(poses)} poses and other signals; no fact is missing" in str(
        [line_of(event) for event in present]
    )


def test_signals_are_limited_in_size_and_facts_are_not(tmp_path: Path) -> None:
    with recorded(tmp_path, signals_bytes=0) as stream:
        stream.publish(pose(0.0))
        stream.publish(CaseState(state="idle"))
    assert [event.what for event in written(tmp_path)] == [CaseState(state="idle"), SignalsLost(count=1)]


def test_an_unwritable_event_file_blocks_nothing(tmp_path: Path) -> None:
    (tmp_path / EVENTS_FILE).mkdir()
    with recorded(tmp_path) as stream:
        stream.publish(CaseState(state="idle"))


def test_a_line_torn_by_a_kill_is_cut_off_before_the_next_session_writes(tmp_path: Path) -> None:
    (tmp_path / EVENTS_FILE).write_bytes(b'{"version":1,"numb')
    with recorded(tmp_path) as stream:
        stream.publish(CaseState(state="recovery"))
    assert [event.what for event in written(tmp_path)] == [CaseState(state="recovery")]


def followed(run: FollowedRun) -> list[list[str]]:
    return [[_state(event) for event in events] for events in run.batches()]


def _state(event: Event) -> str:
    assert isinstance(event.what, CaseState | StepState)
    return event.what.state


def test_a_follower_gets_the_current_state_and_then_the_changes_until_the_run_ends(tmp_path: Path) -> None:
    stream = EventStream()
    file = EventFile(tmp_path, stream)
    stream.publish(CaseState(state="idle"))
    stream.publish(CaseState(state="paused"))
    while (tmp_path / EVENTS_FILE).read_bytes().count(b"\n") < 2:
        os.sched_yield()

    def meanwhile(_wait_s: float) -> None:
        stream.publish(CaseState(state="finished"))
        ended(stream, file)

    assert followed(FollowedRun(tmp_path, meanwhile)) == [["paused"], ["finished"]]


@pytest.mark.parametrize(("entry", "closed"), [("closed", True), ("motion", False)])
def test_a_follower_knows_whether_the_run_was_closed(tmp_path: Path, entry: str, closed: bool) -> None:
    with recorded(tmp_path) as stream:
        stream.publish(JournalLine(line={"entry": entry}))
    run = FollowedRun(tmp_path)
    assert list(map(len, run.batches())) == [1]
    assert run.closed is closed


def test_a_huge_sparse_event_file_is_continued_without_reading_all_of_it(tmp_path: Path) -> None:
    (tmp_path / EVENTS_FILE).touch()
    os.truncate(tmp_path / EVENTS_FILE, 1_000_000_000)
    stream = EventStream()
    with bounded_cost(300 << 20, 10.0):
        file = EventFile(tmp_path, stream)
    ended(stream, file)


def test_a_folder_that_is_not_a_run_is_refused(tmp_path: Path) -> None:
    for folder in (tmp_path / "nowhere", tmp_path):
        with raises(PATH_PROBLEM):
            FollowedRun(folder)


@pytest.mark.parametrize(
    "line",
    [
        b"nonsense",
        b"\xff\xfe",
        b'{"version":2,"number":1,"host_time":"2026-01-01T00:00:00Z","theatre_time_s":0.0,'
        b'"what":{"kind":"case","state":"idle"}}',
    ],
)
def test_a_line_that_is_not_an_event_of_this_version_is_refused_with_its_number(
    tmp_path: Path, line: bytes
) -> None:
    (tmp_path / EVENTS_FILE).write_bytes(line + b"\n")
    with raises(EVENTS_UNREADABLE, match="line 1"):
        list(FollowedRun(tmp_path).batches())


def test_the_sessions_of_a_resumed_run_are_followed_one_after_the_other(tmp_path: Path) -> None:
    for states in (("idle", "held"), ("recovery", "finished")):
        with recorded(tmp_path) as stream:
            for state in states:
                stream.publish(CaseState(state=state))
                stream.publish(pose(0.0))
    (course,) = FollowedRun(tmp_path).batches(whole=True)
    happened = [event.what for event in course]
    states_seen = [what.state for what in happened if isinstance(what, CaseState)]
    assert states_seen == ["idle", "held", "recovery", "finished"]


def test_a_file_of_nested_journal_lines_is_refused_at_bounded_cost(tmp_path: Path) -> None:
    nested = '{"":' * 50 + "0" + "}" * 50
    line = Event(
        number=1,
        host_time=datetime(2026, 11, 20, tzinfo=UTC),
        theatre_time_s=1.5,
        what=JournalLine(line={"entry": "opened", "values": "@"}),
    )
    text = line.model_dump_json().replace('"@"', f"[{','.join([nested] * 90)}]")
    (tmp_path / EVENTS_FILE).write_text(f"{text}\n" * (10_000_000 // len(text)))
    with bounded_cost(), raises(EVENTS_UNREADABLE, match="too many values"):
        list(FollowedRun(tmp_path).batches(whole=True))

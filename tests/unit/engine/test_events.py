import pytest
from case_events import question

from procedures.engine.events import (
    Answered,
    CaseState,
    EventStream,
    Fault,
    JournalLine,
    Pose,
    Refusal,
    StepState,
)
from procedures.engine.events.stream import LAST_LINES


def pose(joint_rad: float, arm: str = "master") -> Pose:
    return Pose(arm=arm, joints_rad=(joint_rad,), age_s=0.0)


def test_events_are_numbered_from_one_in_order() -> None:
    stream = EventStream()
    reader = stream.subscribe()
    for state in ("idle", "paused", "idle"):
        stream.publish(CaseState(state=state))
    assert [event.number for event in reader.read(0).events] == [1, 2, 3]


@pytest.mark.hazard(40)
def test_a_slow_reader_loses_poses_but_no_fact_and_learns_how_many() -> None:
    stream = EventStream()
    reader = stream.subscribe()
    for joint in range(100):
        stream.publish(pose(joint))
        stream.publish(StepState(step=f"step {joint}", state="begun"))
    batch = reader.read(0)
    assert batch.lost == 99
    assert [event.what for event in batch.events if event.what.kind == "pose"] == [pose(99)]
    assert sum(event.what.kind == "step" for event in batch.events) == 100


def test_poses_of_two_arms_do_not_replace_each_other() -> None:
    stream = EventStream()
    reader = stream.subscribe()
    stream.publish(pose(1.0, "master"))
    stream.publish(pose(2.0, "assistant"))
    assert len(reader.read(0).events) == 2


@pytest.mark.hazard(40)
def test_a_new_subscriber_gets_the_current_state() -> None:
    stream = EventStream()
    stream.publish(CaseState(state="idle"))
    stream.publish(question(1))
    stream.publish(Answered(question=1, answer="continue"))
    stream.publish(question(2))
    stream.publish(CaseState(state="paused"))
    assert [event.what for event in stream.subscribe().read(0).events] == [
        question(2),
        CaseState(state="paused"),
    ]


@pytest.mark.parametrize("late", [False, True])
def test_a_reader_learns_that_the_stream_has_ended(late: bool) -> None:
    stream = EventStream()
    reader = None if late else stream.subscribe()
    stream.end()
    assert (reader or stream.subscribe()).read().ended


def test_a_new_subscriber_gets_the_opening_line_of_the_journal_and_the_last_ones() -> None:
    stream = EventStream()
    opened = JournalLine(line={"entry": "opened", "banner": "SIMULATED THEATRE"})
    later = [JournalLine(line={"entry": "motion", "sequence": number}) for number in range(1, 9)]
    for line in (opened, *later):
        stream.publish(line)
    assert [event.what for event in stream.subscribe().read(0).events] == [opened, *later[-LAST_LINES:]]


def test_a_new_subscriber_gets_the_last_error_until_a_step_begins() -> None:
    stream = EventStream()
    refused = Refusal(step="registration:T1", unmet=("relocalization:T1 is not done",))
    for what in (Fault(code="PRO-007", what="too few spheres"), refused):
        stream.publish(what)
    assert [event.what for event in stream.subscribe().read(0).events] == [refused]
    begun = StepState(step="relocalization:T1", state="begun")
    stream.publish(begun)
    assert [event.what for event in stream.subscribe().read(0).events] == [begun]

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import procedures
from procedures.operator.checkpoint import Checkpoint
from procedures.operator.errors import GuardUnmet, OperatorAborted
from procedures.operator.question import DELIBERATE, Question, Topic


class Disk:
    """A guard that is unmet for so many looks."""

    name = "disk space"

    def __init__(self, unmet: float) -> None:
        self.unmet_looks = unmet

    def unmet(self) -> str | None:
        self.unmet_looks -= 1
        return "1 MB left" if self.unmet_looks >= 0 else None


class Rig:
    def __init__(self, answer: Callable[[Question], str] = lambda question: question.answers[0]) -> None:
        self.rests: list[tuple[str, str]] = []
        self.asked: list[Question] = []
        self.slept_s = 0.0
        self.answer = answer
        self.checkpoint = Checkpoint(self.ask, self.rest, self)

    def ask(self, question: Question) -> str:
        self.asked.append(question)
        return self.answer(question)

    @contextmanager
    def rest(self, state: str, reason: str) -> Iterator[None]:
        self.rests.append((state, reason))
        yield

    @property
    def paced(self) -> bool:
        return False

    def now_s(self) -> float:
        return self.slept_s

    def sleep(self, duration_s: float) -> None:
        self.slept_s += duration_s


def test_a_checkpoint_asks_nothing_without_a_request() -> None:
    rig = Rig()
    rig.checkpoint.here("between steps")
    assert (rig.asked, rig.rests) == ([], [])


def test_a_pause_waits_once_until_the_operator_says_continue() -> None:
    rig = Rig()
    rig.checkpoint.pause("coffee")
    rig.checkpoint.here("between steps")
    rig.checkpoint.here("between steps")
    assert rig.rests == [("paused", "coffee")]
    assert [(one.answers, one.timeout_s) for one in rig.asked] == [(("continue", "abort"), None)]


def test_any_answer_but_continue_ends_the_case() -> None:
    rig = Rig(lambda question: question.silence)
    rig.checkpoint.pause()
    with pytest.raises(OperatorAborted, match="PRO-004"):
        rig.checkpoint.here("between steps")


@pytest.mark.branch("ABORTED")
def test_an_abort_ends_the_case_without_a_question() -> None:
    rig = Rig()
    rig.checkpoint.abort()
    with pytest.raises(OperatorAborted):
        rig.checkpoint.here("between steps")
    assert rig.asked == []


def test_an_abort_leaves_no_pause_for_the_way_home() -> None:
    rig = Rig()
    rig.checkpoint.pause("coffee")
    rig.checkpoint.abort()
    with pytest.raises(OperatorAborted):
        rig.checkpoint.here("between steps")
    rig.checkpoint.here("on the way home")
    assert rig.rests == []


def test_an_unmet_guard_suspends_the_case_until_it_is_met() -> None:
    rig = Rig()
    rig.checkpoint.guards.append(Disk(5))
    rig.checkpoint.here("before a motion")
    assert rig.rests == [("suspended", "disk space: 1 MB left")]
    assert 0.1 < rig.slept_s < 1.0
    assert rig.asked == []


def test_a_guards_patience_includes_the_time_its_checks_take() -> None:
    rig = Rig(lambda question: question.silence)

    class Slow(Disk):
        def unmet(self) -> str | None:
            rig.sleep(5.0)
            return super().unmet()

    guard = Slow(1000)
    rig.checkpoint.guards.append(guard)
    with pytest.raises(GuardUnmet):
        rig.checkpoint.here("before a motion")
    assert guard.unmet_looks > 990


@pytest.mark.branch("GUARD_UNMET")
def test_a_guard_that_stays_unmet_ends_the_step_when_the_question_goes_unanswered() -> None:
    rig = Rig(lambda question: question.silence)
    rig.checkpoint.guards.append(Disk(float("inf")))
    with pytest.raises(GuardUnmet, match=r"PRO-017: disk space: 1 MB left"):
        rig.checkpoint.here("before a motion")
    assert rig.slept_s >= 20.0


def test_the_question_says_for_how_long_a_guard_would_be_waived() -> None:
    class Dispensable(Disk):
        topic, patience_s, excused_for_s = Topic.HEAD_UNSEEN, 0.0, 10.0

        def excuse(self) -> None:
            self.unmet_looks = 0

    rig = Rig(lambda _question: "continue")
    rig.checkpoint.guards.append(Dispensable(float("inf")))
    rig.checkpoint.here("at the target")
    assert "continue proceeds without it for 10 s of the next motion or wait" in rig.asked[0].value


def test_an_abort_takes_effect_while_a_guard_suspends_the_case() -> None:
    rig = Rig()

    class Waited(Disk):
        def unmet(self) -> str | None:
            if rig.slept_s:
                rig.checkpoint.abort()
            return super().unmet()

    rig.checkpoint.guards.append(Waited(float("inf")))
    with pytest.raises(OperatorAborted):
        rig.checkpoint.here("before a motion")
    assert rig.asked == []


def test_a_pause_takes_effect_while_a_guard_waits() -> None:
    rig = Rig(lambda question: question.silence)
    rig.checkpoint.guards.append(Disk(float("inf")))
    rig.checkpoint.pause()
    with pytest.raises(OperatorAborted):
        rig.checkpoint.here("before a motion")


def test_a_stopped_motion_is_asked_about_without_a_pause_request() -> None:
    rig = Rig()
    rig.checkpoint.rest_after_stop("the motion 'go'", "plans it anew")
    assert [one.value for one in rig.asked] == ["the motion 'go' was stopped; continuing plans it anew"]


CONFIRMED_MOTION = re.compile(r"(?:supervised|self)\.confirm\(\s*Topic\.(\w+)")


def test_every_answer_that_confirms_a_motion_or_lets_the_arm_continue_is_deliberate() -> None:
    sources = Path(procedures.__file__).parent.rglob("*.py")
    named = {name for source in sources for name in CONFIRMED_MOTION.findall(source.read_text())}
    assert {"FIRST_MOTION", "TOOL_CHECK", "APPROACH", "RETREAT", "PARK"} <= named
    lets_go_on = {Topic.INSTRUMENT_OUT, Topic.PAUSE, Topic.HEAD_UNSEEN}
    assert ({Topic[name] for name in named} | lets_go_on) - DELIBERATE == set()

import time
from types import SimpleNamespace
from typing import Any

import pytest

from procedures.cli.case.display import AGAIN_S, Interrupts


class Engine:
    """What an interrupt needs of an engine; its checkpoint is met when the test says so."""

    def __init__(self) -> None:
        self.paused: list[str] = []
        self.stops = 0
        self.awaits_person = False
        self.is_awaiting_person = lambda: self.awaits_person
        self.checkpoint = SimpleNamespace(wanted=False, pause=self.pause)
        self.questions = SimpleNamespace(signed_answers=0)
        self.setting = SimpleNamespace(
            workcell=SimpleNamespace(stop=self.stop, instrument_description=None, held_instrument=None)
        )

    def pause(self, reason: str) -> None:
        self.paused.append(reason)
        self.checkpoint.wanted = True

    def stop(self) -> None:
        self.stops += 1


@pytest.fixture
def attached() -> tuple[Interrupts, Any]:
    engine: Any = Engine()
    interrupts = Interrupts()
    interrupts.attach(engine)
    return interrupts, engine


def test_an_interrupt_before_there_is_an_engine_ends_the_command() -> None:
    with pytest.raises(KeyboardInterrupt):
        Interrupts().interrupt()


def test_the_first_interrupt_requests_a_pause_and_stops_nothing_and_the_third_ends_the_command(
    attached: tuple[Interrupts, Any],
) -> None:
    interrupts, engine = attached
    interrupts.interrupt()
    assert (engine.paused, engine.stops) == (["Ctrl-C"], 0)
    interrupts.interrupt()
    with pytest.raises(KeyboardInterrupt):
        interrupts.interrupt()


def test_the_interrupt_count_restarts_after_a_pause(attached: tuple[Interrupts, Any]) -> None:
    interrupts, engine = attached
    for _ in range(4):
        interrupts.interrupt()
        engine.checkpoint.wanted = False  # the pause was met
    assert len(engine.paused) == 4


def test_an_interrupt_after_an_answer_is_the_first_again(attached: tuple[Interrupts, Any]) -> None:
    interrupts, engine = attached
    interrupts.interrupt()
    with interrupts.asking() as write:  # by the step that still runs: the pause is to come
        write("Type yes or no: ")
        interrupts.interrupt()
        write("Type yes or no: ")  # after a word that is no answer
        interrupts.interrupt()
    interrupts.interrupt()
    engine.questions.signed_answers += 1  # at the console
    interrupts.interrupt()
    assert (len(engine.paused), engine.stops) == (3, 0)


def test_an_interrupt_at_a_question_repeats_the_question_with_its_figures(
    attached: tuple[Interrupts, Any], capfd: pytest.CaptureFixture[str]
) -> None:
    interrupts, engine = attached
    with interrupts.asking() as write:
        write("Type yes or no: ", question="the wristband\n")
        write("Type what it says: ", question="the wristband\n")
        interrupts.interrupt()
    repeated = "Ctrl-C again ends the command\nthe wristband\nType what it says: "
    assert capfd.readouterr().err.endswith(repeated)
    assert engine.paused == []


def test_an_interrupt_at_a_question_says_that_an_instrument_is_inside(
    attached: tuple[Interrupts, Any], capfd: pytest.CaptureFixture[str]
) -> None:
    interrupts, engine = attached
    engine.setting.workcell.instrument_description = "an instrument is still in T1"
    with interrupts.asking() as write:
        write("Type yes: ", question="at depth?\n")
        interrupts.interrupt()
    (said,) = [line for line in capfd.readouterr().err.splitlines() if "Ctrl-C again" in line]
    assert said.endswith("; an instrument is still in T1: take it out by hand before anything else")


def test_while_a_person_at_the_console_is_awaited_the_second_interrupt_ends_the_command(
    attached: tuple[Interrupts, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    interrupts, engine = attached
    now_s = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    engine.awaits_person = True
    interrupts.interrupt()
    now_s[0] += AGAIN_S  # forgotten meanwhile
    interrupts.interrupt()
    engine.questions.signed_answers += 1
    interrupts.interrupt()
    with pytest.raises(KeyboardInterrupt):
        interrupts.interrupt()
    assert (engine.paused, engine.stops) == ([], 0)

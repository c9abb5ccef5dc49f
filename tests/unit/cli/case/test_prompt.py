"""A case driven by typed commands: what each command does, and how to continue after a failed step."""

from __future__ import annotations

import io
import sys
from dataclasses import replace

import pytest
from plain_steps import Image, only_home_remains, plain_order, plain_steps
from recording_cell import HOME, RecordingCell, RecordingOperator

from procedures.cli.case.prompt import HELD, Prompt
from procedures.engine.context import StepContext
from procedures.engine.engine import Engine
from procedures.engine.order import Outcome, order_of
from procedures.journal.errors import GateFailed, StepRefused
from procedures.journal.results import StepResult
from procedures.operator.errors import OperatorAborted
from procedures.operator.question import Answer, Question, Topic
from procedures.runs.lifecycle import run_to_end
from procedures.runs.observers import RunObservers
from ronna_hw.devices.lifecycle import LastKnown, Lifecycle


class Typed:
    """A prompt with the lines that are typed at it, and what it said."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *lines: str, resumes: bool = False) -> None:
        monkeypatch.setattr(sys, "stdin", io.StringIO("".join(f"{line}\n" for line in lines)))
        self.said: list[str] = []
        self.prompt = Prompt("step> ", self.said.append, resumes=resumes)

    def at(self, engine: Engine) -> bool:
        return self.prompt.follow(engine)


def too_far(_context: StepContext) -> Outcome[StepResult]:
    raise GateFailed("too far")


def test_a_failed_step_holds_the_case_and_shows_the_commands_that_continue(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    engine = cell.engine(plain_order(localization=too_far))
    typed = Typed(monkeypatch, "to localization:T1", "list")
    typed.at(engine)
    assert "PRO-007" in capsys.readouterr().err
    assert typed.said[0] == f"{HELD}; next runs localization:T1"
    assert engine.machine.state == "held"
    assert engine.course.status(engine.order.find("image")) == "done"


def test_back_shows_what_it_supersedes_and_repeats_nothing_without_confirmation(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cell.operator = RecordingOperator(Topic.REPEAT)
    engine = cell.engine(plain_order())
    engine.run_to(engine.order.find("fit:T1"))
    typed = Typed(monkeypatch, "back localization:T1")
    typed.at(engine)
    assert "supersedes 02-localization-T1, 03-fit-T1" in typed.said[0]
    assert "PRO-002" in capsys.readouterr().err
    assert engine.case.stands(engine.order.find("fit:T1"))


def test_back_repeats_the_step_and_the_case_continues_from_there(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = cell.engine(plain_order())
    engine.run_to(engine.order.find("fit:T1"))
    Typed(monkeypatch, "back localization:T1").at(engine)
    assert engine.upcoming == engine.order.find("fit:T1")


def test_skip_is_refused_and_names_the_step_that_needs_the_result(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    typed = Typed(monkeypatch, "skip image", "help")
    typed.at(cell.engine(plain_order()))
    refused = "there is no command 'skip': image cannot be skipped: localization needs its result."
    assert typed.said[0].startswith(refused)
    assert not any(line.startswith("skip") for line in typed.said)


def test_resume_withdraws_a_pause_that_has_not_begun(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = cell.engine(plain_order())
    typed = Typed(monkeypatch, "pause", "resume", "resume")
    typed.at(engine)

    assert typed.said == [
        "the case will pause before the next step; while a step runs, Ctrl-C pauses it",
        "the pause is withdrawn; next or to continues",
        "nothing is paused; next or to continues",
    ]
    assert not engine.checkpoint.wanted


class Pauses:
    """Asks the prompt at a pause, and says yes to the rest."""

    prompt: Prompt

    def ask(self, question: Question) -> Answer:
        return self.prompt.ask(question) if question.topic is Topic.PAUSE else Answer(question.answers[0])


def paused(cell: RecordingCell, monkeypatch: pytest.MonkeyPatch, *lines: str) -> Engine:
    operator = Pauses()
    cell.operator = operator  # type: ignore[assignment]
    engine = cell.engine(plain_order())
    typed = Typed(monkeypatch, "pause", "next", *lines)
    operator.prompt = typed.prompt
    typed.at(engine)
    return engine


def test_only_resume_ends_a_pause(cell: RecordingCell, monkeypatch: pytest.MonkeyPatch) -> None:

    engine = paused(cell, monkeypatch, "yes", "", "next", "why", "why nothing_like_it", "resume")
    assert engine.case.stands(engine.order.find("image"))
    assert not engine.case.stands(engine.order.find("localization:T1"))


@pytest.mark.hazard(32)
def test_a_fault_acknowledged_in_a_pause_has_its_step_begun_again(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Stopped(Pauses):
        def ask(self, question: Question) -> Answer:
            if question.topic is Topic.PAUSE:
                cell.arm.state = Lifecycle.FAULT
            return super().ask(question)

    operator = Stopped()
    cell.operator = operator  # type: ignore[assignment]
    engine = cell.engine(plain_order())
    lines = ("pause", "next", "acknowledge", "home", "acknowledge Ann", "resume", "next")
    typed = Typed(monkeypatch, *lines)
    operator.prompt = typed.prompt
    typed.at(engine)
    shown = capsys.readouterr().err
    assert "acknowledge needs your name" in shown
    assert "PRO-001: a fault was acknowledged during the pause" in shown
    assert any(said.startswith("home is not available while the case is paused") for said in typed.said)
    assert "recovered by Ann" in cell.arm.calls
    assert [entry for entry, _ in cell.entries("failed")] == ["failed"]  # only the pause let it fail
    assert engine.case.stands(engine.order.find("image"))


def test_an_unknown_command_is_reported_with_a_suggestion_and_a_synonym_is_not_executed(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    typed = Typed(monkeypatch, "wy", "weiter", "exit", "continue", "", "  ")
    typed.at(cell.engine(plain_order()))
    assert typed.said == [
        "there is no command 'wy'; did you mean why?",
        "there is no command 'weiter'; help lists the commands",
        "there is no command 'exit'; did you mean quit?",
        "there is no command 'continue'; did you mean resume?",
        *["nothing was typed; help lists the commands"] * 2,
    ]
    said = Typed(monkeypatch, "weiter", "nexxt", "next", "abort")
    said.prompt.ask(Question(Topic.PAUSE, "Paused", "here", ("continue", "abort")))
    assert said.said[2].startswith("there is no command 'weiter'; ")
    assert said.said[4].startswith("next is not available while the case is paused: resume goes on ")


@pytest.mark.parametrize("last", [("abort",), ()])
def test_abort_or_end_of_input_ends_a_paused_case(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch, last: tuple[str, ...]
) -> None:
    with pytest.raises(OperatorAborted):
        paused(cell, monkeypatch, *last)


def away_from_home(cell: RecordingCell) -> Engine:
    engine = cell.engine(plain_order())
    cell.workcell.master.set_home()
    a, *others = HOME
    cell.arm.joints_rad = (a + 0.5, *others)  # type: ignore[assignment]
    return engine


def test_abort_parks_the_arm_and_then_ends_the_case(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = away_from_home(cell)
    with pytest.raises(OperatorAborted):
        Typed(monkeypatch, "abort").at(engine)
    assert cell.arm.joints_rad == HOME
    assert engine.machine.state == "aborted"


def test_a_finished_case_stays_finished_whatever_is_typed(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = cell.engine(plain_order())
    engine.run_to()
    Typed(monkeypatch, "abort", "run drilling", "quit").at(engine)
    assert engine.machine.state == "finished"


def test_an_unconfirmed_abort_moves_nothing_and_leaves_the_case_held(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.operator = RecordingOperator(Topic.PARK)
    engine = away_from_home(cell)
    Typed(monkeypatch, "abort").at(engine)
    assert cell.arm.motions == []
    assert engine.machine.state == "held"


@pytest.mark.parametrize("line", ["next 3", "abort now", "quit please"])
def test_surplus_arguments_are_refused_and_nothing_is_done(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch, line: str
) -> None:
    engine = cell.engine(plain_order())
    typed = Typed(monkeypatch, line, "list")
    typed.at(engine)
    assert "takes no argument; nothing was done" in typed.said[0]
    assert typed.said[1].startswith("next")  # the first step, and the case goes on
    assert engine.machine.state == "idle"


def test_quit_prints_how_to_resume(cell: RecordingCell, monkeypatch: pytest.MonkeyPatch) -> None:
    engine = cell.engine(plain_order())
    typed = Typed(monkeypatch, "next", "quit")
    typed.at(engine)
    way_on = f"to continue: ronna-procedure resume {engine.case.folder}"
    assert typed.said == [f"the case is left as it is; {way_on}"]


def test_a_command_counts_in_upper_case_and_manual_work_is_no_command(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    typed = Typed(monkeypatch, "drill", "QUIT", "next")
    assert typed.at(engine := cell.engine(plain_order())) is False
    assert typed.said[0].startswith("'drill' is manual work, which is typed when the case asks for it")
    assert engine.case.valid_results == ()


@pytest.mark.parametrize("command", ["to", "back", "run"])
def test_a_command_without_its_step_asks_for_one(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    Typed(monkeypatch, command).at(cell.engine(plain_order()))
    assert "no step is named. Name one" in capsys.readouterr().err


def test_a_device_is_refused_as_the_name_of_the_person_acknowledging(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    role = next(iter(cell.workcell.devices))
    Typed(monkeypatch, f"acknowledge {role}").at(cell.engine(plain_order()))
    assert f"{role} is a device" in capsys.readouterr().err
    assert cell.entries() == []


def test_acknowledge_shows_by_whom_and_what_was_acknowledged_and_how_to_continue(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = cell.engine(plain_order())
    cell.arm.state = Lifecycle.FAULT
    typed = Typed(monkeypatch, "acknowledge A. Nurse", resumes=True)
    typed.at(engine)
    assert typed.said[0].startswith("acknowledged by A. Nurse: arm")
    assert typed.said[1] == "the arm is at rest; resume continues, next does one step"


def test_a_device_in_fault_shows_its_current_recovery_steps_instead_of_the_errors_advice(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def is_stopped(_context: StepContext) -> Outcome[StepResult]:
        cell.arm.state = Lifecycle.FAULT
        raise GateFailed("stopped")

    typed = Typed(monkeypatch, "next", resumes=True)
    typed.at(cell.engine(plain_order(image=is_stopped)))
    assert capsys.readouterr().err == "PRO-007: stopped.\n"
    assert typed.said[0].startswith("the arm is in fault")
    assert typed.said[1] == f"{HELD}; resume continues, next does one step"


def test_quitting_while_a_device_is_in_fault_ends_the_case_with_that_fault(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def is_stopped(_context: StepContext) -> Outcome[StepResult]:
        cell.arm.state = Lifecycle.FAULT
        raise GateFailed("stopped")

    typed = Typed(monkeypatch, "resume", "quit", resumes=True)
    engine = cell.engine(plain_order(image=is_stopped))
    with pytest.raises(GateFailed, match="stopped"):
        run_to_end(engine, RunObservers(held=typed.prompt))
    assert "PRO-001: image cannot start: the arm is in fault" in capsys.readouterr().err


def test_a_case_refused_for_a_fault_after_an_earlier_failure_was_repaired_does_not_end_with_that_failure(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    failures = iter([GateFailed("the match is wrong")])

    def fails_once(_context: StepContext) -> Outcome[StepResult]:
        if (failure := next(failures, None)) is not None:
            raise failure
        cell.arm.state = Lifecycle.FAULT
        return Outcome(Image(), "seen")

    typed = Typed(monkeypatch, "resume", "quit", resumes=True)
    engine = cell.engine(plain_order(image=fails_once))
    with pytest.raises(StepRefused, match="cannot start: the arm is in fault"):
        run_to_end(engine, RunObservers(held=typed.prompt))


def test_resume_step_by_step_says_what_keeps_the_case_and_not_that_next_continues(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = cell.engine(plain_order())
    seen = LastKnown(Lifecycle.FAULT, GateFailed("stopped"), None)
    monkeypatch.setattr(cell.arm, "observe", lambda: seen)
    typed = Typed(monkeypatch, "resume", "quit")
    typed.at(engine)
    assert typed.said[0].startswith("nothing is paused; the arm is in fault (PRO-007), stopped. To")
    assert "next" not in typed.said[0]


def test_quitting_after_a_fault_was_acknowledged_ends_the_case_with_a_fault_that_was(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    def is_stopped(_context: StepContext) -> Outcome[StepResult]:
        stopped = GateFailed("the arm was stopped", got="emergency stop")
        seen = LastKnown(Lifecycle.FAULT, stopped, None)
        recovered = LastKnown(Lifecycle.CONFIGURED, None, None)
        is_over = "recovered by Ann"
        monkeypatch.setattr(cell.arm, "observe", lambda: recovered if is_over in cell.arm.calls else seen)
        raise stopped

    typed = Typed(monkeypatch, "acknowledge Ann", "quit", resumes=True)
    engine = cell.engine(plain_order(image=is_stopped))
    with pytest.raises(GateFailed) as ended:
        run_to_end(engine, RunObservers(held=typed.prompt))
    assert ended.value.what == "was: the arm was stopped; acknowledged by Ann"
    assert ended.value.shown


def test_a_failure_after_an_acknowledgement_of_the_same_code_is_no_fault_that_was(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    def is_stopped(_context: StepContext) -> Outcome[StepResult]:
        raise GateFailed("the arm was stopped again")

    seen = LastKnown(Lifecycle.FAULT, GateFailed("stopped"), None)
    recovered = LastKnown(Lifecycle.CONFIGURED, None, None)
    monkeypatch.setattr(cell.arm, "observe", lambda: recovered if cell.arm.calls else seen)
    engine = cell.engine(plain_order(image=is_stopped))
    engine.faults.acknowledge("Ann")
    typed = Typed(monkeypatch, "quit", resumes=True)
    with pytest.raises(GateFailed) as ended:
        run_to_end(engine, RunObservers(held=typed.prompt))
    assert ended.value.what == "the arm was stopped again"


def test_a_fault_on_the_way_home_is_acknowledged_at_the_prompt_when_every_step_is_done(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = cell.engine(only_home_remains())
    engine.run_to()
    cell.arm.state = Lifecycle.FAULT
    typed = Typed(monkeypatch, "why", "lst", "acknowledge Ann", "resume", resumes=True)
    run_to_end(engine, RunObservers(held=typed.prompt))
    assert "every step is done; home brings the arm home" in typed.said
    assert "recovered by Ann" in cell.arm.calls
    assert (cell.arm.joints_rad, engine.machine.state) == (HOME, "finished")
    assert cell.entries("home") == [("home", "")]


@pytest.mark.parametrize("command", ["home", "next"])
def test_a_held_case_ends_when_its_arm_is_home_and_every_step_is_done(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    engine = cell.engine(only_home_remains())
    engine.run_to()
    refusing = iter([(Topic.PARK,)])  # once
    cell.operator.meanwhile = lambda _question: setattr(cell.operator, "refusing", next(refusing, ()))
    run_to_end(engine, RunObservers(held=Typed(monkeypatch, command, "quit", resumes=True).prompt))
    assert cell.entries("home") == [("home", "")] * 2
    assert engine.machine.state == "finished"


def test_resume_leaves_the_prompt_of_a_held_case_and_end_of_input_ends_the_case(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = cell.engine(plain_order())
    assert Typed(monkeypatch, "next", "resume", resumes=True).at(engine)
    assert not Typed(monkeypatch, "next", resumes=True).at(engine)


def test_why_reports_that_a_completed_step_has_a_valid_result(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = cell.engine(plain_order())
    typed = Typed(monkeypatch, "next", "why image", "why")
    typed.at(engine)
    assert typed.said[-2] == "image is done and its result is valid; back image repeats it"
    assert "can start" in typed.said[-1]


def test_a_finished_case_offers_only_what_is_still_possible(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    engine = cell.engine(plain_order())
    engine.run_to()
    typed = Typed(
        monkeypatch, "pause", "acknowledge Ann", "resume", "why image", "to image", "back image", "help"
    )
    typed.at(engine)
    *said, image, to_image = typed.said[:6]
    assert said == [
        "nothing to pause: the case is finished",
        "no device is in fault",
        "the arm is at rest; the case is finished",
        "nothing is paused; the case is finished",
    ]
    for line in (image, to_image):
        assert line.endswith("; it cannot be repeated now: the case has ended: finished")
    assert capsys.readouterr().err.endswith("No further step is possible in this run.\n")
    assert [line.split()[0] for line in typed.said[6:]] == ["list", "why", "dry", "help", "quit"]
    assert not engine.checkpoint.wanted


def test_a_step_refused_within_a_trajectory_advises_the_step_that_must_come_first(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    engine = cell.engine(plain_order())
    engine.run_to(engine.order.find("approach:T1"))
    typed = Typed(monkeypatch, "back image", "why image")
    typed.at(engine)
    refused = capsys.readouterr().err
    assert "Nothing may come between approach:T1 and held:T1: run held:T1 first." in refused
    assert "run the earlier steps first" not in refused
    assert typed.said[-1].endswith("; it cannot be repeated now: only held:T1 may follow approach:T1")


def test_where_the_required_step_needs_the_arm_in_its_place_home_is_advised_as_well(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    steps = [replace(step, moves=step.name == "back") for step in plain_steps()]
    engine = cell.engine(order_of(steps, ("T1",)))
    engine.run_to(engine.order.find("approach:T1"))
    Typed(monkeypatch, "back image").at(engine)
    assert "run held:T1 first, or use home; then ask why image again." in capsys.readouterr().err

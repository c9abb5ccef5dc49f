"""What a person sees of a case while it runs."""

from __future__ import annotations

from pathlib import Path

import pytest
from plain_steps import plain_order
from recording_cell import RecordingCell

from procedures.cli.case.case_view import CaseView, entry_of
from procedures.cli.case.display import following
from procedures.cli.runs.watching import line_of
from procedures.engine.context import StepContext
from procedures.engine.events import Event
from procedures.engine.result import StepResult
from procedures.engine.step import Outcome
from ronna_hw.errors import LinkTimeout

REASON = "the controller is silent"


@pytest.fixture
def events(tmp_path: Path) -> list[Event]:
    """Of a case whose first step has failed."""

    def fails(_context: StepContext) -> Outcome[StepResult]:
        raise LinkTimeout(REASON)

    engine = RecordingCell(tmp_path).engine(plain_order("T1", image=fails))
    reader = engine.events.subscribe()
    with pytest.raises(LinkTimeout):
        engine.run_to()
    return list(reader.read(0.0).events)


def test_why_a_case_is_held_is_told_once_in_the_picture(events: list[Event]) -> None:
    view = CaseView()
    for event in events:
        view.take_in(event)
    text = "\n".join(line for _, line in view.lines())
    assert text.startswith("held\n")
    assert text.count(REASON) == 1


def test_why_a_case_is_held_is_told_once_in_lines(events: list[Event]) -> None:
    text = "\n".join(line for event in events if (line := line_of(event)) is not None)
    assert text.count(REASON) == 1
    assert entry_of(events[-1]) is None
    assert text.endswith("held")


@pytest.mark.parametrize("quiet", [False, True])
def test_without_a_terminal_each_step_and_each_finding_has_its_line_unless_quiet(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], quiet: bool
) -> None:
    engine = RecordingCell(tmp_path).engine(plain_order("T1"))
    with following(quiet=quiet) as watcher:
        watcher.opened(engine)
        engine.run_to(engine.order.find("image"))
        engine.find("the tracker is silent")
        engine.events.end()
    told = capsys.readouterr().err.splitlines()
    assert [line.partition(":")[0] for line in told] == ([] if quiet else ["done image", "note"])

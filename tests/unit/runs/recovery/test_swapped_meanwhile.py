"""Anything swapped while a case was left is refused before anything is asked or moved."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from clinical_case import FIRST, ClinicalCell
from coded_errors import raises
from finished_runs import finished_run
from left_operation import left_after, other_arm, other_calibration, other_frame
from prepared_results import checked_plan
from recording_cell import STEREO_HEAD

from procedures.engine.engine import Engine
from procedures.engine.errors import RECOVERY_REFUSED
from procedures.runs import comparison, recovery
from procedures.runs.case import prepare_case
from procedures.runs.interrupted_run import InterruptedRun, Resumption, read_interrupted_run
from procedures.runs.lifecycle import open_run
from procedures.runs.observers import RunObservers
from procedures.runs.recovery import recover
from procedures.runs.request import CaseProcedure, RunRequest
from procedures.runs.theatre_history import UpdateAuthor, update_tables
from ronna_hw.config import TheatreFile
from ronna_hw.evidence.journal_reading import RUN_CHANGED
from ronna_hw.evidence.manifest import SEAL_FILE, sha256_of


def other_tool(cell: ClinicalCell) -> None:
    cell.arm.mounted = STEREO_HEAD


def other_camera(cell: ClinicalCell) -> None:
    cell.stereo.serials = ("0", "0")


@pytest.mark.hazard(2)
@pytest.mark.parametrize("swap", [other_tool, other_arm, other_calibration, other_frame, other_camera])
def test_a_swapped_device_or_record_is_refused_and_nothing_is_asked(
    cell: ClinicalCell, swap: Callable[[ClinicalCell], None]
) -> None:
    again, engine, left = left_after(cell, "tool_change")
    swap(again)
    with raises(RECOVERY_REFUSED, match="PRO-032"):
        recover(engine, left)
    assert again.operator.asked == []
    assert again.arm.motions == []


@pytest.mark.hazard(2)
def test_a_calibration_of_the_same_name_and_day_is_told_from_the_recorded_one(cell: ClinicalCell) -> None:
    again, engine, left = left_after(cell, "tool_change")
    other_calibration(again)
    with raises(RECOVERY_REFUSED) as refused:
        recover(engine, left)
    _, difference = refused.value.what.split("calibration tool_tip: recorded ")
    recorded, found = difference.split("; ")[0].split(", found ")
    assert recorded != found


@pytest.mark.hazard(26)
def test_a_record_that_has_expired_is_refused_unless_the_calibration_only_starts_from_it(
    cell: ClinicalCell,
) -> None:
    again, engine, left = left_after(cell, "tool_change")
    tip = again.calibrations.tool_tip
    engine.setting = replace(engine.setting, today=lambda: tip.expires + timedelta(seconds=1))
    with raises(RECOVERY_REFUSED, match=f"{tip.identifier}: recorded a valid one, found CAL-001"):
        recover(engine, left)
    engine.setting = replace(engine.setting, starts=frozenset(again.calibrations.records))
    recover(engine, left)


def test_a_theatre_file_updated_since_is_said_with_the_command_that_undoes_it(
    cell: ClinicalCell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    again, engine, left = left_after(cell, "tool_change")
    other_calibration(again)
    (lab := tmp_path / "lab.toml").write_text('theatre = "lab"\n')
    monkeypatch.setattr(InterruptedRun, "theatre_sha256", sha256_of(lab))
    monkeypatch.setattr(recovery, "read_request", lambda _folder: RunRequest(config=lab))
    update_tables(lab, {"procedure": {"approach_mm": 50.0}}, UpdateAuthor("calibration tool-tip", by="A. N."))
    with raises(RECOVERY_REFUSED) as refused:
        recover(engine, left)
    said = refused.value.what
    assert "updated since its state 0: " in said
    assert "A. N., calibration tool-tip" in said
    assert f"ronna-procedure theatre-history {lab} --restore 0 --by" in said


def longer_guide(engine: Engine) -> None:
    workcell = engine.setting.workcell
    guide = workcell.tools.guide
    bore = guide.bore.model_copy(update={"length_mm": guide.bore.length_mm + 20.0})
    records = {
        **workcell.tools.records,
        "guide": workcell.tools.records["guide"].model_copy(update={"bore": bore}),
    }
    workcell.tools = replace(workcell.tools, records=records)


def other_flange(engine: Engine) -> None:
    engine.setting.workcell.tools = replace(engine.setting.workcell.tools, flange="another flange")


def no_bodies(engine: Engine) -> None:
    cell = engine.setting.surroundings.model_copy(update={"bodies": ()})
    engine.setting = replace(engine.setting, surroundings=cell)


def faster_arm(engine: Engine) -> None:
    theatre = engine.setting.workcell._theatre
    table = theatre.file.robot["master"]
    faster = table.model_copy(update={"options": {**table.options, "speed_fraction": 0.25}})
    theatre.file = theatre.file.model_copy(update={"robot": {"master": faster}})


def with_tool_file(theatre: TheatreFile, rom: str) -> TheatreFile:
    tools = {"tools": [{"name": "robot_frame", "rom": rom}]}
    return theatre.model_copy(update={"tracker": theatre.tracker.model_copy(update={"options": tools})})


@pytest.mark.parametrize(("name", "is_same"), [("robot_frame.rom", True), ("other_frame.rom", False)])
def test_a_tool_definition_may_lie_elsewhere_and_must_be_the_same(
    cell: ClinicalCell, name: str, is_same: bool
) -> None:
    cell.theatre = with_tool_file(cell.theatre, "/runs/before/theatre/robot_frame.rom")
    _, engine, left = left_after(cell, "tool_check")
    theatre = engine.setting.workcell._theatre
    theatre.file = with_tool_file(theatre.file, f"/runs/moved/theatre/{name}")
    if is_same:
        recover(engine, left)
    else:
        with raises(RECOVERY_REFUSED, match=r"options of tracker: recorded tools .*other_frame\.rom"):
            recover(engine, left)


def other_settings(engine: Engine) -> None:
    settings = engine.setting.settings.model_copy(update={"approach_mm": 12.0})
    engine.setting = replace(engine.setting, settings=settings)


@pytest.mark.hazard(2)
@pytest.mark.parametrize(
    ("change", "reported"),
    [
        (longer_guide, r"tool record guide: recorded bore\.length_mm 8.*, found bore\.length_mm 10"),
        (other_flange, "flange: recorded '.*', found 'another flange'"),
        (no_bodies, "cell: recorded bodies 12 entries, found bodies 0 entries"),
        (faster_arm, r"options of robot\.master: recorded speed_fraction .*, found speed_fraction 0\.25"),
        (other_settings, r"settings of the procedure: recorded approach_mm 60\.0, found approach_mm 12\.0"),
    ],
)
def test_a_changed_theatre_file_is_refused_with_its_differences_and_nothing_is_asked(
    cell: ClinicalCell, change: Callable[[Engine], None], reported: str
) -> None:
    again, engine, left = left_after(cell, "tool_check")
    change(engine)
    with raises(RECOVERY_REFUSED, match=reported):
        recover(engine, left)
    assert again.operator.asked == []
    assert again.arm.motions == []


@pytest.mark.hazard(2)
def test_an_arm_moved_with_the_guide_in_front_of_an_entry_is_refused(cell: ClinicalCell) -> None:
    again, engine, left = left_after(cell, f"positioning:{FIRST}")
    A1, *others = again.arm.joints_rad
    again.arm.joints_rad = (A1 + 0.02, *others)  # type: ignore[assignment]
    with raises(RECOVERY_REFUSED, match="guide"):
        recover(engine, left)
    assert again.arm.motions == []


@pytest.mark.hazard(1)
def test_a_changed_plan_is_refused(cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch) -> None:
    again, engine, left = left_after(cell, "tool_change")
    monkeypatch.setattr(comparison, "read_plan", lambda _path: checked_plan(margin_mm=9.0).plan)
    with raises(RECOVERY_REFUSED, match="plan"):
        recover(engine, left)
    assert again.arm.motions == []


THEATRE: Any = SimpleNamespace()


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return finished_run(tmp_path / "run")


@pytest.mark.parametrize("content", ["= broken ][", None], ids=["no TOML", "missing"])
def test_a_plan_that_cannot_be_read_any_more_is_a_changed_input(run: Path, content: str | None) -> None:
    resumption = Resumption(read_interrupted_run(run), accepted=True)
    case = run.parent / "case"
    case.mkdir()
    if content is not None:
        (case / "plan.toml").write_text(content)
    request = RunRequest(procedure=CaseProcedure(case=case))
    with raises(RECOVERY_REFUSED, match="PRO-032") as refused, contextlib.ExitStack() as held:
        prepare_case(request, run, THEATRE, resumption, held)
    assert str(case / "plan.toml") in refused.value.what
    assert ("is not TOML" if content else "No such file") in str(refused.value.got)


def test_a_simulated_theatre_does_not_continue_in_another_scene(run: Path) -> None:
    shutil.copyfile(run / "request.json", run / "theatre" / "scene.json")
    (run / SEAL_FILE).unlink()
    left = read_interrupted_run(run, only_leaving=True)
    resumption = Resumption(left, accepted=True, only_leaving=True)
    request = RunRequest(procedure=CaseProcedure())
    with raises(RUN_CHANGED) as refused, open_run(request, run, RunObservers(), resumption):
        pass
    assert str(run / "theatre" / "scene.json") in refused.value.what
    assert "Put that file back" in refused.value.advice

"""Hazard 50: a target finished before the cart moved stays finished, with the registration that led there."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from clinical_case import FIRST, HOME_RAD, LAST, TRAJECTORIES, ClinicalCell, done_later
from prepared_results import (
    checked_paths,
    checked_plan,
    checked_set_up,
    checked_tool,
    coarse,
    correspondence,
    global_localization,
    imported_ct,
    localized_fiducials,
    locked_cart,
    mounted_guide,
    registered_robot,
)
from pydicom import dcmread
from recording_cell import RecordingArm
from report_figures import figures_in, figures_of_records
from run_again import broken_off, opened_again
from user_commands import in_this_process

from console.hub import Hub
from procedures.cli.procedure import app
from procedures.engine.case import StepKey
from procedures.engine.context import StepContext
from procedures.engine.engine import Engine
from procedures.engine.events import Event, JournalLine
from procedures.engine.events.event_file import EVENTS_FILE
from procedures.engine.order import Outcome, Scope
from procedures.exchange.run_export import export_run
from procedures.guards.errors import BaseShifted
from procedures.journal.journal import JOURNAL_FILE, Entry
from procedures.journal.results import FramedPose, StepResult
from procedures.operator.question import Topic
from procedures.reporting.ending import await_ending
from procedures.reporting.outcome import TargetTruth, Truth
from procedures.reporting.report import write_report
from procedures.reporting.run_reading import read_for_report
from procedures.reporting.tables import target_rows
from procedures.runs import case_outcome, lifecycle
from procedures.runs.case_outcome import build_finished_outcome
from procedures.runs.engine_setup import MovedCart
from procedures.runs.interrupted_run import read_interrupted_run
from procedures.runs.observers import RunObservers
from procedures.runs.request import CaseProcedure, RunRequest
from procedures.runs.way_out import has_head_moved, surround_arms
from procedures.steps.branches import HOLD
from procedures.steps.clinical import at_target, confirmation, path_check, positioning, retreat
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.cart_lock import LockedCart
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.positioning import PositionedGuide
from procedures.steps.clinical.results import RegisteredRobot
from procedures.steps.clinical.tool_check import APPROACHES
from procedures.steps.clinical.work_progress import DepthStop
from procedures.strategies.fixed_orientation import NeutralOrientation
from procedures.workcell import MountedTool
from ronna_hw import load_run
from ronna_hw.evidence.journal_reading import read_chain
from ronna_hw.evidence.manifest import KEPT_TRUTH, SEAL_FILE, Manifest, seal
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector

pytestmark = pytest.mark.hazard(50)
MOVED = BaseShifted("the cart has moved")


class Target(StepResult, kind="target"):
    """What is done at a target."""


def test_the_path_check_skips_a_target_finished_before_the_move(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path).carrying(MountedTool.STEREO_HEAD)
    engine = cell.begin(
        *(global_localization(), localized_fiducials(), checked_plan(), checked_set_up(cell)),
        done_later(correspondence()),
        path_check.STEP,
        done_later(Target(), CheckedPaths, scope=Scope.TRAJECTORY, finishes=True),
    )
    engine.run_to(engine.order.find(f"target:{FIRST}"))
    engine.void(StepKey(Correspondence.kind), MOVED)
    engine.run_to(engine.order.find("path_check"))
    paths = cell.case.get(CheckedPaths).result
    assert list(paths.targets) == list(paths.localizations) == [LAST]


POSE = FramedPose.of(Transform.of(Frame.ROBOT, Frame.TOOL))
STOP = DepthStop(bore_mm=1.0, standoff_mm=30.0, depth_mm=1.0, computed_mm=32.0, read_mm=32.0)
GUIDE = PositionedGuide(tool_pose=POSE, joints_rad=HOME_RAD)
REACHED = ReachedTarget(tool_pose=POSE, nominal_error_mm=0.0, too_deep_mm=0.0, depth_stop=STOP, pushed_mm=0.0)


def test_a_case_is_not_run_up_to_a_step_of_a_target_finished_before_the_move(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path)
    engine = cell.begin(
        checked_plan(),
        done_later(registered_robot()),
        done_later(REACHED, RegisteredRobot, scope=Scope.TRAJECTORY, finishes=True),
        done_later(Target(), scope=Scope.TRAJECTORY),
    )
    engine.run_to(engine.order.find(f"at_target:{FIRST}"))
    engine.void(StepKey(RegisteredRobot.kind), MOVED)
    assert engine.course.why_not_up_to(engine.order.find(f"target:{FIRST}")) == f"{FIRST} is finished"


def registered_twice(cell: ClinicalCell) -> Engine:
    """One registration for both targets; between them the cart moves, and the second one predicts more."""
    cell.strategy = NeutralOrientation()
    engine = cell.begin(
        *(imported_ct(), localized_fiducials(), checked_plan()),
        done_later(locked_cart()),
        replace(done_later(registered_robot(), LockedCart), run=register),
        done_later(GUIDE, RegisteredRobot, scope=Scope.TRAJECTORY),
        done_later(REACHED, PositionedGuide, scope=Scope.TRAJECTORY, finishes=True),
    )
    engine.run_to(engine.order.find(f"at_target:{FIRST}"))
    engine.void(StepKey(LockedCart.kind), MOVED)
    engine.run_to()
    engine.close("done")
    return engine


def register(context: StepContext) -> Outcome[StepResult]:
    """The prediction grows with the number of the parent's record."""
    context.result(LockedCart)
    rms_mm = int(context.identifier(LockedCart).partition("-")[0]) / 10
    made = registered_robot()
    served = [one for one in made.predictions if one.target in context.served_trajectories]
    predictions = tuple(one.model_copy(update={"rms_mm": rms_mm}) for one in served)
    return Outcome(made.model_copy(update={"predictions": predictions}))


PREDICTED_MM = {FIRST: 0.4, LAST: 0.8}  # by the fourth and by the eighth record


def test_outcome_and_report_show_each_target_with_the_registration_that_led_there(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path)
    cell.journal.write(Entry.OPENED, 0.0, run=tmp_path.name)
    engine = registered_twice(cell)
    outcome = build_finished_outcome(
        RunRequest(procedure=CaseProcedure()), engine.case, TRAJECTORIES, 0.0, 0.0, Truth()
    )
    assert {one.id: one.predicted_tre_mm for one in outcome.targets} == PREDICTED_MM
    rows = target_rows(read_for_report(tmp_path), Truth())
    assert {one.target: one.predicted.rms_mm for one in rows} == PREDICTED_MM
    assert figures_in(write_report(tmp_path)) == figures_of_records(tmp_path)


@pytest.mark.parametrize(("figure", "changed"), [("rms_mm", 1e40), ("target", 5), ("target", "\ud800")])
def test_a_changed_figure_of_one_registration_does_not_prevent_the_report(
    tmp_path: Path, figure: str, changed: object
) -> None:
    registered_twice(ClinicalCell(tmp_path))
    path = max((tmp_path / "records").glob("*-registration*.json"))
    record = json.loads(path.read_text())
    record["payload"]["predictions"][0][figure] = changed
    path.write_text(json.dumps(record))
    report = write_report(tmp_path).read_text()
    assert path.name in report


def test_each_target_is_exported_with_its_registration_in_a_frame_of_reference_of_its_own(
    tmp_path: Path,
) -> None:
    registered_twice(ClinicalCell(tmp_path / "run"))
    seal(tmp_path / "run", Manifest(read_chain(tmp_path / "run" / JOURNAL_FILE).lines).files)
    first, again = (
        {one.name: one for one in export_run(tmp_path / "run", tmp_path / name).files}
        for name in ("one", "two")
    )
    registrations = [f"registration-{name}.dcm" for name in TRAJECTORIES]
    assert set(registrations) < set(first)
    frames, others = (
        [dcmread(files[name]).FrameOfReferenceUID for name in registrations] for files in (first, again)
    )
    assert len(set(frames)) == len(TRAJECTORIES)
    assert frames == others
    table = (tmp_path / "one" / "registrations.csv").read_text().splitlines()
    assert [line.partition(",")[0] for line in table] == ["trajectory", *TRAJECTORIES]


ENDINGS = {  # error, whether the second target is in doubt, file lost after the end or None -> ending
    (0.5, False, None): "done",
    (2.5, False, None): "missed",
    (0.5, True, None): "in doubt",
    (2.5, True, None): "missed",
    (2.5, False, KEPT_TRUTH): "error not determined",
    (2.5, True, KEPT_TRUTH): "in doubt",
    (2.5, False, SEAL_FILE): "not sealed",
}


@pytest.mark.hazard(39)
@pytest.mark.parametrize(("error_mm", "doubted", "lost"), ENDINGS)
def test_every_reader_of_a_run_says_the_same_ending(
    tmp_path: Path, error_mm: float, doubted: bool, lost: str | None
) -> None:
    word, run = ENDINGS[error_mm, doubted, lost], tmp_path / "runs" / "run"
    run.parent.mkdir()
    cell = ClinicalCell(run)
    cell.journal.write(Entry.OPENED, 0.0, run="run", banner="SIMULATION", truth={"theatre/scene.json": None})
    if doubted:
        cell.journal.write(Entry.FINDING, 0.0, text="the room was bent", targets=[LAST])
    engine, request = registered_twice(cell), RunRequest(procedure=CaseProcedure())
    truth = Truth(targets=(TargetTruth(id=FIRST, application_error_mm=error_mm),))
    closed = event_of_last_line(run)
    outcome = build_finished_outcome(request, engine.case, TRAJECTORIES, 0.0, 0.0, truth)
    write_report(run, truth=truth, seals=True)
    seal(run, Manifest(read_chain(run / JOURNAL_FILE).lines).files)
    if lost is None:
        export_run(run, tmp_path / "out")
        exported = json.loads((tmp_path / "out" / "export.json").read_text())
        page = (run / "report.html").read_text()
        assert {outcome.outcome, exported["ending"]} == {word}
    else:
        (run / lost).unlink()
        page = write_report(run, out=tmp_path / "out").read_text()
    (listed,) = json.loads(in_this_process(app, "list", run.parent, "--json").stdout)["runs"]
    shown = json.loads(in_this_process(app, "show", run, "--json").stdout)
    watched = in_this_process(app, "watch", run).stderr.splitlines()[-1]
    hub = Hub(run)
    hub.take(closed)
    hub.take_ending(await_ending(run))
    page_of_case = hub.told(hub.view)
    assert f'<p class="ending {word.replace(" ", "-")}">' in page
    said = (load_run(run).outcome, listed["ended"], shown["ended"], watched.split(":")[0])
    assert {*said, page_of_case.outcome} == {word}
    assert {listed["sentence"], watched.partition(": ")[2], page_of_case.ending} == {shown["sentence"]}
    error_known = word in ("done", "missed") or lost is None
    assert {row["max_application_error_mm"] for row in (listed, shown)} == {error_mm if error_known else None}
    assert bool(listed["problems"]) is (lost is not None)


def event_of_last_line(run: Path) -> Event:
    """Leave the last line of a journal as the only event of its run."""
    line = json.loads((run / JOURNAL_FILE).read_text().splitlines()[-1])
    event = Event(number=1, host_time=line["host_time"], theatre_time_s=1.0, what=JournalLine(line=line))
    (run / EVENTS_FILE).write_text(event.model_dump_json() + "\n")
    return event


@dataclass
class Rolls:
    """A cart that moves when the work at a target is done, before the motion after `at` others."""

    engine: Engine
    arm: RecordingArm
    target: str
    at: int
    name = "cart"

    def unmet(self) -> str | None:
        finished = self.engine.case.stands(StepKey(ReachedTarget.kind, self.target))
        if finished and len(self.arm.motions) == self.at:
            self.at = -1
            self.engine.void(StepKey(LockedCart.kind), MOVED)
            raise MOVED
        return None


def rolling(cell: ClinicalCell, target: str, at: int) -> Engine:
    """A case from the path check on, with a cart that rolls."""
    cell.carrying(MountedTool.GUIDE).settled()
    engine = cell.begin(
        *(checked_paths(cell), checked_plan(), localized_fiducials(), *coarse(), mounted_guide()),
        *(checked_tool(), done_later(locked_cart())),
        done_later(registered_robot(), LockedCart, scope=Scope.LOCALIZATION),
        *(positioning.STEP, at_target.STEP, retreat.STEP, confirmation.STEP),
    )
    engine.goes_on = MovedCart(engine).continues_by_consent
    engine.checkpoint.guards.append(Rolls(engine, cell.arm, target, at))
    return engine


AT_ONE = 2  # motions: over a target and along its axis
HOME = 2  # a little before, then onto it
LOOKED_AFTER = 1 + HOME + 2 * APPROACHES + HOME  # back and home; three times onto the gauge; home
BOTH_FINISHED = AT_ONE + LOOKED_AFTER + AT_ONE


@pytest.mark.branch("CART_MOVED")
@pytest.mark.parametrize("at", [BOTH_FINISHED, BOTH_FINISHED + 1])
def test_the_arm_goes_home_and_the_case_ends_well_once_every_target_is_finished(
    tmp_path: Path, at: int
) -> None:
    cell = ClinicalCell(tmp_path)
    engine = rolling(cell, LAST, at)
    engine.run_to()
    asked = [one.topic for one in cell.operator.asked]
    last = asked[len(asked) - asked[::-1].index(Topic.CART_MOVED) - 1 :]
    assert last == [Topic.CART_MOVED, *([Topic.RETREAT] if at == BOTH_FINISHED else []), Topic.PARK]
    assert cell.workcell.master.place.is_home
    assert engine.over
    assert engine.machine.state == "finished"


def test_the_arm_stays_and_the_case_does_not_end_without_consent(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path)
    engine = rolling(cell, LAST, BOTH_FINISHED)
    cell.operator.answers = {Topic.CART_MOVED: HOLD}
    with pytest.raises(BaseShifted):
        engine.run_to()
    assert len(cell.arm.motions) == BOTH_FINISHED
    assert not engine.over
    engine.retreat_home()
    assert engine.over


def test_a_cart_that_moves_on_the_way_out_of_the_first_target_is_locked_again(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path)
    engine = rolling(cell, FIRST, AT_ONE)
    engine.run_to()
    done = [step for _, step in cell.entries("result")]
    assert [done.count(f"at_target:{name}") for name in TRAJECTORIES] == [1, 1]
    assert done.count("cart_lock") == 2
    assert engine.over


def test_a_restart_before_the_last_journal_line_ends_the_case_without_opening_a_device(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = ClinicalCell(tmp_path)
    engine = rolling(cell, FIRST, AT_ONE)
    engine.run_to()
    assert {engine.course.status(key) for key in engine.order.sequence} == {"done", "finished"}
    broken_off(cell)
    monkeypatch.setattr(case_outcome, "restore_order", lambda *_: engine.order)
    monkeypatch.setattr(case_outcome, "outcome_as_recorded", lambda _request, left: left)
    monkeypatch.setattr(lifecycle, "open_engine", pytest.fail)
    request, left = RunRequest(procedure=CaseProcedure()), read_interrupted_run(tmp_path)
    ended = case_outcome.finish_case(request, left, RunObservers(), accepted=True)
    assert ended.run.journal[-1]["outcome"] == "done"  # type: ignore[attr-defined]


def test_an_arm_still_out_after_a_restart_can_be_brought_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = ClinicalCell(tmp_path)
    engine = rolling(cell, LAST, BOTH_FINISHED)
    cell.operator.answers = {Topic.CART_MOVED: HOLD}
    with pytest.raises(BaseShifted):
        engine.run_to()
    broken_off(cell)
    again, engine, left = opened_again(cell, engine.order)
    assert not engine.over
    again.workcell.master.restore_history(left.arm)
    again.workcell.master.restore_home(HOME_RAD)
    again.workcell.master.mount.identify()
    assert has_head_moved(engine)
    engine.accept()
    near_rad: list[JointVector | None] = []
    monkeypatch.setattr(again.workcell.master, "surround", lambda _, near=None: near_rad.append(near))
    surround_arms(engine)
    assert (
        near_rad == [again.workcell.master.joints_rad()] != [HOME_RAD]
    )  # exact where it stands, not at home
    monkeypatch.undo()
    surround_arms(engine)
    engine.retreat_home()
    assert engine.over

"""The report shows the numbers of the records in full, and calls no fit an accuracy."""

from __future__ import annotations

import csv
import json
import math
import os
import re
import shutil
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from clinical_case import FIRST, LAST, TRAJECTORIES, ClinicalCell, done_later
from finished_runs import recorded_run
from prepared_results import (
    checked_paths,
    checked_plan,
    global_localization,
    imported_ct,
    localized_fiducials,
    registered_robot,
    relocalization,
    up_to_correspondence,
)
from report_figures import figures_in, figures_of_records
from report_text import report_text
from scipy.spatial.transform import RigidTransform
from skin_case import registered_by_surface, scanned_surface, skin_in_ct, surface_start, surveyed_start
from whole_run import IMPORTED

from procedures.cli.runs.showing import show_run
from procedures.engine.case import StepKey
from procedures.engine.engine import Engine
from procedures.engine.methods import CaseMethods
from procedures.engine.order import Scope
from procedures.exchange.run_export import export_run
from procedures.guards.errors import BaseShifted, PatientMoved
from procedures.imaging.localizers import Localizer
from procedures.journal.journal import Entry, Line
from procedures.journal.results import FramedPose
from procedures.postoperative.summary import PostoperativeCheck
from procedures.reporting.files import LARGEST_PICTURE_BYTES, PostoperativeResult, store_check
from procedures.reporting.outcome import ErrorParts, TargetTruth, Truth
from procedures.reporting.pictures import PUBLISHED_MM
from procedures.reporting.report import write_report
from procedures.reporting.run_events import begun_insertions, last_held_name
from procedures.reporting.run_reading import describe_strategies, find_used_strategies, read_for_report
from procedures.reporting.run_statistics import timeline
from procedures.reporting.tables import plan_rows
from procedures.runs.finishing import seal_run
from procedures.steps.clinical import registration
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.path_check import CheckedPaths, ClosestApproach, MotionPreview
from procedures.steps.clinical.results import LeftOutSphere, RegisteredRobot
from procedures.steps.clinical.surface.surface_registration import SIDES_COMPARED
from procedures.steps.clinical.work_progress import DepthStop
from procedures.strategies.pose_values import PoseValues
from procedures.strategies.skin_looks import SKIN
from procedures.workcell import MountedTool
from ronna_hw import load_run
from ronna_hw.frames import Frame, Transform

ROOT = Path(__file__).resolve().parents[3]
PARTS = ErrorParts(registration_mm=(1.2, 0.0, 0.0), intrinsic_mm=(-0.9, 0.3, 0.07))
TRUE = TargetTruth(id=FIRST, application_error_mm=0.4321, lateral_mm=0.4, axial_mm=-0.1, parts=PARTS)
TRUTH = Truth(targets=(TRUE,))


class Page(HTMLParser):
    """What a page would fetch, its elements, and its pictures' attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.elements: set[str] = set()
        self.drawings: list[dict[str, str | None]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.add(tag)
        named = dict(attrs)
        sources = [named.get(name) or "" for name in FETCHING if name in named]
        styles = re.findall(r"url\(([^)]*)", named.get("style") or "")
        self.fetched += [one for one in (*sources, *styles) if not one.startswith("data:")]
        if tag == "svg":
            self.drawings.append(named)


@pytest.fixture(scope="module")
def reported(registered_once: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a registered case with the errors of its first target, to be read only."""
    folder = tmp_path_factory.mktemp("reported") / registered_once.name
    return write_report(Path(shutil.copytree(registered_once, folder)), truth=TRUTH)


# Attributes whose value a browser loads, follows or posts to.
FETCHING = ("src", "srcset", "href", "xlink:href", "data", "poster", "action", "formaction", "background")


def test_the_page_is_self_contained(reported: Path) -> None:
    text = reported.read_text()
    page = Page(text)
    assert page.fetched == []
    assert not page.elements & {"script", "link", "iframe", "object", "embed", "base", "form"}
    style = text.partition("<style>")[2].partition("</style>")[0]
    assert "url(" not in style
    assert "@import" not in style


def test_drawings_fill_the_width_and_take_the_ink_of_the_page(reported: Path) -> None:
    text = reported.read_text()
    page = Page(text)
    assert page.drawings
    for drawing in page.drawings:
        assert "viewBox" in drawing or "viewbox" in drawing
        assert "width" not in drawing
        assert drawing["fill"] == "currentColor"
    assert 'name="viewport" content="width=device-width' in text


def test_each_cell_of_a_wide_table_carries_its_heading_for_a_phone(reported: Path) -> None:
    text = reported.read_text()
    detail = text.partition("Error at the targets, in detail")[2].partition("</table>")[0]
    assert f'<td data-label="target">{FIRST}</td><td data-label="error mm">0.432</td>' in detail
    for table in re.findall(r'<table class="[^"]*stacked">.*?</table>', text, re.DOTALL):
        headings = re.findall(r"<th>(.*?)</th>", table.partition("</thead>")[0])
        for row in re.findall(r"<tr\b.*?</tr>", table.partition("</thead>")[2], re.DOTALL):
            assert re.findall(r'<td data-label="([^"]*)"', row) == headings


def test_the_paper_is_a4_and_names_what_is_not_on_it(registered: Path) -> None:
    text = write_report(registered).read_text()
    assert "@page { size: A4" in text
    folded = re.findall(r"<details( class=\"paper\")?><summary><h2>(.*?)</h2>", text)
    left_out = [title for on_paper, title in folded if not on_paper]
    assert left_out
    assert f"Folded and not on paper: {'; '.join(left_out)}." in text


@pytest.mark.parametrize(
    ("error_mm", "said", "word"),
    [(0.4321, "within", "Done"), (2.5, "beyond", "Missed"), (None, "predicted within", "Done")],
)
def test_the_verdict_and_the_errors_against_the_margin_come_before_everything_else(
    engine: Engine, error_mm: float | None, said: str, word: str
) -> None:
    engine.run_to()
    engine.close("done")
    known = [] if error_mm is None else [TargetTruth(id=FIRST, application_error_mm=error_mm)]
    truth = Truth(targets=tuple(known))
    text = report_text(write_report(engine.case.folder, truth=truth, seals=True))
    head = text.partition("</style>")[2].partition("<details")[0]
    assert f"<strong>{word}.</strong>" in head
    (row,) = re.findall(rf"<tr><td>{FIRST}</td>.*?</tr>", head)
    cells = re.findall(r"<td[^>]*>(.*?)</td>", row)
    shown = "–" if error_mm is None else f"{error_mm:.3f}"
    assert cells[1:4] == [f"<strong>{shown}</strong>", "2.000", said]
    assert head.index("</table>") < (head + "<figure>").index("<figure>")
    assert ("What to do." in head) is (word == "Missed")


def test_a_target_within_the_margin_tells_a_predicted_limit_that_is_not(cell: ClinicalCell) -> None:
    run = recorded_run(
        cell.folder.parent / "run",
        (StepKey("ct_import"), IMPORTED),
        (StepKey("plan_check"), checked_plan(margin_mm=0.6)),
        (StepKey("skin_in_ct"), skin_in_ct()),
        (StepKey("surface_registration"), registered_by_surface()),
        linked=True,
    )
    truth = Truth(targets=(TargetTruth(id=FIRST, application_error_mm=0.4, lateral_mm=0.4, axial_mm=-0.1),))
    head = report_text(write_report(run, truth=truth, out=run.parent / "out")).partition("<details")[0]
    assert re.search(rf"<tr><td>{FIRST}</td>.*>within, 95 % limit beyond the margin</td>", head)
    assert re.search(rf"<tr><td>{LAST}</td>.*>rms within, limit beyond</td>", head)


@pytest.mark.hazard(28)
def test_fit_residuals_are_not_mentioned_on_the_page(reported: Path) -> None:
    text = reported.read_text().lower()
    assert not re.search(r"\bfre\b|residual", text)
    assert "says nothing about the error at a target" in text


def test_prediction_error_and_budget_of_each_target_are_shown(reported: Path) -> None:
    text = report_text(reported)
    for stored in read_for_report(reported.parent).valid_results(RegisteredRobot):
        (predicted,) = stored.result.predictions
        for value in (predicted.rms_mm, predicted.limit_mm, *(share.rms_mm for share in predicted.budget)):
            assert f"<td>{value:.3f}</td>" in text or f"<td>{value:.3f} mm at 95 %</td>" in text
    assert f"<td>{FIRST}</td><td>0.432</td>" in text  # the error first, also on a narrow screen
    assert "<td>0.400</td><td>-0.100</td>" in text


def test_a_check_after_the_operation_that_cannot_be_read_is_named(registered: Path) -> None:
    (registered / "report").mkdir(exist_ok=True)
    (registered / "report" / "postoperative.json").write_text("{")
    assert (
        "postoperative.json, the check after the operation, cannot be read"
        in write_report(registered).read_text()
    )


def test_the_page_shows_the_warnings_of_a_check_after_the_operation(registered: Path) -> None:
    found = PostoperativeCheck(
        pre_series_instance_uid="1.2.1",
        post_series_instance_uid="1.2.2",
        post_from_pre=((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)),
        bone_agreement=0.99,
        bone_overlap=1.0,
        trajectories=(),
        warnings=("T1 is 3.62 mm off its target: the plan accepts 2 mm",),
    )
    store_check(registered / "report", PostoperativeResult(found))
    assert f"<strong>{found.warnings[0]}.</strong>" in write_report(registered).read_text()


@pytest.mark.hazard(6)
def test_a_picture_that_is_too_large_or_a_link_is_left_out_and_named(registered: Path) -> None:
    pictures = registered / "pictures"
    pictures.mkdir(exist_ok=True)
    (pictures / "ct-1.png").touch()
    os.truncate(pictures / "ct-1.png", 1_500_000_000)  # as much of it in memory ended the report
    (pictures / "ct-2.png").symlink_to("/etc/hostname")  # whoever made the run gets no other file with it
    page = write_report(registered).read_text()
    assert "ct-1.png is left out" in page
    assert "ct-2.png is left out" in page
    assert len(page) < LARGEST_PICTURE_BYTES


@pytest.mark.hazard(6)
def test_the_figures_of_the_targets_are_those_of_the_records_and_of_the_truth(reported: Path) -> None:
    shown = figures_in(reported)
    assert shown == figures_of_records(reported.parent)
    assert [(name, error) for name, error, *_ in shown] == [(FIRST, "0.432"), (LAST, "–")]


@pytest.mark.hazard(6)
def test_the_figures_after_a_registration_was_voided_are_those_of_the_next(engine: Engine) -> None:
    engine.run_to(StepKey("registration", FIRST))
    engine.context(StepKey("registration", FIRST)).void(
        GlobalLocalization, PatientMoved("the head has moved")
    )
    engine.run_to()
    engine.close("left")
    report = write_report(engine.case.folder, truth=TRUTH)
    assert figures_in(report) == figures_of_records(engine.case.folder)


def test_the_places_by_the_tracker_stand_beside_those_in_the_ct(cell: ClinicalCell) -> None:
    before = imported_ct(), localized_fiducials()
    cell.begin(*before, global_localization()).run_to()
    (tracked,) = read_for_report(cell.folder).valid_results(GlobalLocalization)
    places = [" ".join(f"{one:.3f}" for one in point) for point in tracked.result.points_tracker_mm]
    text = report_text(write_report(cell.folder))
    assert "<th>by the tracker x y z mm, tracker frame</th>" in text
    assert f"paired with no sphere of the CT: {'; '.join(places)} (x y z in mm, tracker frame)" in text


def test_results_that_a_repetition_superseded_are_named_and_struck_through(engine: Engine) -> None:
    engine.run_to(StepKey("registration", FIRST))
    repeated = StepKey("relocalization")
    standing = [engine.case.record_of(key) for key in (repeated, StepKey("registration", FIRST))]
    engine.run_step(repeated)
    engine.run_to()
    engine.close("left")
    text = report_text(write_report(engine.case.folder))
    assert f"Repeated; these results are no longer valid: {'; '.join(map(str, standing))}" in text
    struck = re.findall(r'<tr class="superseded"><td>(\S+) \(superseded\)</td>', text)
    assert struck == standing
    assert "no later step has used them" in text


def test_a_move_of_the_cart_is_told_in_the_head_of_the_page_once(cell: ClinicalCell) -> None:
    moved = BaseShifted("the cart was moved by 1.74 mm", limit="0.85 mm", got="1.74 mm")
    told = {"step": "relocalization:T2", "code": moved.code, "what": str(moved)}
    cell.journal.write(Entry.VOIDED, 38.4, supersedes=["06-cart_lock", "07-global_localization"], **told)
    cell.journal.write(Entry.FAILED, 38.5, **told)
    head = write_report(cell.folder).read_text().partition("<details")[0]
    said = "the cart was moved by 1.74 mm; limit 0.85 mm, got 1.74 mm; 2 results no longer valid"
    assert f"Moved during the case:<ul><li>38.4 s: {said}</li></ul>" in head


@pytest.mark.hazard(6)
def test_cells_that_hold_numbers_do_not_break_inside_them(registered: Path) -> None:
    style = write_report(registered).read_text().partition("</style>")[0]
    cells = re.search(r"\nth, td \{([^}]*)\}", style)
    assert cells is not None
    assert "overflow-wrap: normal" in cells[1]
    assert "text-overflow" not in style
    assert "overflow: hidden" not in style
    assert "overflow-x" not in style


def test_every_drawing_has_its_data_in_a_csv_file(reported: Path) -> None:
    folder = reported.parent / "report"
    pictures = {path.stem for path in folder.glob("*.svg")}
    assert pictures == {"targets", "error_parts", "timeline"}
    assert {path.stem for path in folder.glob("*.csv")} == pictures
    rows = list(csv.DictReader((folder / "targets.csv").read_text().splitlines()))
    assert [row["target"] for row in rows] == list(TRAJECTORIES)
    shares = [float(value) for name, value in rows[0].items() if name.endswith("_rms_mm")][1:]
    assert np.linalg.norm(shares) == pytest.approx(float(rows[0]["predicted_rms_mm"]))
    spans = timeline(read_for_report(reported.parent).run.journal)
    assert len((folder / "timeline.csv").read_text().splitlines()) == 1 + len(spans)


def test_a_report_made_again_from_the_folder_alone_is_identical(registered: Path, tmp_path: Path) -> None:
    first = write_report(registered, truth=TRUTH).read_text()
    seal_run(registered)
    again = write_report(registered, out=tmp_path / "elsewhere").read_text()
    made = r"Report made [^<]*"
    assert re.sub(made, "", again) == re.sub(made, "", first)
    assert (
        json.loads((tmp_path / "elsewhere" / "report" / "truth.json").read_text())["targets"][0]["id"]
        == FIRST
    )


def test_questions_are_listed_with_the_displayed_value_and_the_answer(registered: Path) -> None:
    text = report_text(write_report(registered))
    shown = r'</td><td class="free">predicted target error .* at 95%; not included: .*</td><td>yes</td>'
    assert re.search(f"Accept the registration for {FIRST}\\?{shown}", text)


def test_a_rehearsal_without_truth_does_not_claim_measured_errors(registered: Path) -> None:
    measured, predicted = "Errors are measured against", "Errors are predicted"
    assert predicted in (text := write_report(registered).read_text())
    assert measured not in text
    assert measured in write_report(registered, truth=TRUTH).read_text()


def test_insertions_that_an_assistant_began_are_listed_by_trajectory() -> None:
    by_assistant = {"entry": "motion", "arm": "assistant"}
    lines: list[Line] = [
        {"entry": "motion", "arm": "master", "what": "insert", "trajectory": "T3"},
        {**by_assistant, "what": "settle", "trajectory": None},
        *[{**by_assistant, "what": "insert", "trajectory": one} for one in ("T1", "T2", "T2")],
    ]
    assert begun_insertions(lines) == ("T1", "T2")


@pytest.mark.hazard(65)
def test_a_drill_is_not_told_as_an_instrument() -> None:
    drill: Line = {"entry": "held", "arm": "assistant", "held": True, "drill": {"entry_mm": 100.0}}
    instrument: Line = {"entry": "held", "arm": "assistant", "held": True}
    assert last_held_name([instrument, drill]) == "drill"
    assert last_held_name([drill, {**drill, "held": False}, instrument]) == "instrument"
    assert last_held_name([]) == "instrument"


def test_a_simulated_report_says_how_the_arms_error_sizes_were_chosen(reported: Path) -> None:
    text = reported.read_text()
    assert "so that table 4 of the thesis comes out, so to be near it confirms nothing" in text


def test_the_commit_and_the_lock_of_each_session_are_in_the_report(cell: ClinicalCell) -> None:
    first, second = "ronna-hw 0.1.0 (abc), lock 123", "ronna-hw 0.1.0 (def), lock 123"
    for software in (first, first, second):
        cell.journal.write(Entry.RESTARTED, 0.0, software=software)
    assert f"{first}; after a restart {second}." in write_report(cell.folder).read_text()


def test_incidents_are_listed_with_the_time_and_routine_entries_are_left_out(cell: ClinicalCell) -> None:
    cell.journal.write(Entry.INTENT, 1.0, step="at_target:T1")
    cell.journal.write(Entry.STAGE, 1.1, trajectory="T1", stop={"bore_mm": 85.0})
    cell.journal.write(Entry.INSTRUMENT, 1.2, trajectory="T1", inside=True)
    cell.journal.write(Entry.FAILED, 2.0, step="at_target:T1", code="EKI-010", what="EKI-010: stopped. Look.")
    cell.journal.write(Entry.ACKNOWLEDGED, 3.0, device="arm", fault="EKI-010: stopped. Look.", by="A. Nurse")
    for _ in range(2):
        cell.journal.write(Entry.RESTARTED, 4.0, begun="at_target:T1", torn_bytes=0, orphans=[])
        cell.journal.write(Entry.FINDING, 5.0, text="the head was hidden")
    text = write_report(cell.folder).read_text()
    table = text.partition("Refusals, rests, faults")[2].partition("</table>")[0]
    assert "A. Nurse acknowledged the fault of the arm: EKI-010" in table
    assert table.count("The program ended before at_target:T1 was complete") == 1
    assert not re.search(r"bore_mm|inside|torn|the head was hidden", table)
    assert table.count("stopped. Look.") == 1
    assert len(re.findall(r"<td>\d\d:\d\d:\d\d<br>\d\.\d s</td>", table)) == 3
    assert text.count("the head was hidden") == 1


def test_exclusions_are_listed_with_their_reasons(cell: ClinicalCell) -> None:
    spheres = (LeftOutSphere(fiducial=2, reason="no rim"),)
    done = registered_robot().model_copy(update={"left_out": {"T2": "too deep"}, "left_out_spheres": spheres})
    cell.begin(done).run_to()
    text = write_report(cell.folder).read_text()
    assert "<li>T2 was left out: too deep</li><li>Sphere 3 was left out: no rim</li>" in text


@pytest.mark.hazard(44)
@pytest.mark.parametrize(
    ("done_before", "pushed_mm", "said"),
    [
        (("skin", "drill", "dura", "insert"), None, "<td>not watched</td>"),
        (("skin",), 0.0123, "<td>0.012; earlier, not watched: skin</td>"),
        ((), 0.0123, "<td>0.012</td>"),
    ],
)
def test_displacement_of_the_guide_is_reported_only_for_watched_work(
    cell: ClinicalCell, done_before: tuple[str, ...], pushed_mm: float | None, said: str
) -> None:
    finish(cell, reached_target().model_copy(update={"pushed_mm": pushed_mm, "done_before": done_before}))
    assert said in report_text(write_report(cell.folder))


def test_the_pose_in_which_the_guide_was_held_is_told_by_its_six_values(cell: ClinicalCell) -> None:
    values = PoseValues(512.25, -40.5, 310.75, *np.radians([12.5, 61.25, -140.0]).tolist())
    finish(cell, reached_target().model_copy(update={"tool_pose": FramedPose.of(values.pose)}))
    cells = re.findall(r"<td[^>]*>([^<]*)</td>", write_report(cell.folder).read_text())
    shown = [FIRST, "512.250", "-40.500", "310.750", "12.500", "61.250", "-140.000"]
    assert shown in [cells[place : place + len(shown)] for place in range(len(cells))]
    (row, *_) = csv.DictReader((cell.folder / "report" / "guide_poses.csv").read_text().splitlines())
    assert (row["target"], float(row["gamma_deg"])) == (FIRST, pytest.approx(-140.0))


def test_a_pose_of_the_guide_in_another_frame_is_left_out_and_noted(cell: ClinicalCell) -> None:
    in_ct = Transform(Frame.CT, Frame.TOOL, RigidTransform.identity())
    finish(cell, reached_target().model_copy(update={"tool_pose": FramedPose.of(in_ct)}))
    text = report_text(write_report(cell.folder))
    assert "the pose of the guide is left out: a transform robot &lt;- tool is needed" in text
    assert "guide held at" not in text


def reached_target() -> ReachedTarget:
    """A target at which the guide was held, without its pose and its watched displacement."""
    stop = DepthStop(bore_mm=1.0, standoff_mm=30.0, depth_mm=1.0, computed_mm=32.0, read_mm=32.0)
    return ReachedTarget(
        tool_pose=None, nominal_error_mm=None, too_deep_mm=0.0, depth_stop=stop, pushed_mm=None
    )


def finish(cell: ClinicalCell, reached: ReachedTarget) -> None:
    """Run the case to its end, in which each target is reached so."""
    engine = cell.begin(
        *up_to_correspondence(cell),
        registered_robot(),
        done_later(reached, scope=Scope.TRAJECTORY, finishes=True),
    )
    engine.run_to()
    engine.close("done")


def test_the_plan_has_its_clearance_and_its_turn_about_the_axis(cell: ClinicalCell) -> None:
    near = ClosestApproach(first="tube of the guide", second="fiducial", distance_mm=16.24, at=1.0)
    at_head = ClosestApproach(first="end of the stereo head", second="head", distance_mm=63.71, at=0.5)
    motions = tuple(
        MotionPreview(
            start=start,
            end=end,
            kind=kind,
            duration_s=1.0,
            clear=True,
            closest=closest,
            largest_joint_speed_share=0.5,
            largest_speed_mm_s=100.0,
            nearest_to_head_mm=head_mm,
        )
        for start, end, kind, closest, head_mm in (
            ("home", f"{FIRST}/fiducial 1", "move", None, 77.9),
            (f"{FIRST}/target", f"{FIRST}/target", "line", near, 18.29),
            (f"{FIRST}/target", f"{FIRST}/target", "back", near, 18.29),
            ("home", "other/target", "move", near, 1.0),
            ("home", f"{SKIN}/fiducial 0", "move", at_head, 63.71),
        )
    )
    cell.carrying(MountedTool.STEREO_HEAD)
    paths = checked_paths(cell, turn_rad=math.radians(12.0)).model_copy(update={"motions": motions})
    cell.begin(*up_to_correspondence(cell), paths).run_to()
    (row, *_) = plan_rows(read_for_report(cell.folder))
    assert (row.name, row.turn_deg, row.nearest_head_mm) == (FIRST, pytest.approx(12.0), 18.29)
    assert row.nearest is not None
    assert row.nearest.closest == near
    text = report_text(write_report(cell.folder))
    assert "<td>12.0</td><td>18.3</td><td>16.2</td></tr>" in text
    picture = (cell.folder / "report" / f"clearance-{FIRST}.svg").read_text()
    assert "home → sphere 2" in picture
    assert "target, along the axis  (tube of the guide – fiducial)" in picture
    lines = (cell.folder / "report" / f"clearance-{FIRST}.csv").read_text().splitlines()
    assert len(lines) == 1 + 2
    over_skin = (cell.folder / "report" / "clearance-+skin.svg").read_text()
    assert "home → look 1  (end of the stereo head – head)" in over_skin
    assert over_skin.count("63.7 mm") == 1  # the head is not shown as a second body beside itself


def test_a_target_keeps_the_strategy_it_was_last_planned_with(
    cell: ClinicalCell, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell.carrying(MountedTool.STEREO_HEAD)
    paths = checked_paths(cell).model_copy(update={"replaced": {FIRST: "nos"}})
    engine = cell.begin(*up_to_correspondence(cell), paths, relocalization(), registration.STEP)
    engine.run_to()
    engine.close("done")
    assert "strategy ocs asked for, nos and ocs used" in write_report(cell.folder).read_text()
    seal_run(cell.folder)
    assert dict(load_run(cell.folder).targets[["name", "strategy"]].tolist()) == {FIRST: "nos", LAST: "ocs"}
    export_run(cell.folder, tmp_path / "out")
    rows = csv.DictReader((tmp_path / "out" / "errors.csv").read_text().splitlines())
    assert [row["strategy"] for row in rows] == ["nos", "ocs"]
    show_run(cell.folder, as_json=False)
    assert f"strategy ocs ({FIRST} by nos)" in capsys.readouterr().out
    (made,) = read_for_report(cell.folder).valid_results(CheckedPaths)
    later = made.result.model_copy(update={"replaced": {}, "targets": {LAST: made.result.targets[LAST]}})
    again = replace(made, result=later)  # after a move, when the first is finished
    assert find_used_strategies((made, again)) == {FIRST: "nos", LAST: "ocs"}
    left_out = replace(made, result=later.model_copy(update={"targets": {}, "left_out": {LAST: "no path"}}))
    assert find_used_strategies((made, left_out)) == {FIRST: "nos"}


def test_the_strategy_of_a_case_on_the_skin_is_that_of_the_scan_alone() -> None:
    assert describe_strategies("ocs", {FIRST: "surface", LAST: "surface"}) == "surface"


def test_the_head_of_the_page_marks_methods_that_are_not_for_clinical_use(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path / "20261120T000000-s3-ef01")
    methods = CaseMethods(localizer=Localizer.THESIS_LINE, enhance_contrast=True)
    cell.journal.write(Entry.OPENED, 0.0, methods=methods.describe())
    of_thesis = localized_fiducials().model_copy(update={"localizer": Localizer.THESIS_LINE})
    cell.begin(imported_ct(), of_thesis).run_to()
    page = write_report(cell.folder).read_text()
    assert (
        '<p class="alarm">Localizer thesis-line, matcher ours, contrast enhanced: not for clinical use.</p>'
        in page
    )
    assert "thesis-line states no error: its share CT is the 0.169 mm published for it" in page


def test_the_budget_has_a_row_for_each_share_and_a_column_for_each_target(reported: Path) -> None:
    text = reported.read_text()
    (predicted,) = read_for_report(reported.parent).valid_results(RegisteredRobot)[0].result.predictions
    table = text.partition("What the prediction is made of")[2].partition("</table>")[0]
    assert table.count("<tr>") == 1 + len(predicted.budget) + 2
    assert f"Not included: {predicted.excluded}." in text
    assert [f"<th>{name}</th>" in table for name in TRAJECTORIES] == [True] * len(TRAJECTORIES)


def test_published_means_stand_apart_from_the_case_beside_campaigns_with_their_ct_error(
    reported: Path,
) -> None:
    picture = (reported.parent / "report" / "targets.svg").read_text()
    words = [unescape(word) for word in re.findall(r"<text [^>]*>([^<]*)</text>", picture)]
    case, phantoms = (
        words.index("This case, with its own CT, seating and arm"),
        words.index("Phantom studies, means"),
    )
    assert case < words.index(f"{FIRST}: predicted, rms") < phantoms
    published = [word for word in words if word.endswith(": published")]
    assert len(published) == len(PUBLISHED_MM)
    assert all(words.index(word) > phantoms for word in published)
    assert sum(word.endswith("simulated with its CT error") for word in words) == len(published)


def test_the_campaigns_means_in_the_report_are_those_that_were_stored() -> None:
    results = ROOT / "benchmarks" / "results" / "campaigns-2026-11-21"
    cells: dict[tuple[str, ...], list[str]] = {}
    for name in ("strategies.md", "application-error.md"):
        for line in (results / name).read_text(encoding="utf-8").splitlines():
            row = [cell.strip() for cell in line.strip("|").split("|")]
            if len(row) > 5:
                cells.setdefault(tuple(row[:4]), row)
    table_4 = ("thesis-ocs", "0.26"), ("jdms", "0.369"), ("nos", "1.327")
    stored = [
        *(float(cells["free", strategy, "5", thesis][4]) for strategy, thesis in table_4),
        *(float(cells[depth, "xframe", "thesis-ocs", "4"][5]) for depth in ("0-50 mm", "50-120 mm")),
    ]
    assert [campaign for _, _, campaign in PUBLISHED_MM] == pytest.approx(stored, abs=0.0006)


def test_the_touched_mark_and_what_it_told_stand_with_the_landmarks(tmp_path: Path) -> None:
    run = recorded_run(
        tmp_path / "run",
        (StepKey("ct_import"), IMPORTED),
        (StepKey("skin_in_ct"), skin_in_ct()),
        (StepKey("surface_start"), surface_start()),
        (StepKey("surface_scan"), scanned_surface()),
        linked=True,
    )
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", report_text(write_report(run, out=tmp_path / "out"))))
    for words in (
        "mark of T1",
        "Accepted: the landmarks together by 7.8 mm rms at most, the mark of an entry by 40 mm.",
        "Left and right were told by the mark of T1",
        "21% of the skin above the jaw lies within 10 mm of a point, placed by the landmarks",
    ):
        assert words in text


def test_first_looks_stand_where_no_landmark_was_touched(tmp_path: Path) -> None:
    run = recorded_run(
        tmp_path / "run",
        (StepKey("ct_import"), IMPORTED),
        (StepKey("skin_in_ct"), skin_in_ct()),
        (StepKey("surface_start"), surveyed_start()),
        linked=True,
    )
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", report_text(write_report(run, out=tmp_path / "out"))))
    for words in (
        "No landmark was touched: 9 first looks with 25 lines on 5 % of the skin found the head",
        "14 mm and 8.000 deg from where it was measured",
        "Accepted: the mark of an entry by 40 mm.",
        "Left and right were told by the mark of T1",
    ):
        assert words in text
    assert "left ear" not in text


def test_a_registration_on_the_skin_is_reported_with_its_regions_and_without_spheres(tmp_path: Path) -> None:
    run = recorded_run(
        tmp_path / "run",
        (StepKey("ct_import"), IMPORTED),
        (StepKey("skin_in_ct"), skin_in_ct()),
        (StepKey("surface_scan"), scanned_surface()),
        (StepKey("surface_registration"), registered_by_surface()),
        linked=True,
    )
    page = report_text(write_report(run, out=tmp_path / "out"))
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page))
    for words in (
        "Predicted only, registered on the skin:",
        "Registration on the skin",
        "left ear 1.500 it has probably moved",
    ):
        assert words in text
    picture = (tmp_path / "out" / "report" / "targets.svg").read_text()
    assert re.findall(r">([^<]*): published<", picture) == ["ROSA, registered on the skin"]
    assert "RONNA, OCS" not in text + picture
    for heading in ("Spheres in the CT", "Registration, verified both ways"):
        assert heading not in text


@pytest.mark.parametrize(
    ("options", "by", "compared"),
    [
        ({"scene": "mini", "ask": False}, "", "a script answered that they were compared, and nobody has"),
        ({"scene": "mini", "ask": True}, "", "the operator has compared them"),
        ({"scene": "mini", "ask": False}, "Dr. Ley", "the operator has compared them"),
        ({"config": "theatre.toml", "ask": False}, "", "the operator has compared them"),
    ],
    ids=["script", "asked", "signed", "terminal"],
)
def test_left_and_right_and_the_prediction_say_who_answered(
    tmp_path: Path, options: dict[str, object], by: str, compared: str
) -> None:
    answer = {"topic": f"registration:{FIRST}", "subject": SIDES_COMPARED, "answer": "yes", "by": by}
    run = recorded_run(
        tmp_path / "run",
        (StepKey("ct_import"), IMPORTED),
        (StepKey("skin_in_ct"), skin_in_ct()),
        (StepKey("surface_registration"), registered_by_surface()),
        opened={"theatre": "mini scene, seed 3", "banner": "SIMULATED THEATRE"},
        linked=True,
        confirmed=(answer, {**answer, "subject": "Accept the registration on the skin?"}),
    )
    (run / "request.json").write_text(json.dumps(options))
    text = report_text(write_report(run, out=tmp_path / "out"))
    assert f"Left and right cannot be told apart by the skin alone: {compared}" in text
    shown = "The prediction was shown to the operator before the registration was accepted."
    unseen = "A script accepted the registration: nobody was asked about the prediction."
    assert (unseen if "script" in compared else shown) in text
    assert (shown if "script" in compared else unseen) not in text


def test_a_registration_on_the_skin_and_screws_is_told_with_their_number(tmp_path: Path) -> None:
    run = recorded_run(
        tmp_path / "run",
        (StepKey("ct_import"), IMPORTED),
        (StepKey("skin_in_ct"), skin_in_ct()),
        (StepKey("surface_registration"), registered_by_surface().model_copy(update={"pairs": 3})),
        linked=True,
    )
    truth = Truth(
        targets=(TargetTruth(id=FIRST, application_error_mm=0.4321, lateral_mm=0.4, axial_mm=-0.1),)
    )
    path = write_report(run, truth=truth, out=tmp_path / "out")
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", report_text(path)))
    assert "largest, over 1 target, registered on the skin and 3 screws" in text
    assert "RONNA, OCS, 5 fiducials: published" in (tmp_path / "out" / "report" / "targets.svg").read_text()

"""Panels escape what they show and say what they should; the log's end is read safely."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from case_events import question
from skin_case import registered_by_surface, scanned_surface, skin_in_ct

from console.panels.case_state import advice, banner, chart, devices, devices_key, mode, seat_line
from console.panels.question import question_evidence, question_heading, question_pictures, question_words
from console.panels.results import (
    TAIL_BYTES,
    LogTail,
    accuracy,
    cuts,
    journal,
    log,
    notices,
    pictures,
    problems,
)
from console.panels.skin_scan import skin_scan
from console.scene.scanned_skin import shown_scan
from procedures.engine.case_view import CaseView, DeviceRow, Notice, StepRow
from procedures.engine.events import (
    DeviceFact,
    DeviceState,
    ExpectedError,
    LinkHealth,
    ScanProgress,
    Seat,
    Waiting,
)
from procedures.imaging.drawn_skin import DrawnSkin
from procedures.operator.question import Evidence, Identity, Picture, PredictedError
from procedures.reporting.case_figures import CaseFigures
from procedures.reporting.sections.surface import SurfaceSection
from ronna_hw.log_output import LOG_FILE

SCRIPT = "<script>alert(1)</script>"


def test_simulation_and_hardware_are_labelled_in_words() -> None:
    assert "SIMULATED THEATRE" in banner(CaseView(banner="SIMULATED THEATRE"))
    assert "HARDWARE" in banner(CaseView(banner=""))
    assert "HARDWARE" not in banner(CaseView())  # nothing is known yet
    assert "SIMULATED" not in banner(CaseView())


def test_the_step_list_shows_what_is_done_what_is_next_and_why_it_cannot_start() -> None:
    rows = (
        StepRow("image", "Import", "preoperative", False, "done", "3 slices"),
        StepRow("fit:T1", "Register", "operation", True),
    )
    view = CaseView(steps=rows, waiting=Waiting(upcoming="fit:T1", unmet=("image comes first",)))
    shown = chart(view)
    for words in ("done", "3 slices", "next", "moves", "fit:T1 cannot start", "image comes first"):
        assert words in shown


def test_while_nothing_is_asked_the_page_says_what_to_do() -> None:
    rows = (StepRow("image", "Import the CT", "preoperative", False),)
    waits = CaseView(steps=rows, waiting=Waiting(upcoming="image", unmet=()))
    held = replace(waits, seat=Seat(holder="Ana"))
    refused = replace(held, waiting=Waiting(upcoming="image", unmet=("the arm is in fault",)))
    assert "The theatre is opening" in advice(CaseView(), is_mine=False, may_operate=True)
    assert "Next then runs: Import the CT" in advice(waits, is_mine=False, may_operate=True)
    assert "No one is operating. You are watching" in advice(waits, is_mine=False, may_operate=False)
    assert "Ana operates. You are watching" in advice(held, is_mine=False, may_operate=True)
    assert "Press Next to run this step" in advice(held, is_mine=True, may_operate=True)
    assert "Put right what is listed" in advice(refused, is_mine=True, may_operate=True)
    runs = replace(waits, waiting=None, running="image")
    assert "Now: Import the CT" in advice(runs, is_mine=True, may_operate=True)
    assert "closed: done" in advice(replace(runs, outcome="done"), is_mine=False, may_operate=False)


def test_a_stale_reading_and_a_fault_are_shown_in_words() -> None:
    seen = DeviceState(device="arm", state="fault", fault="RSI-010: stopped")
    shown = devices(CaseView(devices={"arm": DeviceRow(seen, 7.25)}))
    for words in ("RSI-010: stopped", "7.2 s old", "fault"):
        assert words in shown


def test_ages_end_with_the_case() -> None:
    row = DeviceRow(DeviceState(device="arm", state="closed"), 0.1)
    link = LinkHealth(cycles=9, late=0, lost=0, rejected=0, turnaround_median_us=1.0, turnaround_p99_us=2.0)
    under_way = CaseView(theatre_time_s=5.0, devices={"arm": row}, link=link)
    closed = replace(under_way, outcome="done")
    for words in ("0.1 s", "5 s ago"):
        assert words in devices(under_way)
        assert words not in devices(closed)
    assert "Robot link at the end: 9 cycles" in devices(closed)
    assert devices_key(under_way) != devices_key(closed)


def test_facts_reported_by_a_controller_are_shown_and_those_that_forbid_motion_are_marked() -> None:
    says = (
        DeviceFact(name="operating mode", found="T1"),
        DeviceFact(name="guard", found="open", ready=False),
    )
    seen = DeviceState(device="arm", state="active", says=says, notices=("an old firmware",))
    view = CaseView(devices={"arm": DeviceRow(seen, 0.1, "partial")})
    shown = devices(view)
    for words in ("operating mode T1", "⚠ guard: open", "! an old firmware", "0.1 s partial"):
        assert words in shown
    assert "T1" in mode(view)


def test_a_changed_run_is_reported_with_what_to_do() -> None:
    assert problems(CaseFigures()) == ""
    shown = problems(CaseFigures(problems=("records/03.json is changed", "plan.toml is missing")))
    for words in ("CON-003", "records/03.json is changed and 1 more", "ronna-procedure verify"):
        assert words in shown


def test_external_text_is_escaped_in_every_panel() -> None:
    row = StepRow(SCRIPT, SCRIPT, SCRIPT, False, "done", SCRIPT)
    fact = DeviceFact(name="operating mode", found=SCRIPT)
    state = DeviceState(device=SCRIPT, state=SCRIPT, fault=SCRIPT, says=(fact,), notices=(SCRIPT,))
    view = CaseView(
        run=SCRIPT,
        banner=SCRIPT,
        state=SCRIPT,
        reason=SCRIPT,
        steps=(row,),
        seat=Seat(holder=SCRIPT),
        devices={SCRIPT: DeviceRow(state)},
        notices=(Notice("fault", 0.0, SCRIPT, SCRIPT, SCRIPT),),
        journal=({"entry": SCRIPT},),
    )
    line = seat_line(view, is_mine=False, may_operate=True)
    named = CaseFigures(cuts=(f"plan-{SCRIPT}.png",), pictures=(f"stereo-{SCRIPT}.png",))
    pictured = (pictures(named), cuts(view, named))
    lists = (notices(view), journal(view), log((SCRIPT,)))
    asked = question(
        topic="patient",
        subject=SCRIPT,
        value=f"{SCRIPT}\n{SCRIPT}",
        evidence=(Evidence(title=SCRIPT, head=(SCRIPT,), rows=((SCRIPT,),)),),
        pictures=(Picture(name=f"plan-{SCRIPT}.png", sha256=SCRIPT),),
        identity=Identity(rows=((SCRIPT, SCRIPT),)),
        identity_sha256="0",
        emphasis="<script",
    )
    pictured += (
        question_heading(asked),
        question_words(asked),
        question_pictures(asked),
        question_evidence(asked),
    )
    for shown in (banner(view), line, chart(view), devices(view), mode(view), *lists, *pictured):
        assert "<script" not in shown
        assert "&lt;script" in shown


@pytest.mark.parametrize(("trajectory", "caption"), [("T1", "T1 in the CT"), ("", "T1-2 in the CT")])
def test_the_cuts_of_a_repeated_check_are_named_after_their_trajectory(trajectory: str, caption: str) -> None:
    picture = Picture(name="plan-T1-2.png", sha256="0" * 64, trajectory=trajectory)
    assert f">{caption}<" in question_pictures(question(topic="registration:T1", pictures=(picture,)))


def test_the_accuracy_panel_shows_the_registration_that_is_being_asked_about() -> None:
    def predicted(target: str, rms_mm: float) -> PredictedError:
        return PredictedError(target=target, rms_mm=rms_mm, limit_mm=0.83, confidence=0.95, margin_mm=2.0)

    asked = question(topic="registration:T1", predicted=(predicted("T1", 0.46),))
    before = CaseFigures(predictions=(predicted("T1", 0.51), predicted("T2", 0.62)))
    assert accuracy(CaseView(), None) == '<p class="dim">No registration yet.</p>'
    for words in ("0.46 mm", "predicted error at T1", "2 mm", "the plan&#x27;s margin", "within the margin"):
        assert words in question_words(asked)
    shown = accuracy(CaseView(question=asked), before)
    for words in ("Not accepted yet: T1.", ">0.46<", ">2<", "0.83 at 95%", ">0.62<"):
        assert words in shown
    assert "0.51" not in shown  # what it would supersede
    assert "0.51" in accuracy(CaseView(), before)


def test_a_widened_limit_is_printed_large_and_the_verdict_says_why_it_is_widened() -> None:
    predicted = PredictedError(
        target="T1", rms_mm=0.46, limit_mm=1.84, confidence=0.95, margin_mm=2.0, widening=2.21
    )
    shown = question_words(question(topic="registration:T1", predicted=(predicted,)))
    assert '<dt>limit of 95% of such errors, widened</dt><dd class="num">1.84 mm</dd>' in shown
    why = "widened: the spheres disagree 2.21 times as much as the errors stated"
    assert f"✓ within the margin; 95% of such errors stay within 1.84 mm, {why}" in shown
    assert "1.84 at 95%, widened" in accuracy(CaseView(), CaseFigures(predictions=(predicted,)))


def line(level: str, event: str, **more: object) -> str:
    return json.dumps({"timestamp": "2026-11-21T10:21:05.1Z", "level": level, "event": event, **more}) + "\n"


def test_a_grown_log_is_read_again_and_an_incomplete_line_waits(tmp_path: Path) -> None:
    tail = LogTail(tmp_path)
    assert tail.lines() == ()
    with (tmp_path / LOG_FILE).open("a") as file:
        file.write(line("info", "step begins", step="ct_import") + line("error", "step failed")[:20])
    assert tail.lines() == ("10:21:05 info step begins: step ct_import",)
    with (tmp_path / LOG_FILE).open("a") as file:
        file.write(line("error", "step failed")[20:])
    assert tail.lines()[-1] == "10:21:05 error step failed"


def test_only_whole_lines_from_the_end_of_a_long_log_are_shown(tmp_path: Path) -> None:
    (tmp_path / LOG_FILE).write_text("".join(line("info", f"event {number:04}") for number in range(2000)))
    shown = LogTail(tmp_path).lines()
    assert shown[-1].endswith("event 1999")
    assert 0 < len(shown) * len(line("info", "event 0000")) <= TAIL_BYTES
    assert all(one.startswith("10:21:05 info event ") for one in shown)


@pytest.mark.timeout(20)
def test_a_pipe_or_a_link_in_place_of_the_log_is_not_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / LOG_FILE)
    assert LogTail(tmp_path).lines() == ()
    (tmp_path / LOG_FILE).rename(tmp_path / "pipe")
    (tmp_path / "another").write_text(line("info", "of another run"))
    (tmp_path / LOG_FILE).symlink_to("another")
    assert LogTail(tmp_path).lines() == ()


def test_a_line_that_is_not_json_is_omitted_and_other_text_is_escaped(tmp_path: Path) -> None:
    (tmp_path / LOG_FILE).write_text("torn\n[1]\n" + line("warning", "<script>"))
    shown = log(LogTail(tmp_path).lines())
    assert "&lt;script" in shown
    assert 'class="warn"' in shown
    assert "torn" not in shown


GROWING = ScanProgress(
    looks_done=3,
    looks_planned=18,
    covered_share=0.42,
    predicted_error_mm=0.61,
    expected=(
        ExpectedError(target="T1", rms_mm=(None, 1.2, 0.61)),
        ExpectedError(target="T<2>", rms_mm=(None, None, None)),
    ),
    covered_mm=((-9.0, -88.0, 0.0), (9.0, -88.0, 0.0)),
    missing_mm=((60.0, -60.0, 0.0),),
)


def test_a_growing_scan_shows_its_places_on_the_skin_and_the_error_at_each_target_as_it_falls() -> None:
    ball = np.random.default_rng(1).normal(size=(2000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    shown = skin_scan(GROWING, DrawnSkin(90.0 * ball, ball), {"T1": 1.5})
    for words in ("margin mm", '<td class="num">1.5</td>', '<td class="num">-</td>'):
        assert words in shown
    for words in ("3 of 18", "42%", "0.61", "T&lt;2&gt;", "too little scanned", "from 1.20 to 0.61"):
        assert words in shown
    for words in ("/picture/skin.png", "green: scanned", "pink: planned, not covered"):
        assert words in shown
    missing, covered = re.findall(r'<path d="([^"]+)" stroke="([^"]+)"', shown)
    assert missing[1] == "rgb(215,40,140)"
    assert missing[0].count("M") == 2  # from the front and the left
    assert covered[1] == "rgb(20,110,60)"
    assert covered[0].count("M") == 4  # the front has both, each side one
    assert 'points="0.111,0.000 0.111,0.000 0.167,0.492"' in shown


def test_a_scan_without_places_or_head_is_told_by_its_figures_and_none_is_not_shown() -> None:
    old = ScanProgress(looks_done=7, looks_planned=18, covered_share=0.42, predicted_error_mm=0.61)
    for words in ("7 of 18", "42%", "0.61"):
        assert words in skin_scan(old, None)
    assert "skin.png" not in skin_scan(old, None)
    assert skin_scan(None, None) == ""


def test_what_a_scan_has_covered_stays_after_it_from_its_record() -> None:
    whole = SurfaceSection(
        skin_in_ct(), None, scanned_surface().model_copy(update={"progress": GROWING}), None
    )
    assert shown_scan(CaseView(), None) is None
    assert shown_scan(CaseView(), CaseFigures(surface=whole)) == GROWING
    again = GROWING.model_copy(update={"looks_done": 0})
    assert shown_scan(CaseView(scan=again), CaseFigures(surface=whole)) == again
    assert "pink: planned, not covered" in whole.coverage_caption
    earlier = replace(whole, scan=scanned_surface())
    assert "pink" not in earlier.coverage_caption


def test_a_scan_of_the_skin_is_shown_by_what_the_registration_left_out() -> None:
    known = SurfaceSection(skin_in_ct(), None, scanned_surface(), registered_by_surface())
    asked = CaseFigures(
        surface=known,
        predictions=(PredictedError(target="T1", rms_mm=0.5, limit_mm=0.9, confidence=0.95, margin_mm=2.0),),
    )
    shown = accuracy(CaseView(), asked)
    for words in (
        "14 points",
        "21%",
        "Look 3 shows no line",
        "Has probably moved: left ear, by +1.50 mm",
    ):
        assert words in shown
    pictured = pictures(replace(asked, pictures=("stereo-T1-1.png", "surface-residuals.png")))
    assert "sphere 1" in pictured
    assert "distance to the skin in the CT" in pictured


def test_a_registration_that_the_clamp_has_carried_says_of_which_scan_its_figures_are() -> None:
    carried = registered_by_surface().model_copy(update={"carried": True, "confirming_looks": 4})
    surface = SurfaceSection(skin_in_ct(), None, scanned_surface(), carried)
    shown = accuracy(CaseView(), CaseFigures(surface=surface))
    assert "carried a former registration" in shown
    assert "confirmed by 4 looks" in shown
    plain = replace(surface, registration=registered_by_surface())
    assert "former" not in accuracy(CaseView(), CaseFigures(surface=plain))


def test_residuals_are_shown_whole_in_the_question_about_a_registration() -> None:
    residuals = Picture(name="surface-residuals.png", sha256="ab")
    shown = question_pictures(question(topic="registration:T1", pictures=(residuals,)))
    assert 'class="whole" src="/picture/surface-residuals.png?shown=ab"' in shown

"""A new case warns about a run on the same theatre that left the arm away from home."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from recording_cell import GUIDE, HOME, RecordingCell
from user_commands import in_this_process

from procedures.cli.doctor.theatre_checks import use_diagnostics
from procedures.cli.procedure import app
from procedures.engine.errors import InstrumentLeftInside
from procedures.engine.order import order_of
from procedures.journal.journal import JOURNAL_FILE, Entry, Journal
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Topic
from procedures.runs import arm_notes
from procedures.runs.arm_notes import NOT_KNOWN, TheatreNote, describe_arm_without_record, find_former_run
from procedures.runs.request import CaseProcedure, RunRequest
from procedures.runs.request_file import write_request
from procedures.runs.theatre_lock import hold_theatre
from procedures.steps.clinical import set_up
from procedures.workcell import InsertionAxis, MountedTool
from procedures.workcell.arm_history import ArmPlace, PlaceKind
from ronna_hw.errors import EXIT_DONE, EXIT_RECOVERY_NEEDED
from ronna_hw.evidence.journal_reading import read_chain
from ronna_hw.evidence.lost_journal_end import EVENTS_FILE
from ronna_hw.roles import ASSISTANT, MASTER

UNREADABLE = "run {} moved the arm last, and its journal cannot be read: an instrument may still be inside"


def earlier(runs: Path, number: int, *whats: str, resumable: bool = True, arm: str = MASTER) -> Path:
    """A run on the theatre that made these motions and was killed."""
    runs.mkdir(exist_ok=True)
    cell = RecordingCell(runs / f"2026010{number}T000000-abcd")
    theatre = runs / "theatre.toml"
    theatre.touch()
    if resumable:
        write_request(RunRequest(procedure=CaseProcedure(case=runs), config=theatre), cell.folder)
    cell.journal.write(Entry.OPENED, 0.0, run=cell.folder.name)
    with hold_theatre(theatre, cell.folder):
        for what in whats:
            cell.journal.write(Entry.MOTION, 0.0, arm=arm, what=what)
            cell.journal.write(Entry.MOVED, 0.0, arm=arm, joints_rad=list(HOME), at_home=what == "home")
    cell.journal.close()
    return cell.folder


@pytest.mark.hazard(61)
def test_an_assistant_that_is_away_is_warned_of_as_the_master_is(tmp_path: Path) -> None:
    run = earlier(tmp_path, 1, "settle", "home", arm=ASSISTANT)
    assert warning(tmp_path) is None
    run = earlier(tmp_path, 2, "settle", arm=ASSISTANT)
    told = warning(tmp_path)
    assert told is not None
    assert f"run {run.name} left the arm away from its home" in told


def warning(runs: Path) -> str | None:
    """What a new run on that theatre is warned of."""
    return warning_of(runs / "20260109T000000-abcd")


def warning_of(run: Path) -> str | None:
    """What a session of that run on the theatre is warned of."""
    run.mkdir(exist_ok=True)
    with hold_theatre(run.parent / "theatre.toml", run) as (last,):
        return find_former_run(last, run).not_home


def test_whoever_deleted_a_run_hears_where_its_arm_is_and_how_it_comes_home(tmp_path: Path) -> None:
    workcell = RecordingCell(tmp_path).workcell
    workcell.master.mount.check(MountedTool.STEREO_HEAD)
    held = InsertionAxis("T1", workcell.master.tool_pose(), travel_mm=60.0)
    told = describe_arm_without_record(ArmPlace(PlaceKind.ON_AXIS, held, moved=True), own=False)
    assert "on the axis of T1" in told
    assert "withdraw the guide along the axis" in told
    assert "pendant" in told
    with_instrument = ArmPlace(PlaceKind.ON_AXIS, held, instrument_may_be_inside="T1", moved=True)
    told = describe_arm_without_record(with_instrument, own=False)
    assert told.index("an instrument is still in T1") < told.index("take it out") < told.index("withdraw")
    assert "pendant" not in describe_arm_without_record(ArmPlace(PlaceKind.AWAY, moved=True), own=True)
    assert describe_arm_without_record(ArmPlace(PlaceKind.HOME), own=False) == "the arm is at home"


def test_the_warning_names_the_run_that_left_the_arm_away_also_after_one_that_moved_nothing(
    tmp_path: Path,
) -> None:
    (tmp_path / "theatre.toml").touch()
    assert warning(tmp_path) is None
    away = earlier(tmp_path, 1, "go")
    assert f"ronna-procedure home {away}" in str(warning(tmp_path))
    earlier(tmp_path, 2)
    for _ in range(2):
        assert away.name in str(warning(tmp_path))


@pytest.mark.hazard(5)
def test_a_run_whose_first_motion_was_refused_at_home_neither_warns_nor_hides_the_one_before(
    tmp_path: Path,
) -> None:
    def refused(number: int) -> None:
        run = earlier(tmp_path, number)
        journal = Journal.reopen_run(run, read_chain(run / JOURNAL_FILE))
        journal.write(Entry.MOTION, 0.0, number=1, what="go")
        journal.write(Entry.MOVED, 0.0, number=1, error="ARM-007", at_home=True)
        journal.close()

    refused(1)
    assert warning(tmp_path) is None
    away = earlier(tmp_path, 2, "go")
    refused(3)
    assert f"ronna-procedure home {away}" in str(warning(tmp_path))


def test_a_check_that_left_the_arm_away_is_named_with_the_pendant_as_the_way_home(tmp_path: Path) -> None:
    check = earlier(tmp_path, 1, "go", resumable=False)
    left = f"run {check.name} left the arm away from its home"
    assert warning(tmp_path) == f"{left}; jog it home with the controller's pendant"


def test_a_run_whose_journal_cannot_be_read_is_named_and_not_forgotten(tmp_path: Path) -> None:
    earlier(tmp_path, 1, "go", "home")
    damaged = earlier(tmp_path, 2, "go")
    lines = (damaged / JOURNAL_FILE).read_bytes().splitlines(keepends=True)
    (damaged / JOURNAL_FILE).write_bytes(b"".join(lines[1:]))
    for _ in range(2):
        assert warning(tmp_path) == UNREADABLE.format(damaged.name)


def test_a_run_in_a_place_hidden_from_this_user_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    away = earlier(tmp_path, 1, "go")

    def hidden(*_: object, **__: object) -> None:
        raise PermissionError

    monkeypatch.setattr(arm_notes, "read_chain", hidden)
    monkeypatch.setattr(arm_notes, "read_chain", hidden)
    monkeypatch.setattr(Path, "exists", hidden)
    assert warning(tmp_path) == UNREADABLE.format(away.name)


@pytest.mark.hazard(5)
@pytest.mark.parametrize("end", [{}, {"error": "RSI-005"}], ids=["killed", "failed"])
@pytest.mark.parametrize("before", [(), ("go", "home")], ids=["first motion", "a later one"])
def test_a_motion_from_home_that_was_cut_short_leaves_the_arm_away(
    tmp_path: Path, before: tuple[str, ...], end: dict[str, str]
) -> None:
    run = earlier(tmp_path, 1, *before)
    journal = Journal.reopen_run(run, read_chain(run / JOURNAL_FILE))
    with hold_theatre(tmp_path / "theatre.toml", run):
        journal.write(Entry.MOTION, 0.0, what="go")
        if end:
            journal.write(Entry.MOVED, 0.0, **end)
    journal.close()
    assert f"ronna-procedure home {run}" in str(warning(tmp_path))


@pytest.mark.hazard(5)
def test_a_run_is_warned_of_another_again_until_it_has_moved_the_arm_itself(tmp_path: Path) -> None:
    here, away = earlier(tmp_path, 1, "go"), earlier(tmp_path, 2, "go")
    for _ in range(2):  # the second time the note has this run as the last, which moved before that one
        assert f"ronna-procedure home {away}" in str(warning_of(here))
    assert warning_of(away) is None


@pytest.mark.hazard(5)
def test_a_run_that_lost_the_end_of_its_journal_may_have_left_the_arm_away(tmp_path: Path) -> None:
    torn = earlier(tmp_path, 1, "go", "home")
    with (torn / JOURNAL_FILE).open("ab") as journal:
        journal.write(bytes(100))
    lost = f"run {torn.name} has lost the end of its journal, and may have left the arm away"
    assert str(warning(tmp_path)).startswith(lost)


@pytest.mark.hazard(5)
def test_an_instrument_in_lines_that_only_the_event_file_still_has_is_not_forgotten(tmp_path: Path) -> None:
    run = earlier(tmp_path, 1, "go", "home")
    chain = read_chain(run / JOURNAL_FILE)
    inside = {"entry": Entry.INSTRUMENT, "arm": "master", "trajectory": "T1", "inside": True}
    lost = {**inside, "sequence": len(chain.lines), "previous": "0" * 64}
    events = ({"what": {"kind": "journal", "line": line}} for line in (*chain.lines, lost))
    (run / EVENTS_FILE).write_text("".join(f"{json.dumps(event)}\n" for event in events))
    note = TheatreNote(run=run, moved_before=run)
    assert "instrument" in str(find_former_run(note, None).inside)
    (run / EVENTS_FILE).unlink()
    assert find_former_run(note, None).inside is None


@pytest.mark.hazard(5)
@pytest.mark.parametrize("killed", [False, True])
def test_a_run_whose_folder_was_moved_is_not_forgotten(tmp_path: Path, killed: bool) -> None:
    away = earlier(tmp_path, 1, "go")
    if killed:
        (tmp_path / ".theatre.toml.in-use").write_text(TheatreNote(run=away, pid=1).model_dump_json())
    moved = away.rename(tmp_path / "elsewhere")
    gone = f"run {away.name} moved the arm last, and its folder {away} is gone; put it back"
    for _ in range(2):
        assert str(warning(tmp_path)).startswith(gone)
    done = in_this_process(app, "home", earlier(tmp_path, 2), "--json")
    assert done.returncode == EXIT_RECOVERY_NEEDED
    assert f"PRO-032: {gone}" in done.stderr
    assert warning_of(moved) is None


def test_a_run_that_brought_the_arm_home_may_be_removed(tmp_path: Path) -> None:
    home = earlier(tmp_path, 1, "go", "home")
    shutil.rmtree(home)
    for _ in range(2):
        assert warning(tmp_path) is None
    assert in_this_process(app, "home", earlier(tmp_path, 2), "--json").returncode == EXIT_DONE


@pytest.mark.hazard(5)
def test_a_killed_run_whose_folder_is_gone_may_have_moved_the_arm(tmp_path: Path) -> None:
    unmoved = earlier(tmp_path, 1)
    (tmp_path / ".theatre.toml.in-use").write_text(TheatreNote(run=unmoved, pid=1).model_dump_json())
    shutil.rmtree(unmoved)
    assert f"its folder {unmoved} is gone" in str(warning(tmp_path))


@pytest.mark.hazard(5)
def test_a_damaged_note_is_asked_about_until_a_run_moves_the_arm(tmp_path: Path) -> None:
    earlier(tmp_path, 1, "go")
    (tmp_path / ".theatre.toml.in-use").write_bytes(b'{"run": "/ru')
    for _ in range(2):
        assert warning(tmp_path) == NOT_KNOWN
    earlier(tmp_path, 2, "go", "home")
    assert warning(tmp_path) is None


@pytest.mark.hazard(5)
@pytest.mark.parametrize("ended", ["finished", "moved nothing"])
def test_home_of_another_run_names_the_run_that_left_the_arm_away(tmp_path: Path, ended: str) -> None:
    other = earlier(tmp_path, 1)
    if ended == "finished":
        journal = Journal.reopen_run(other, read_chain(other / JOURNAL_FILE))
        journal.write(Entry.CLOSED, 0.0, outcome="done")
        journal.close()
    away = earlier(tmp_path, 2, "go")
    done = in_this_process(app, "home", other, "--json")
    assert done.returncode == EXIT_RECOVERY_NEEDED
    assert done.stdout == ""
    assert f"PRO-032: run {away.name} left the arm away from its home" in done.stderr
    assert f"ronna-procedure home {away}" in done.stderr


@pytest.mark.hazard(5)
@pytest.mark.hazard(44)
@pytest.mark.parametrize(("goes_in", "says"), [(True, "is still in T1"), (False, "may still be in T1")])
def test_a_copy_of_the_theatre_file_keeps_the_warning_that_an_instrument_may_be_inside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, goes_in: bool, says: str
) -> None:
    monkeypatch.setattr(arm_notes, "ARMS_FOLDER", tmp_path / "arms")
    theatre = simulated_theatre(tmp_path / "theatre.toml", "a" * 32)
    cell = RecordingCell(tmp_path / "20260101T000000-abcd")
    write_request(RunRequest(procedure=CaseProcedure(case=tmp_path), config=theatre), cell.folder)
    cell.journal.write(Entry.OPENED, 0.0, run=cell.folder.name)
    cell.arm.mounted = GUIDE
    cell.workcell.master.mount.check(MountedTool.GUIDE)
    axis = InsertionAxis("T1", cell.workcell.master.tool_pose(), travel_mm=60.0).as_plain()
    with hold_theatre(theatre, cell.folder):
        cell.journal.write(Entry.MOTION, 0.0, what="insert", trajectory="T1", axis=axis)
        cell.journal.write(Entry.MOVED, 0.0, joints_rad=list(HOME), at_home=False)
        if goes_in:
            cell.journal.write(Entry.INSTRUMENT, 0.0, trajectory="T1", inside=True)
    cell.journal.close()  # killed: no line says how it ended
    copy = Path(shutil.copy(theatre, tmp_path / "copy.toml"))
    instrument, away = use_diagnostics(copy)
    assert says in instrument.seen
    assert "Touch neither the tool nor the arm" in instrument.advice
    assert f"ronna-procedure home {cell.folder}" in away.seen
    with pytest.raises(InstrumentLeftInside, match=says), hold_theatre(copy, tmp_path / "new"):
        pytest.fail("no other run begins")
    with hold_theatre(copy, cell.folder) as (last,):  # its own way out
        assert find_former_run(last, cell.folder).inside is None
    assert not list(use_diagnostics(simulated_theatre(tmp_path / "fresh.toml", "b" * 32)))


def simulated_theatre(path: Path, identity: str) -> Path:
    path.write_text(
        f'schema = 1\ntheatre = "default scene"\nbanner = "SIMULATED"\nidentity = "{identity}"\n'
        '[robot.master]\ndriver = "kuka_rsi"\n'
        'endpoints = { rsi = "udp://127.64.0.1:20000", eki_project = "tcp://127.0.0.1:54602" }\n'
    )
    return path


@pytest.mark.hazard(5)
def test_the_arm_position_becomes_home_only_after_confirmation(cell: RecordingCell) -> None:
    cell.operator.refusing = (Topic.RESUME,)
    engine = cell.engine(order_of([set_up.STEP], ()))
    engine.setting = replace(engine.setting, arm_not_home="run A left the arm away from its home")
    with pytest.raises(NotConfirmed, match="run A left the arm away"):
        engine.run_to()
    assert not cell.workcell.master.place.is_home


def test_the_doctor_says_what_a_new_case_would_be_warned_of(tmp_path: Path) -> None:
    away = earlier(tmp_path, 1, "go")
    (found,) = use_diagnostics(tmp_path / "theatre.toml")
    assert not found.well
    assert f"ronna-procedure home {away}" in found.seen


def test_the_doctor_says_that_a_later_run_could_not_be_warned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "procedures.runs.theatre_lock.os.access", lambda path, how: False
    )  # root may write anywhere
    (found,) = use_diagnostics(tmp_path / "theatre.toml")
    assert not found.well
    assert str(tmp_path / ".theatre.toml.in-use") in found.seen

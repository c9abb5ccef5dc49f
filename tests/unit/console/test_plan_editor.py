"""The planner's editor: opens a plan, saves it, and loses nothing when saving is refused."""

from __future__ import annotations

import asyncio
import errno
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from coded_errors import raises
from plan_editors import ENTRY, code_of, draw, reopened, save, scan

from console.planning import plan_editor
from console.planning.draft import Draft
from console.planning.judging import ExpectedAtTarget, Judgement, expected, judge, verdict
from console.planning.plan_editor import PlanEditor
from procedures.imaging.errors import PickRefused
from procedures.planning.errors import PLAN_NOT_SAVED, PlanInUse, PlanMistakes
from procedures.planning.plan_file import read_plan, seal_plan, write_plan
from procedures.planning.plan_lock import lock_plan
from ronna_hw.errors import RonnaError


def test_a_saved_plan_is_reopened_unchanged(editor: PlanEditor, file: Path) -> None:
    draw(editor)
    assert not editor.is_saved
    save(editor)
    assert editor.is_saved
    again = reopened(editor)
    assert again.draft.ways == editor.draft.ways
    assert again.is_saved
    seal = read_plan(file).seal
    assert seal is not None
    assert seal.author == "Dr Test"


@pytest.mark.parametrize(
    ("author", "said"),
    [("", "needs an author"), ("   ", "needs an author"), ("A" * 300, "limit 60 char"), ("007", "letters")],
)
def test_a_plan_without_the_name_of_an_author_is_not_saved(
    editor: PlanEditor, file: Path, author: str, said: str
) -> None:
    draw(editor)
    with pytest.raises(PlanMistakes, match=f"PLAN-002.*{said}"):
        save(editor, author)
    assert not file.exists()


def test_a_trajectory_without_its_target_is_not_saved(editor: PlanEditor, file: Path) -> None:
    draw(editor)
    draft, name = editor.draft.with_new_way()
    editor.change(draft.with_way(name, replace(draft.way(name), entry_mm=ENTRY)))
    with pytest.raises(PlanMistakes, match=r"PLAN-002.*T2"):
        save(editor)
    assert not file.exists()
    assert editor.draft.way("T2").entry_mm == ENTRY


def test_a_plan_of_another_ct_is_reported_and_never_overwritten(saved: PlanEditor, file: Path) -> None:
    before = file.read_bytes()
    saved.close()
    other = PlanEditor(scan("1.2.3.4"), file, None)
    assert code_of(other.read_only) == "PLAN-003"
    draw(other)
    with pytest.raises(RonnaError, match="PLAN-003"):
        save(other)
    assert file.read_bytes() == before


def test_a_file_that_is_not_a_plan_is_reported_and_left_unchanged(file: Path) -> None:
    file.write_text("not = [toml")
    editor = PlanEditor(scan(), file, None)
    assert code_of(editor.read_only) == "PLAN-001"
    assert file.read_text() == "not = [toml"


def test_an_altered_plan_opens_with_a_warning_and_is_resealed_on_saving(
    saved: PlanEditor, file: Path
) -> None:
    file.write_text(file.read_text().replace("30.0", "29.0", 1))
    altered = reopened(saved)
    assert code_of(altered.notice) == "PLAN-023"
    assert altered.draft.standoff_mm == 29.0
    save(altered)
    assert altered.notice is None
    assert read_plan(file).standoff_mm == 29.0


def test_a_plan_changed_meanwhile_by_another_program_is_not_overwritten(
    saved: PlanEditor, file: Path
) -> None:
    file.write_text("theirs")
    draw(saved, standoff_mm=31.0)
    with raises(PLAN_NOT_SAVED, match=r"PLAN-025.*another program"):
        save(saved)
    assert file.read_text() == "theirs"
    assert saved.draft.standoff_mm == 31.0


def test_a_plan_that_has_become_unreadable_is_not_overwritten(saved: PlanEditor, file: Path) -> None:
    file.unlink()
    file.mkdir()
    with raises(PLAN_NOT_SAVED, match=r"PLAN-025: cannot read .*is a directory"):
        save(saved)


def test_a_plan_is_read_only_while_a_case_runs_on_it(saved: PlanEditor, file: Path) -> None:
    before, draft = file.read_bytes(), saved.draft
    with lock_plan(file):
        draw(saved, standoff_mm=31.0)
        saved.undo()
        assert saved.draft is draft
        with pytest.raises(PlanInUse, match="PLAN-026"):
            save(saved)
    assert file.read_bytes() == before
    draw(saved, standoff_mm=31.0)
    save(saved)
    assert read_plan(file).standoff_mm == 31.0


def test_a_case_that_starts_while_its_plan_is_being_saved_prevents_the_save(
    saved: PlanEditor, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = file.read_bytes()
    draw(saved, standoff_mm=31.0)
    with ExitStack() as case:

        def meanwhile(*arguments: object) -> object:
            case.enter_context(lock_plan(file))
            return seal_plan(*arguments)  # type: ignore[arg-type]

        monkeypatch.setattr(plan_editor, "seal_plan", meanwhile)
        with pytest.raises(PlanInUse, match="PLAN-026"):
            save(saved)
        assert file.read_bytes() == before
    monkeypatch.undo()
    save(saved)
    assert read_plan(file).standoff_mm == 31.0


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """Nothing can be written until it is undone."""

    def full(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    return monkeypatch


def test_a_full_disk_loses_neither_the_draft_nor_the_plan(file: Path, full_disk: pytest.MonkeyPatch) -> None:
    editor = PlanEditor(scan(), file, None)
    draw(editor)
    assert editor.store_draft() is None
    assert code_of(editor.storage_problem) == "PLAN-025"
    with raises(PLAN_NOT_SAVED, match=r"PLAN-025.*No space left.*stays on this page"):
        save(editor)
    assert not file.exists()
    assert not editor.is_saved
    full_disk.undo()
    assert editor.store_draft() is not None
    assert editor.storage_problem is None
    save(editor)
    assert read_plan(file).trajectory("T1").entry_mm == ENTRY


def test_a_plan_where_files_cannot_be_locked_is_not_saved_and_says_so(
    saved: PlanEditor, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = file.read_bytes()
    draw(saved, standoff_mm=31.0)

    def unsupported(_file: int, _kind: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", unsupported)
    with raises(PLAN_NOT_SAVED, match=r"PLAN-025: plan\.toml cannot be locked: No locks available"):
        save(saved)
    assert file.read_bytes() == before


def test_the_planner_does_not_take_its_own_save_for_a_running_case(
    saved: PlanEditor, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw(saved, standoff_mm=31.0)
    seen = []

    def meanwhile(*arguments: Any) -> None:
        seen.append(saved.read_only)
        write_plan(*arguments)

    monkeypatch.setattr(plan_editor, "write_plan", meanwhile)
    save(saved)
    assert seen == [None]


def test_a_pick_without_a_sphere_is_refused_and_adds_no_marker(editor: PlanEditor) -> None:
    with pytest.raises(PickRefused, match="CT-019"):
        asyncio.run(editor.add_marker((0.0, 0.0, 0.0)))
    assert editor.draft.markers == ()


def test_a_ct_without_spheres_is_reported_while_the_head_is_still_shown(editor: PlanEditor) -> None:
    async def searched() -> None:
        work = asyncio.create_task(editor.work())
        heard = editor.subscribe()
        while editor.searching:
            await heard.wait()
            heard.clear()
        work.cancel()

    asyncio.run(searched())
    assert code_of(editor.notice) == "CT-016"
    assert editor.head


def test_a_change_is_judged_while_the_thorough_check_before_it_still_runs_and_its_late_result_is_dropped(
    editor: PlanEditor, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, released = threading.Event(), threading.Event()
    checked = []

    def slow(draft: Draft, *_: object, thorough: bool, **_skin: object) -> Judgement:
        if thorough:
            begun.set()
            checked.append(draft)
            released.wait(30.0)
        return Judgement(draft, thorough=thorough, is_arm_known=True, complete=True)

    monkeypatch.setattr(plan_editor, "judge", slow)
    shown = []

    async def dragged() -> None:
        work = asyncio.create_task(editor.work())
        heard = editor.subscribe()

        async def until(done: Callable[[], bool]) -> None:
            while not done():
                await heard.wait()
                heard.clear()
                shown.append(editor.judged)

        await until(lambda: not editor.searching)
        draw(editor)
        await asyncio.to_thread(begun.wait, 30.0)
        draw(editor, standoff_mm=31.0)
        await asyncio.wait_for(until(lambda: editor.judged.draft is editor.draft), 10.0)
        assert not editor.judged.thorough
        released.set()
        await asyncio.wait_for(until(lambda: editor.judged.thorough), 10.0)
        work.cancel()

    try:
        asyncio.run(dragged())
    finally:
        released.set()
    assert [one.draft for one in shown if one.thorough] == [editor.draft]
    assert len(checked) >= 2


def test_what_was_found_for_an_earlier_draft_is_not_told_as_that_of_the_current_one(
    editor: PlanEditor,
) -> None:
    draw(editor)
    earlier = editor.draft
    found = Judgement(
        earlier,
        thorough=True,
        expected={"T1": ExpectedAtTarget(1.5, 3.0, (), with_arm=True)},
        angles_deg={"T1": 79.0},
        complete=True,
    )
    assert "would be accepted" in verdict(found, earlier)
    assert "Before the last change" not in verdict(found, earlier) + expected(found, earlier)
    editor.change(earlier.with_way("T1", replace(earlier.way("T1"), margin_mm=1.0)))
    now = verdict(found, editor.draft)
    assert "would be accepted" not in now
    assert "Checking…" in now
    for shown in (now, expected(found, editor.draft)):
        assert "Before the last change" in shown
        assert 'class="stale"' in shown
    assert "rms within, limit beyond" in expected(found, editor.draft)  # of the margin at that time


@pytest.mark.parametrize(
    ("target_mm", "code"),
    [((5.0, -20.0, 520.0), "PLAN-004"), ((5.0, -20.0, -105.0), "PLAN-004"), ((5.0, -90.0, 95.0), "PLAN-011")],
)
def test_mistakes_of_a_drawn_trajectory_are_reported_with_their_codes(
    editor: PlanEditor, target_mm: tuple[float, float, float], code: str
) -> None:
    draw(editor)
    draft: Draft = editor.draft.with_way("T1", replace(editor.draft.way("T1"), target_mm=target_mm))
    judged = judge(draft, scan(), None, thorough=True)
    assert code in [one.code for one in judged.findings]


def test_a_target_outside_the_scan_is_reported(editor: PlanEditor) -> None:
    draw(editor)
    draft = editor.draft.with_way("T1", replace(editor.draft.way("T1"), target_mm=(105.0, -50.0, 60.0)))
    assert "PLAN-006" in [one.code for one in judge(draft, scan(), None, thorough=True).findings]


def test_a_missing_instrument_length_is_reported_and_everything_else_still_judged(editor: PlanEditor) -> None:
    draw(editor)
    judged = judge(replace(editor.draft, instrument_length_mm=None), scan(), None, thorough=True)
    assert "instrument length" in judged.findings[0].what
    assert [one.code for one in judged.findings] == ["PLAN-002", "PLAN-008"]

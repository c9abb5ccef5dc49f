"""A plan shared by planners, cases and runs: one at a time changes it, and unsaved work is not lost."""

from __future__ import annotations

import asyncio
import errno
import os
from dataclasses import replace
from pathlib import Path

import pytest
from plan_editors import ENTRY, code_of, draw, save, scan

from console.planning import plan_editor
from console.planning.plan_editor import PlanEditor
from procedures.planning.errors import PlanInUse
from procedures.planning.plan_lock import lock_plan


def test_unsaved_changes_are_restored_and_undo_returns_to_the_saved_plan(
    saved: PlanEditor, file: Path
) -> None:
    assert saved.store_draft() is None
    draw(saved, standoff_mm=31.0)
    half, name = saved.draft.with_new_way()
    saved.change(half.with_way(name, replace(half.way(name), entry_mm=ENTRY)))
    kept = saved.close()
    assert kept is not None

    again = PlanEditor(scan(), file, None)
    assert code_of(again.notice) == "PLAN-029"
    assert again.draft == saved.draft
    assert not again.is_saved
    again.undo()
    assert again.draft.standoff_mm == 30.0
    assert again.store_draft() is None
    assert not kept.exists()


def test_an_undo_back_to_the_beginning_after_a_save_is_not_lost(saved: PlanEditor, file: Path) -> None:
    saved.close()
    second = PlanEditor(scan(), file, None)
    draw(second, standoff_mm=31.0)
    save(second)
    second.undo()
    assert second.close() is not None
    third = PlanEditor(scan(), file, None)
    assert code_of(third.notice) == "PLAN-029"
    assert third.draft.standoff_mm == 30.0


def test_a_second_planner_is_read_only_until_the_first_closes_and_then_continues_its_draft(
    saved: PlanEditor, file: Path
) -> None:
    draw(saved, standoff_mm=31.0)
    other = PlanEditor(scan(), file, None)
    assert other.draft.standoff_mm == 30.0
    assert f"another planner (process {os.getpid()} on " in str(other.read_only)
    draw(other, standoff_mm=35.0)
    assert other.draft.standoff_mm == 30.0
    save(saved)
    draw(saved, standoff_mm=32.0)
    assert other.store_draft() is None
    assert not other.begin_editing()
    kept = saved.close()
    assert kept is not None
    assert other.begin_editing()
    assert other.draft == saved.draft
    other.undo()
    assert other.draft.standoff_mm == 31.0
    other.close()
    assert other.read_only is not None  # by a page that is still open
    assert [one.name for one in file.parent.iterdir()] == [file.name]


def test_a_read_only_planner_is_notified_when_the_plan_becomes_free(
    editor: PlanEditor, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan_editor, "AGAIN_S", 0.01)
    other = PlanEditor(scan(), file, None)

    async def becomes_free() -> None:
        work = asyncio.create_task(other.work())
        heard = other.subscribe()
        while other.searching:
            await heard.wait()
            heard.clear()
        assert other.read_only is not None
        editor.close()
        while other.read_only is not None:
            await heard.wait()
            heard.clear()
        work.cancel()

    asyncio.run(asyncio.wait_for(becomes_free(), 60.0))


def test_a_plan_inside_a_run_opens_read_only_and_nothing_is_written_next_to_it(
    saved: PlanEditor, tmp_path: Path
) -> None:
    case = tmp_path / "run" / "case"
    case.mkdir(parents=True)
    (tmp_path / "run" / "journal.jsonl").touch()
    kept = saved.file.rename(case / "plan.toml")
    looked = PlanEditor(scan(), kept, None)
    assert looked.draft.ways == saved.draft.ways
    assert "run run, which must not change" in str(looked.read_only)
    draw(looked, standoff_mm=31.0)
    assert looked.close() is None
    assert looked.is_saved
    with pytest.raises(PlanInUse, match=r"PLAN-026.*copy opened"):
        save(looked)
    assert [one.name for one in case.iterdir()] == ["plan.toml"]


def test_unsaved_changes_to_a_plan_changed_meanwhile_are_set_aside_and_reported(
    editor: PlanEditor, file: Path
) -> None:
    draw(editor)
    kept = editor.close()
    assert kept is not None
    content = kept.read_bytes()
    other = PlanEditor(scan(), file.with_name("other.toml"), None)
    draw(other, standoff_mm=35.0)
    save(other)
    file.write_bytes(other.file.read_bytes())
    again = PlanEditor(scan(), file, None)
    assert again.draft.standoff_mm == 35.0
    assert again.notice is not None
    assert "plan.toml.unsaved-1" in str(again.notice)
    assert kept.with_name("plan.toml.unsaved-1").read_bytes() == content


def test_unsaved_changes_blocked_by_a_running_case_are_restored_when_it_has_ended(
    saved: PlanEditor, file: Path
) -> None:
    draw(saved, standoff_mm=31.0)
    saved.close()
    with lock_plan(file):
        again = PlanEditor(scan(), file, None)
        assert again.draft.standoff_mm == 30.0
        assert again.store_draft() is None
        assert not again.begin_editing()
    draw(again, standoff_mm=32.0)  # at once, before that is taken up
    assert again.begin_editing()
    assert again.draft.standoff_mm == 31.0
    assert code_of(again.notice) == "PLAN-029"


@pytest.mark.parametrize("content", [b"", b"{}", b"[1, 2", b'{"ways": 7}'])
def test_damaged_unsaved_changes_are_set_aside(file: Path, content: bytes) -> None:
    file.with_name("plan.toml.unsaved").write_bytes(content)
    editor = PlanEditor(scan(), file, None)
    assert code_of(editor.notice) == "PLAN-029"
    assert file.with_name("plan.toml.unsaved-1").read_bytes() == content


def test_a_pipe_in_place_of_a_plan_is_named_without_blocking_and_left_alone(file: Path) -> None:
    os.mkfifo(file)
    editor = PlanEditor(scan(), file, None)
    assert "not a regular file" in str(editor.problem)
    assert file.is_fifo()


def test_a_plan_that_cannot_be_read_once_it_is_free_is_reported(
    saved: PlanEditor, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = PlanEditor(scan(), file, None)
    saved.close()

    def unreadable(_path: Path) -> str:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(plan_editor, "_digest", unreadable)
    assert other.begin_editing()
    assert "Input/output error" in str(other.read_only)


def test_a_planner_that_cannot_delete_its_unsaved_changes_still_releases_the_plan(
    editor: PlanEditor, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forbidden(_path: Path) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    with monkeypatch.context() as patched:
        patched.setattr(Path, "unlink", forbidden)
        editor.close()
    assert PlanEditor(scan(), file, None).read_only is None

"""The planner's desk: opens a plan, saves it, and loses nothing when saving is refused."""

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
from plan_desks import ENTRY, draw, reopened, save, scan

from console.planning import desk as desk_module
from console.planning.desk import PlanDesk
from console.planning.draft import Draft
from console.planning.judging import Expected, Judged, judge
from console.planning.verdict import expected, verdict
from procedures.imaging.errors import PickRefused
from procedures.planning.errors import PlanInUse, PlanMistakes, PlanNotSaved
from procedures.planning.plan_file import read_plan, seal_plan, write_plan
from procedures.planning.plan_lock import lock_plan
from ronna_hw.errors import RonnaError


def test_a_saved_plan_is_reopened_unchanged(desk: PlanDesk, file: Path) -> None:
    draw(desk)
    assert not desk.is_saved
    save(desk)
    assert desk.is_saved
    again = reopened(desk)
    assert again.draft.ways == desk.draft.ways
    assert again.is_saved
    seal = read_plan(file).seal
    assert seal is not None
    assert seal.author == "Dr Test"


@pytest.mark.parametrize("author", ["", "   "])
def test_a_plan_without_an_author_is_not_saved(desk: PlanDesk, file: Path, author: str) -> None:
    draw(desk)
    with pytest.raises(PlanMistakes, match=r"PLAN-002: the plan needs an author"):
        save(desk, author)
    assert not file.exists()


def test_a_trajectory_without_its_target_is_not_saved(desk: PlanDesk, file: Path) -> None:
    draw(desk)
    draft, name = desk.draft.with_new_way()
    desk.change(draft.with_way(name, replace(draft.way(name), entry_mm=ENTRY)))
    with pytest.raises(PlanMistakes, match=r"PLAN-002.*T2"):
        save(desk)
    assert not file.exists()
    assert desk.draft.way("T2").entry_mm == ENTRY


def test_a_plan_of_another_ct_is_reported_and_never_overwritten(desk: PlanDesk, file: Path) -> None:
    draw(desk)
    save(desk)
    before = file.read_bytes()
    desk.close()
    other = PlanDesk(scan("1.2.3.4"), file, None)
    assert other.read_only is not None
    assert other.read_only.code == "PLAN-003"
    draw(other)
    with pytest.raises(RonnaError, match="PLAN-003"):
        save(other)
    assert file.read_bytes() == before


def test_a_file_that_is_not_a_plan_is_reported_and_left_unchanged(file: Path) -> None:
    file.write_text("not = [toml")
    desk = PlanDesk(scan(), file, None)
    assert desk.read_only is not None
    assert desk.read_only.code == "PLAN-001"
    assert file.read_text() == "not = [toml"


def test_an_altered_plan_opens_with_a_warning_and_is_resealed_on_saving(desk: PlanDesk, file: Path) -> None:
    draw(desk)
    save(desk)
    file.write_text(file.read_text().replace("30.0", "29.0", 1))
    altered = reopened(desk)
    assert altered.notice is not None
    assert altered.notice.code == "PLAN-023"
    assert altered.draft.standoff_mm == 29.0
    save(altered)
    assert altered.notice is None
    assert read_plan(file).standoff_mm == 29.0


def test_a_plan_changed_meanwhile_by_another_program_is_not_overwritten(desk: PlanDesk, file: Path) -> None:
    draw(desk)
    save(desk)
    file.write_text("theirs")
    draw(desk, standoff_mm=31.0)
    with pytest.raises(PlanNotSaved, match=r"PLAN-025.*another program"):
        save(desk)
    assert file.read_text() == "theirs"
    assert desk.draft.standoff_mm == 31.0


def test_a_plan_that_has_become_unreadable_is_not_overwritten(desk: PlanDesk, file: Path) -> None:
    draw(desk)
    save(desk)
    file.unlink()
    file.mkdir()
    with pytest.raises(PlanNotSaved, match=r"PLAN-025: cannot read .*is a directory"):
        save(desk)


def test_a_plan_is_read_only_while_a_case_runs_on_it(desk: PlanDesk, file: Path) -> None:
    draw(desk)
    save(desk)
    before, draft = file.read_bytes(), desk.draft
    with lock_plan(file):
        draw(desk, standoff_mm=31.0)
        desk.undo()
        assert desk.draft is draft
        with pytest.raises(PlanInUse, match="PLAN-026"):
            save(desk)
    assert file.read_bytes() == before
    draw(desk, standoff_mm=31.0)
    save(desk)
    assert read_plan(file).standoff_mm == 31.0


def test_a_case_that_starts_while_its_plan_is_being_saved_prevents_the_save(
    desk: PlanDesk, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw(desk)
    save(desk)
    before = file.read_bytes()
    draw(desk, standoff_mm=31.0)
    with ExitStack() as case:

        def meanwhile(*arguments: object) -> object:
            case.enter_context(lock_plan(file))
            return seal_plan(*arguments)  # type: ignore[arg-type]

        monkeypatch.setattr(desk_module, "seal_plan", meanwhile)
        with pytest.raises(PlanInUse, match="PLAN-026"):
            save(desk)
        assert file.read_bytes() == before
    monkeypatch.undo()
    save(desk)
    assert read_plan(file).standoff_mm == 31.0


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """Nothing can be written until it is undone."""

    def full(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    return monkeypatch


def test_a_full_disk_loses_neither_the_draft_nor_the_plan(file: Path, full_disk: pytest.MonkeyPatch) -> None:
    desk = PlanDesk(scan(), file, None)
    draw(desk)
    assert desk.keep() is None
    assert desk.not_kept is not None
    assert desk.not_kept.code == "PLAN-025"
    with pytest.raises(PlanNotSaved, match=r"PLAN-025.*No space left.*stays on this page"):
        save(desk)
    assert not file.exists()
    assert not desk.is_saved
    full_disk.undo()
    assert desk.keep() is not None
    assert desk.not_kept is None
    save(desk)
    assert read_plan(file).trajectory("T1").entry_mm == ENTRY


def test_a_plan_where_files_cannot_be_locked_is_not_saved_and_says_so(
    desk: PlanDesk, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw(desk)
    save(desk)
    before = file.read_bytes()
    draw(desk, standoff_mm=31.0)

    def unsupported(_file: int, _kind: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", unsupported)
    with pytest.raises(PlanNotSaved, match=r"PLAN-025: plan\.toml cannot be locked: No locks available"):
        save(desk)
    assert file.read_bytes() == before


def test_the_planner_does_not_take_its_own_save_for_a_running_case(
    desk: PlanDesk, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw(desk)
    save(desk)
    draw(desk, standoff_mm=31.0)
    seen = []

    def meanwhile(*arguments: Any) -> None:
        seen.append(desk.read_only)
        write_plan(*arguments)

    monkeypatch.setattr(desk_module, "write_plan", meanwhile)
    save(desk)
    assert seen == [None]


def test_a_pick_without_a_sphere_is_refused_and_adds_no_marker(desk: PlanDesk) -> None:
    with pytest.raises(PickRefused, match="CT-019"):
        asyncio.run(desk.add_marker((0.0, 0.0, 0.0)))
    assert desk.draft.markers == ()


def test_a_ct_without_spheres_is_reported_while_the_head_is_still_shown(desk: PlanDesk) -> None:
    async def searched() -> None:
        work = asyncio.create_task(desk.work())
        heard = desk.subscribe()
        while desk.searching:
            await heard.wait()
            heard.clear()
        work.cancel()

    asyncio.run(searched())
    assert desk.notice is not None
    assert desk.notice.code == "CT-016"
    assert desk.head


def test_a_change_is_judged_while_the_thorough_check_before_it_still_runs_and_its_late_result_is_dropped(
    desk: PlanDesk, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, released = threading.Event(), threading.Event()
    checked = []

    def slow(draft: Draft, *_: object, thorough: bool) -> Judged:
        if thorough:
            begun.set()
            checked.append(draft)
            released.wait(30.0)
        return Judged(draft, thorough=thorough, arm_known=True, complete=True)

    monkeypatch.setattr(desk_module, "judge", slow)
    shown = []

    async def dragged() -> None:
        work = asyncio.create_task(desk.work())
        heard = desk.subscribe()

        async def until(done: Callable[[], bool]) -> None:
            while not done():
                await heard.wait()
                heard.clear()
                shown.append(desk.judged)

        await until(lambda: not desk.searching)
        draw(desk)
        await asyncio.to_thread(begun.wait, 30.0)
        draw(desk, standoff_mm=31.0)
        await asyncio.wait_for(until(lambda: desk.judged.draft is desk.draft), 10.0)
        assert not desk.judged.thorough
        released.set()
        await asyncio.wait_for(until(lambda: desk.judged.thorough), 10.0)
        work.cancel()

    try:
        asyncio.run(dragged())
    finally:
        released.set()
    assert [one.draft for one in shown if one.thorough] == [desk.draft]
    assert len(checked) >= 2


def test_what_was_found_for_an_earlier_draft_is_not_told_as_that_of_the_current_one(desk: PlanDesk) -> None:
    draw(desk)
    earlier = desk.draft
    found = Judged(
        earlier,
        thorough=True,
        expected={"T1": Expected(1.5, 3.0, (), with_arm=False)},
        reached=("every motion is clear",),
        complete=True,
    )
    assert "would be accepted" in verdict(found, earlier)
    assert "Before the last change" not in verdict(found, earlier) + expected(found, earlier)
    desk.change(earlier.with_way("T1", replace(earlier.way("T1"), margin_mm=1.0)))
    now = verdict(found, desk.draft)
    assert "would be accepted" not in now
    assert "Checking…" in now
    for shown in (now, expected(found, desk.draft)):
        assert "Before the last change" in shown
        assert 'class="stale"' in shown
    assert "exceeds the margin" not in expected(found, desk.draft)  # of the margin at that time


@pytest.mark.parametrize(
    ("target_mm", "code"),
    [((5.0, -20.0, 520.0), "PLAN-004"), ((5.0, -20.0, -105.0), "PLAN-004"), ((5.0, -90.0, 95.0), "PLAN-011")],
)
def test_mistakes_of_a_drawn_trajectory_are_reported_with_their_codes(
    desk: PlanDesk, target_mm: tuple[float, float, float], code: str
) -> None:
    draw(desk)
    draft: Draft = desk.draft.with_way("T1", replace(desk.draft.way("T1"), target_mm=target_mm))
    judged = judge(draft, scan(), None, thorough=True)
    assert code in [one.code for one in judged.findings]


def test_a_target_outside_the_scan_is_reported(desk: PlanDesk) -> None:
    draw(desk)
    draft = desk.draft.with_way("T1", replace(desk.draft.way("T1"), target_mm=(105.0, -50.0, 60.0)))
    assert "PLAN-006" in [one.code for one in judge(draft, scan(), None, thorough=True).findings]


def test_a_missing_instrument_length_is_reported_and_everything_else_still_judged(desk: PlanDesk) -> None:
    draw(desk)
    judged = judge(replace(desk.draft, instrument_length_mm=None), scan(), None, thorough=True)
    assert "instrument length" in judged.findings[0].what
    assert [one.code for one in judged.findings] == ["PLAN-002", "PLAN-008"]

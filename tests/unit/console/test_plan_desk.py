"""The desk of the planner: opened on a file, saved, and refused with nothing lost."""

from __future__ import annotations

import asyncio
import errno
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from console.planning import desk as desk_module
from console.planning.desk import PlanDesk
from console.planning.draft import Draft
from console.planning.judging import judge
from procedures.imaging.errors import PickRefused
from procedures.imaging.volume import Volume, VoxelGeometry
from procedures.planning.errors import PlanInUse, PlanMistakes, PlanNotSaved
from procedures.planning.plan.file import read_plan, write_plan
from procedures.planning.plan.lock import held_plan
from procedures.planning.plan.seal import sealed
from ronna_hw.errors import RonnaError

SERIES = "1.2.826.0.1.3680043.8.498.7"
ENTRY, TARGET = (10.0, -50.0, 60.0), (5.0, -20.0, 20.0)


def scan(series: str = SERIES) -> Volume:
    """Tissue below a slanting plane, air above it; no sphere."""
    geometry = VoxelGeometry(
        (67, 67, 67),
        np.full(3, -99.0),
        np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
        np.full(3, 3.0),
    )
    z, y, _ = np.meshgrid(*[np.arange(-99.0, 100.0, 3.0)] * 3, indexing="ij")
    return Volume(
        np.where(0.8 * z - 0.6 * y < 79.0, 40, -1000).astype(np.int16), geometry, series, "1.2.3", "HFS"
    )


def draw(desk: PlanDesk, standoff_mm: float = 30.0) -> None:
    draft = replace(desk.draft, instrument_length_mm=250.0, standoff_mm=standoff_mm)
    desk.change(draft.with_way("T1", replace(draft.way("T1"), entry_mm=ENTRY, target_mm=TARGET)))


def save(desk: PlanDesk, author: str = "Dr Test") -> None:
    asyncio.run(desk.save(author))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "plan.toml"


@pytest.fixture
def desk(file: Path) -> PlanDesk:
    return PlanDesk(scan(), file, None)


def reopened(desk: PlanDesk) -> PlanDesk:
    """By the next planner."""
    desk.close()
    return PlanDesk(scan(), desk.file, None)


def test_a_plan_that_was_saved_is_opened_as_it_stood(desk: PlanDesk, file: Path) -> None:
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
    with pytest.raises(PlanMistakes, match=r"PLAN-002.*somebody"):
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


def test_a_plan_of_another_ct_is_told_and_never_overwritten(desk: PlanDesk, file: Path) -> None:
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


def test_a_file_that_is_no_plan_is_told_and_left(file: Path) -> None:
    file.write_text("not = [toml")
    desk = PlanDesk(scan(), file, None)
    assert desk.read_only is not None
    assert desk.read_only.code == "PLAN-001"
    assert file.read_text() == "not = [toml"


def test_an_altered_plan_is_opened_with_a_warning_and_sealed_again(desk: PlanDesk, file: Path) -> None:
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


def test_a_plan_that_another_program_changed_meanwhile_is_not_overwritten(desk: PlanDesk, file: Path) -> None:
    draw(desk)
    save(desk)
    file.write_text("theirs")
    draw(desk, standoff_mm=31.0)
    with pytest.raises(PlanNotSaved, match=r"PLAN-025.*another program"):
        save(desk)
    assert file.read_text() == "theirs"
    assert desk.draft.standoff_mm == 31.0


def test_while_a_case_runs_on_it_a_plan_is_only_looked_at(desk: PlanDesk, file: Path) -> None:
    draw(desk)
    save(desk)
    before, draft = file.read_bytes(), desk.draft
    with held_plan(file):
        draw(desk, standoff_mm=31.0)
        desk.undo()
        assert desk.draft is draft
        with pytest.raises(PlanInUse, match="PLAN-026"):
            save(desk)
    assert file.read_bytes() == before
    draw(desk, standoff_mm=31.0)
    save(desk)
    assert read_plan(file).standoff_mm == 31.0


def test_a_case_that_begins_on_the_plan_while_it_is_saved_wins(
    desk: PlanDesk, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw(desk)
    save(desk)
    before = file.read_bytes()
    draw(desk, standoff_mm=31.0)
    with ExitStack() as case:

        def meanwhile(*arguments: object) -> object:
            case.enter_context(held_plan(file))
            return sealed(*arguments)  # type: ignore[arg-type]

        monkeypatch.setattr(desk_module, "sealed", meanwhile)
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


def test_what_was_drawn_and_not_saved_is_taken_up_and_undo_goes_back_to_the_plan(
    desk: PlanDesk, file: Path
) -> None:
    draw(desk)
    save(desk)
    assert desk.keep() is None
    draw(desk, standoff_mm=31.0)
    half, name = desk.draft.with_new_way()
    desk.change(half.with_way(name, replace(half.way(name), entry_mm=ENTRY)))
    kept = desk.close()
    assert kept is not None

    again = PlanDesk(scan(), file, None)
    assert again.notice is not None
    assert again.notice.code == "PLAN-029"
    assert again.draft == desk.draft
    assert not again.is_saved
    again.undo()
    assert again.draft.standoff_mm == 30.0
    assert again.keep() is None
    assert not kept.exists()


def test_a_second_planner_looks_on_until_the_first_has_left_and_then_goes_on_with_its_draft(
    desk: PlanDesk, file: Path
) -> None:
    draw(desk)
    save(desk)
    draw(desk, standoff_mm=31.0)
    other = PlanDesk(scan(), file, None)
    assert other.draft.standoff_mm == 30.0
    assert "another planner" in str(other.read_only)
    draw(other, standoff_mm=35.0)
    assert other.draft.standoff_mm == 30.0
    save(desk)
    draw(desk, standoff_mm=32.0)
    assert other.close() is None
    assert not other.begin()
    kept = desk.close()
    assert kept is not None
    assert other.begin()
    assert other.draft == desk.draft
    other.undo()
    assert other.draft.standoff_mm == 31.0
    other.close()
    assert [one.name for one in file.parent.iterdir()] == [file.name]


def test_whoever_looks_on_is_told_when_the_plan_is_free(
    desk: PlanDesk, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(desk_module, "AGAIN_S", 0.01)
    other = PlanDesk(scan(), file, None)

    async def becomes_free() -> None:
        work = asyncio.create_task(other.work())
        heard = other.subscribe()
        while other.searching:
            await heard.wait()
            heard.clear()
        assert other.read_only is not None
        desk.close()
        while other.read_only is not None:
            await heard.wait()
            heard.clear()
        work.cancel()

    asyncio.run(asyncio.wait_for(becomes_free(), 60.0))


def test_the_plan_of_a_run_is_looked_at_and_nothing_is_written_beside_it(
    desk: PlanDesk, tmp_path: Path
) -> None:
    draw(desk)
    save(desk)
    case = tmp_path / "run" / "case"
    case.mkdir(parents=True)
    (tmp_path / "run" / "journal.jsonl").touch()
    kept = desk.file.rename(case / "plan.toml")
    looked = PlanDesk(scan(), kept, None)
    assert looked.draft.ways == desk.draft.ways
    assert "the run run, which stays" in str(looked.read_only)
    draw(looked, standoff_mm=31.0)
    assert looked.close() is None
    assert looked.is_saved
    with pytest.raises(PlanInUse, match=r"PLAN-026.*open the copy"):
        save(looked)
    assert [one.name for one in case.iterdir()] == ["plan.toml"]


def test_unsaved_changes_of_a_plan_that_was_changed_since_are_put_aside_and_told(
    desk: PlanDesk, file: Path
) -> None:
    draw(desk)
    kept = desk.close()
    assert kept is not None
    content = kept.read_bytes()
    other = PlanDesk(scan(), file.with_name("other.toml"), None)
    draw(other, standoff_mm=35.0)
    save(other)
    file.write_bytes(other.file.read_bytes())
    again = PlanDesk(scan(), file, None)
    assert again.draft.standoff_mm == 35.0
    assert again.notice is not None
    assert "plan.toml.unsaved-1" in str(again.notice)
    assert kept.with_name("plan.toml.unsaved-1").read_bytes() == content


def test_unsaved_changes_that_a_running_case_kept_from_being_taken_up_are_offered_when_it_has_ended(
    desk: PlanDesk, file: Path
) -> None:
    draw(desk)
    save(desk)
    draw(desk, standoff_mm=31.0)
    desk.close()
    with held_plan(file):
        again = PlanDesk(scan(), file, None)
        assert again.draft.standoff_mm == 30.0
        assert again.keep() is None
        assert not again.begin()
    draw(again, standoff_mm=32.0)  # at once, before that is taken up
    assert again.begin()
    assert again.draft.standoff_mm == 31.0
    assert again.notice is not None
    assert again.notice.code == "PLAN-029"


@pytest.mark.parametrize("content", [b"", b"{}", b"[1, 2", b'{"ways": 7}'])
def test_unsaved_changes_that_are_damaged_are_put_aside(file: Path, content: bytes) -> None:
    file.with_name("plan.toml.unsaved").write_bytes(content)
    desk = PlanDesk(scan(), file, None)
    assert desk.notice is not None
    assert desk.notice.code == "PLAN-029"
    assert file.with_name("plan.toml.unsaved-1").read_bytes() == content


def test_while_it_saves_the_planner_does_not_take_itself_for_a_case(
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


def test_a_place_without_a_sphere_is_refused_and_no_marker(desk: PlanDesk) -> None:
    with pytest.raises(PickRefused, match="CT-019"):
        asyncio.run(desk.add_marker((0.0, 0.0, 0.0)))
    assert desk.draft.markers == ()


def test_a_ct_without_spheres_is_told_with_what_to_do(desk: PlanDesk) -> None:
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


@pytest.mark.parametrize(
    ("target_mm", "code"),
    [((5.0, -20.0, 520.0), "PLAN-004"), ((5.0, -20.0, -105.0), "PLAN-004"), ((5.0, -90.0, 95.0), "PLAN-011")],
)
def test_what_is_wrong_with_a_drawn_trajectory_is_said_with_its_code(
    desk: PlanDesk, target_mm: tuple[float, float, float], code: str
) -> None:
    draw(desk)
    draft: Draft = desk.draft.with_way("T1", replace(desk.draft.way("T1"), target_mm=target_mm))
    judged = judge(draft, scan(), None, thorough=True)
    assert code in [one.code for one in judged.findings]


def test_a_place_outside_the_scan_is_said(desk: PlanDesk) -> None:
    draw(desk)
    draft = desk.draft.with_way("T1", replace(desk.draft.way("T1"), target_mm=(105.0, -50.0, 60.0)))
    assert "PLAN-006" in [one.code for one in judge(draft, scan(), None, thorough=True).findings]


def test_the_length_of_the_instrument_is_asked_for_and_all_else_is_judged(desk: PlanDesk) -> None:
    draw(desk)
    judged = judge(replace(desk.draft, instrument_length_mm=None), scan(), None, thorough=True)
    assert "length of the instrument" in judged.findings[0].what
    assert [one.code for one in judged.findings] == ["PLAN-002", "PLAN-008"]

"""A plan saved in the planner: who saved it, for which voxels, and that it was not altered since."""

from __future__ import annotations

import errno
import hashlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises

from procedures.imaging.volume import Volume
from procedures.planning.errors import ALTERED_PLAN, PLAN_NOT_SAVED, OtherVoxels, PlanInUse
from procedures.planning.plan_check import check_plan
from procedures.planning.plan_file import describe_seal, parse_plan_bytes, read_plan, seal_plan, write_plan
from procedures.planning.plan_lock import is_plan_in_use, lock_plan, plan_replacement
from procedures.planning.plan_model import Plan


@pytest.fixture
def saved(plan_text: str, plan_path: Callable[[str], Path], make_volume: Callable[..., Volume]) -> Path:
    path = plan_path(plan_text)
    write_plan(path, seal_plan(read_plan(path), "Dr Test", make_volume()), ("a note\nin one line",))
    return path


def test_a_sealed_plan_is_read_as_it_was_saved(saved: Path, make_volume: Callable[..., Volume]) -> None:
    plan = read_plan(saved)
    assert plan.seal is not None
    assert plan.seal.author == "Dr Test"
    assert check_plan(plan, make_volume()).passed
    assert describe_seal(plan) == "sealed by Dr Test"
    assert saved.read_text().startswith("# a note in one line\n")


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("60.0", "61.0"),
        ('"T2"', '"T3"'),
        ("Dr Test", "Dr Other"),
        ("standoff_mm = 30.0", "standoff_mm = 29.0"),
    ],
)
def test_a_plan_altered_under_its_seal_is_refused(saved: Path, before: str, after: str) -> None:
    text = saved.read_text()
    assert before in text
    saved.write_text(text.replace(before, after, 1))
    with raises(ALTERED_PLAN, match=r"PLAN-023.*plan\.toml was altered"):
        read_plan(saved)
    assert read_plan(saved, sealed_only=False).seal is not None  # to be looked at


def test_a_plan_without_a_seal_can_be_edited_freely(saved: Path) -> None:
    saved.write_text(saved.read_text().partition("[seal]")[0].replace("60.0", "61.0", 1))
    plan = read_plan(saved)
    assert plan.seal is None
    assert describe_seal(plan).startswith("not sealed")


def test_a_ct_with_the_series_uid_but_other_voxels_is_refused(
    saved: Path, make_volume: Callable[..., Volume]
) -> None:
    voxels = make_volume().voxels.copy()
    voxels[3, 4, 5] += 1
    with pytest.raises(OtherVoxels, match="PLAN-024"):
        check_plan(read_plan(saved), make_volume(voxels=voxels)).require()
    moved = make_volume().geometry
    moved = type(moved)(
        moved.shape, moved.origin_mm + np.array([0.0, 0.0, 1.0]), moved.axes, moved.spacing_mm
    )
    assert [one.code for one in check_plan(read_plan(saved), make_volume(geometry=moved)).findings] == [
        "PLAN-024"
    ]


def test_a_full_disk_leaves_the_previous_plan_intact(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before, plan = saved.read_bytes(), read_plan(saved)

    def full(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with raises(PLAN_NOT_SAVED, match=r"PLAN-025.*No space left"):
        write_plan(saved, plan)
    assert saved.read_bytes() == before
    assert [one.name for one in saved.parent.iterdir()] == ["plan.toml"]


def test_a_plan_held_by_a_case_is_in_use_until_the_case_ends(saved: Path) -> None:
    assert not is_plan_in_use(saved)
    with lock_plan(saved), lock_plan(saved):
        assert is_plan_in_use(saved)
    assert not is_plan_in_use(saved)
    assert not is_plan_in_use(saved.with_name("none"))


def test_a_case_that_waits_for_a_plan_to_be_replaced_holds_the_new_one(saved: Path) -> None:
    plan = read_plan(saved)
    with ThreadPoolExecutor(1) as beside, ExitStack() as case:
        with plan_replacement(saved):
            waiting = beside.submit(case.enter_context, lock_plan(saved))
            write_plan(saved, plan)
            assert not waiting.done()
        waiting.result(10.0)
        with pytest.raises(PlanInUse, match="PLAN-026"), plan_replacement(saved):
            pass
    assert not is_plan_in_use(saved)


def test_a_case_reads_the_plan_it_holds_even_after_the_file_is_replaced(saved: Path) -> None:
    plan, content = read_plan(saved), saved.read_bytes()
    with lock_plan(saved) as held:
        saved.unlink()
        saved.write_text("# another one\n")
        assert parse_plan_bytes(held.content, "plan.toml") == plan
        assert held.sha256 == hashlib.sha256(content).hexdigest()


def test_the_seal_does_not_depend_on_how_numbers_are_written(saved: Path) -> None:
    text = saved.read_text()
    saved.write_text(text.replace("-20.0,", "-20,").replace("30.0", "3e1"))
    assert isinstance(read_plan(saved), Plan)

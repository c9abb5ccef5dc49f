"""A series fused with the CT in the planner: what its pictures show, and targets chosen in it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from coded_errors import raises
from fusion_records import MR_UID, fusion
from plan_editors import ENTRY, SERIES, TARGET, code_of, draw, save, scan
from scipy.spatial.transform import RigidTransform, Rotation
from shown_page import on_a_page

from console.guard import Session, SessionRole
from console.planning.fused_series import FusedSeries, ShownSeries
from console.planning.page import ENTRY as SET_ENTRY
from console.planning.page import LOOK, PlannerPage
from console.planning.page import TARGET as SET_TARGET
from console.planning.pictures import SQUARE_PX, UNSCANNED_GREY, render_png
from console.planning.plan_editor import PlanEditor
from console.planning.slices import DIRECTIONS, Cut, Plane
from procedures.fusion.errors import OTHER_FUSION
from procedures.imaging.volume import Volume, VoxelGeometry
from procedures.planning.plan_file import read_plan

DIGEST = "a" * 64
WINDOW_HU = (-1000.0, 600.0)
BALL_MM = 16.0
MARK_MM = np.array([30.0, -40.0, 20.0])  # in the CT
CT_FROM_OTHER = RigidTransform.from_components((25.0, -5.0, 3.0), Rotation.from_rotvec([0.1, -0.3, 0.2]))


def other_series(uid: str = MR_UID) -> Volume:
    """A cube of 120 mm about the middle of the CT, dark but for a bright ball at `MARK_MM`, seen askew."""
    axes = np.eye(3)[::-1].copy()
    middle_mm = CT_FROM_OTHER.inv().apply(np.zeros(3))
    geometry = VoxelGeometry((61, 61, 61), middle_mm - 60.0, axes, np.full(3, 2.0))
    places_mm = geometry.to_patient_mm(np.moveaxis(np.indices(geometry.shape), 0, -1))
    away_mm = np.linalg.norm(places_mm - CT_FROM_OTHER.inv().apply(MARK_MM), axis=-1)
    return Volume(np.where(away_mm < BALL_MM, 900, 0).astype(np.int16), geometry, uid, "1.2.3")


def fused(digest: str = DIGEST) -> FusedSeries:
    return FusedSeries.of(other_series(), fusion(CT_FROM_OTHER, ct_uid=SERIES), digest)


def editor_with(file: Path, series: FusedSeries | None) -> PlanEditor:
    return PlanEditor(scan(), file, fused=series)


def shown_grey(plane: Plane, series: ShownSeries) -> np.ndarray:
    right, down = (np.array(one) for one in DIRECTIONS[plane])
    picture = render_png(scan(), Cut(MARK_MM, right, down, 0.4), WINDOW_HU, fused(), series)
    return np.asarray(cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_GRAYSCALE))


@pytest.mark.parametrize("plane", list(DIRECTIONS))
def test_the_other_series_is_shown_where_the_fusion_puts_it_in_the_ct(plane: Plane) -> None:
    grey = shown_grey(plane, ShownSeries.OTHER)
    rows, columns = np.nonzero(grey > 128)
    assert (columns.mean() + 0.5, rows.mean() + 0.5) == pytest.approx((256.0, 256.0), abs=2.0)
    assert 0.4 * np.sqrt(len(rows) / np.pi) == pytest.approx(BALL_MM, abs=0.5)
    assert grey[0, 0] == UNSCANNED_GREY, "the other series ends there"


def test_a_chequerboard_shows_the_ct_in_one_square_and_the_other_series_beside_it() -> None:
    ct, other, both = (shown_grey(Plane.AXIAL, series) for series in ShownSeries)
    middle = 4 * SQUARE_PX
    right, above = np.s_[middle : middle + SQUARE_PX], np.s_[middle - SQUARE_PX : middle]
    assert (both[right, right] == ct[right, right]).all()
    assert (both[above, right] == other[above, right]).all()
    assert (ct[above, right] != other[above, right]).mean() > 0.9


def test_a_target_set_while_the_other_series_is_shown_is_marked_with_the_error_there(tmp_path: Path) -> None:
    editor = editor_with(tmp_path / "plan.toml", fused())
    draw(editor)

    async def do() -> None:
        page = PlannerPage(editor, Session(SessionRole.OPERATOR, "session-1"), low=True)
        page.build()
        page._mode.set_value(SET_TARGET)
        await page._on_click(TARGET)
        assert editor.draft.way("T1").fusion_error_mm is None, "the CT was shown"
        assert "0.37 mm rms in the head, 0.36 mm at the crosshair" in page._fusion_note.text
        assert "marked" not in page._fusion_note.text
        page._show_series(ShownSeries.OTHER)
        assert "marked as chosen in the MR" in page._fusion_note.text
        assert "o=other" in page._slices[0]._shown[0]
        assert page._slices[0]._where.text.startswith("MR · ")
        page._mode.set_value(SET_ENTRY)
        await page._on_click(ENTRY)
        assert editor.draft.way("T1").fusion_error_mm is None, "only a target is marked"
        page._go_to(TARGET)
        page._on_key("t")
        page._show()
        assert editor.draft.way("T1").fusion_error_mm == pytest.approx(np.hypot(0.3, 0.2), abs=1e-3)
        assert page._ways._origin.visible
        assert page._ways._origin_words.text == "Target chosen in the MR: fusion error 0.36 mm"
        assert page._mode.value == LOOK

    on_a_page(do)
    save(editor)
    plan = read_plan(editor.file)
    assert plan.fusion == fused().reference
    assert plan.trajectory("T1").fusion_error_mm == pytest.approx(0.361)


def test_a_marked_target_stays_marked_in_the_ct_until_a_person_says_that_it_was_chosen_there(
    tmp_path: Path,
) -> None:
    editor = editor_with(tmp_path / "plan.toml", fused())
    draw(editor)

    def do() -> None:
        page = PlannerPage(editor, Session(SessionRole.OPERATOR, "session-1"), low=True)
        page.build()
        page._show_series(ShownSeries.BOTH)
        page._ways.place("target", TARGET)
        page._show_series(ShownSeries.CT)
        page._ways.place("target", (6.0, -20.0, 20.0))
        assert editor.draft.way("T1").fusion_error_mm is not None
        page._ways._set(fusion_error_mm=None)
        page._show()
        assert not page._ways._origin.visible
        page._ways.place("target", TARGET)
        assert editor.draft.used_fusion is None
        assert "fusion" not in editor.draft.content(SERIES)

    on_a_page(do)


def test_a_series_that_was_not_fused_is_refused() -> None:
    with raises(OTHER_FUSION, match="not the one that was fused"):
        FusedSeries.of(other_series("1.2.840.6"), fusion(), DIGEST)


@pytest.mark.parametrize("is_saved", [True, False])
def test_a_plan_whose_targets_were_chosen_by_another_fusion_is_left_unchanged(
    tmp_path: Path, *, is_saved: bool
) -> None:
    editor = editor_with(tmp_path / "plan.toml", fused())
    draw(editor)
    draft = editor.draft
    editor.change(fused().with_target(draft, draft.way("T1"), TARGET))
    if is_saved:
        save(editor)
    kept = editor.close()
    assert (kept is None) == is_saved
    before = {one: one.read_bytes() for one in tmp_path.iterdir() if one.suffix in (".toml", ".unsaved")}
    again = editor_with(editor.file, fused(digest="b" * 64))
    assert code_of(again.read_only) == "FUS-009"
    again.close()
    assert {one: one.read_bytes() for one in before} == before
    allowed = editor_with(editor.file, fused())
    assert allowed.read_only is None
    assert allowed.draft.way("T1").fusion_error_mm is not None
    assert replace(allowed.draft.way("T1"), fusion_error_mm=None) == draft.way("T1")

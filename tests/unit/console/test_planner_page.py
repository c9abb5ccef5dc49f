"""What a person does on the planner's page without a mouse: type an axis, look around, draw."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from coded_errors import raises
from plan_editors import ENTRY, SERIES, TARGET, draw, scan
from recording_cell import mini_theatre_file
from shown_page import on_a_page

from console.guard import Session, SessionRole
from console.planning.draft import Axis
from console.planning.head_scene import ARM_OF_CROSS_MM
from console.planning.page import AC_PC, DRAW, LOOK, MEASURE, SPHERE, PlannerPage
from console.planning.plan_editor import PlanEditor
from console.planning.slices import WINDOWS_HU, ZOOMS, Plane
from console.planning.theatre_choice import TheatreChoice
from console.planning.views import PlanView, Size, arrange
from procedures.planning.errors import PLACE_UNFIT, HeadPlaceUnknown

AXIAL = list(Plane).index(Plane.AXIAL)


def on_the_page(folder: Path, do: Callable[[PlannerPage], Awaitable[None]]) -> None:
    editor = PlanEditor(scan(), folder / "plan.toml", None)
    draw(editor)

    async def page() -> None:
        page = PlannerPage(editor, Session(SessionRole.OPERATOR, "session-1"), low=True)
        page.build()
        await do(page)

    on_a_page(page)


def enter(page: PlannerPage, name: str, words: str) -> None:
    field = page._ways.fields[name]
    field._field.set_value(words)
    field._commit()


async def press(page: PlannerPage, key: str, plane: Plane = Plane.AXIAL) -> None:
    await page._slices[list(Plane).index(plane)]._on_key(SimpleNamespace(args={"key": key, "shift": False}))


def asked_for(page: PlannerPage) -> dict[str, str]:
    """What the axial picture's address asks for."""
    return {name: one for name, (one,) in parse_qs(urlsplit(page._slices[AXIAL]._shown[0]).query).items()}


def test_angles_depth_and_free_angle_are_typed_about_a_target_that_stays(tmp_path: Path) -> None:
    async def do(page: PlannerPage) -> None:
        for name, words in (("azimuth", "-80"), ("elevation", "30,5"), ("depth", "60"), ("free angle", "15")):
            enter(page, name, words)
        way = page._editor.draft.way("T1")
        assert way.target_mm == TARGET
        assert (way.depth_mm, way.free_angle_deg) == (pytest.approx(60.0), 15.0)
        assert way.ends is not None
        axis = Axis.of(*way.ends)
        assert (axis.azimuth_deg, axis.elevation_deg) == (pytest.approx(-80.0), pytest.approx(30.5))
        for _ in range(4):
            page._editor.undo()
        assert page._editor.draft.way("T1").entry_mm == ENTRY

    on_the_page(tmp_path, do)


def test_windows_slices_and_zoom_change_the_pictures_and_the_crosshair_follows_in_3d(tmp_path: Path) -> None:
    async def do(page: PlannerPage) -> None:
        page._go_to(TARGET)
        shown = []
        for window in WINDOWS_HU:
            page._set_window(window)
            shown.append(asked_for(page)["w"])
        assert shown == list(WINDOWS_HU)
        step_mm = float(asked_for(page)["s"])
        await press(page, "+")
        assert float(asked_for(page)["s"]) == pytest.approx(step_mm / ZOOMS[1], abs=1e-4)
        await press(page, "PageDown")
        place = page._page_view.place_mm
        assert np.abs(np.subtract(place, TARGET)).tolist() == pytest.approx([0.0, 0.0, 3.0])
        await press(page, "PageDown", Plane.ALONG)
        assert page._page_view.turn_deg == 5.0
        page._scene.build_scene()
        for axis, rod in enumerate(page._scene._cross):
            start = list(place)
            start[axis] -= ARM_OF_CROSS_MM
            assert [1000.0 * one for one in (rod.group.x, rod.group.y, rod.group.z)] == pytest.approx(start)

    on_the_page(tmp_path, do)


def test_the_enter_key_does_at_the_crosshair_what_a_click_does(tmp_path: Path) -> None:
    async def do(page: PlannerPage) -> None:
        page._go_to(TARGET)
        page._mode.set_value(DRAW)
        await press(page, "Enter")
        assert page._editor.draft.structures[0].points_mm == (TARGET,)
        page._mode.set_value(SPHERE)
        await press(page, "Enter")
        assert "CT-019" in str(page._words.content)

    on_the_page(tmp_path, do)


@pytest.mark.parametrize("large", list(PlanView))
def test_one_view_is_large_and_three_are_small(large: PlanView) -> None:
    sizes = list(arrange(large).values())
    assert arrange(large)[large] is Size.LARGE
    assert [sizes.count(size) for size in Size] == [1, 3, 1]


def test_the_page_opens_on_the_target_and_enter_enlarges_a_small_picture(tmp_path: Path) -> None:
    async def do(page: PlannerPage) -> None:
        assert (page._page_view.place_mm, page._page_view.window) == (TARGET, "brain")
        await press(page, "Enter", Plane.SAGITTAL)
        assert page._page_view.large is PlanView.SAGITTAL
        assert page._page_view.measured_mm == ()
        assert "large" in page._sections[PlanView.SAGITTAL].classes
        assert "small" in page._sections[PlanView.AXIAL].classes

    on_the_page(tmp_path, do)


def test_two_clicks_measure_the_distance_in_space_until_another_tool_is_chosen(tmp_path: Path) -> None:
    async def do(page: PlannerPage) -> None:
        page._mode.set_value(MEASURE)
        for place_mm in ((0.0, 0.0, 0.0), (2.0, 3.0, 6.0)):
            await page._on_click(place_mm)
        assert page._hint.text == "Distance 7.0 mm"
        assert "7.0 mm" in page._slices[AXIAL]._shown[1]
        page._mode.set_value(LOOK)
        assert page._hint.text == ""
        assert "7.0 mm" not in page._slices[AXIAL]._shown[1]

    on_the_page(tmp_path, do)


def test_three_clicks_give_ac_pc_coordinates_and_typed_ones_move_the_crosshair(tmp_path: Path) -> None:
    async def do(page: PlannerPage) -> None:
        page._mode.set_value(AC_PC)
        await page._on_click((2.0, -5.0, 37.5))
        await page._on_click((2.0, -4.0, 37.5))
        assert "PLAN-031" in str(page._words.content)
        for place_mm in ((2.0, 15.0, 22.5), (2.0, 23.4, 66.2)):
            await page._on_click(place_mm)
        assert page._mode.value == LOOK
        for axis, typed in enumerate(("12", "-3", "-4")):
            field = page._ac_pc.fields[axis]
            field._field.set_value(typed)
            field._commit()
        assert page._page_view.place_mm == pytest.approx((-10.0, 5.0, 25.0))
        assert 'data-acpc="12.0 -3.0 -4.0"' in page._ac_pc._table.content
        page._editor.undo()
        assert page._editor.draft.ac_pc is None

    on_the_page(tmp_path, do)


def test_only_theatre_files_are_offered_by_name_and_none_is_checked_without_a_place_of_the_head(
    tmp_path: Path,
) -> None:
    given = mini_theatre_file(tmp_path, simulated=True).rename(tmp_path / "given.toml")
    (tmp_path / "lab").mkdir()
    mini_theatre_file(tmp_path / "lab", simulated=True)
    (tmp_path / "lab" / "plan.toml").write_text("schema = 1\n")
    (tmp_path / "lab" / "broken.toml").write_text("theatre =")
    choice = TheatreChoice(tmp_path / "lab", tmp_path / "plan.toml", given)
    assert list(choice.list_files()) == ["given.toml", "theatre.toml"]
    assert choice.load_known("1.2.3") is None
    with pytest.raises(HeadPlaceUnknown, match="PLAN-032"):
        choice.load("theatre.toml", "1.2.3")


def test_a_chosen_theatre_file_is_checked_from_the_cart_s_proposed_place_of_this_ct(tmp_path: Path) -> None:
    mini_theatre_file(tmp_path, simulated=True)
    place = {
        "series_instance_uid": SERIES,
        "assumed_robot_from_ct": [700.0, 0.0, 100.0, -90.0, 0.0, -90.0],
        "best_mm": [15.0, 0.0],
        "turned_deg": 0.0,
        "free_mm": 20.0,
        "turns_deg": [5.0, 5.0],
    }
    file = tmp_path / "place.json"
    file.write_text(json.dumps(place))
    choice = TheatreChoice(tmp_path, tmp_path / "plan.toml")
    editor = PlanEditor(scan(), tmp_path / "plan.toml", choice)
    assert editor.theatre is None
    asyncio.run(editor.choose_theatre("theatre.toml"))
    assert editor.theatre is not None
    assert editor.theatre.arm.robot_from_ct.translation_mm == pytest.approx((685.0, 0.0, 100.0))
    file.write_text(json.dumps({**place, "series_instance_uid": "1.2.3.4"}))
    with raises(PLACE_UNFIT, match=r"PLAN-022.*another CT"):
        asyncio.run(editor.choose_theatre("theatre.toml"))
    assert editor.theatre is not None, "the arm so far is kept"


def test_the_only_theatre_file_is_taken_from_the_start_and_of_several_none_is_guessed(tmp_path: Path) -> None:
    file = mini_theatre_file(tmp_path, simulated=True)
    choice = TheatreChoice(
        tmp_path, tmp_path / "plan.toml", robot_from_ct=(700.0, 0.0, 100.0, -90.0, 0.0, -90.0)
    )
    loaded = choice.load_known(SERIES)
    assert loaded is not None
    assert loaded[0] == file.name
    (tmp_path / "another.toml").write_text(file.read_text())
    assert choice.load_known(SERIES) is None
    file.unlink()
    (tmp_path / "another.toml").write_text("[theatre]\n")
    assert choice.load_known(SERIES) is None

"""What a person does on the planner's page without a mouse: type an axis, look around, draw."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from nicegui import Client, ui
from plan_editors import ENTRY, TARGET, draw, scan

from console.guard import Role, Session
from console.planning.draft import Axis
from console.planning.head_scene import ARM_OF_CROSS_MM
from console.planning.page import DRAW, SPHERE, PlannerPage
from console.planning.plan_editor import PlanEditor
from console.planning.slices import WINDOWS_HU, ZOOMS, Plane

AXIAL = list(Plane).index(Plane.AXIAL)


def on_the_page(folder: Path, do: Callable[[PlannerPage], Awaitable[None]]) -> None:
    editor = PlanEditor(scan(), folder / "plan.toml", None)
    draw(editor)

    async def page() -> None:
        with Client(ui.page("/of-a-test"), request=None):
            page = PlannerPage(editor, Session(Role.OPERATOR, "session-1"), low=True)
            page.build()
            await do(page)

    asyncio.run(page())


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
        page._scene.show()
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

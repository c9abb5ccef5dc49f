"""Skin drawn from three sides: where places are, and that sides are not exchanged."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from procedures.imaging.drawn_skin import MISSING, PAPER, SCANNED, VIEWS, DrawnSkin

turn, height = (one.ravel() for one in np.meshgrid(np.arange(0.0, 6.28, 0.05), np.arange(-1.5, 1.5, 0.05)))
BALL = np.column_stack([np.cos(turn) * np.cos(height), np.sin(turn) * np.cos(height), np.sin(height)])
SKIN = DrawnSkin(100.0 * BALL, BALL)
NAMES = list(VIEWS)
LEFT_EAR, NOSE, VERTEX = (99.0, -1.0, 5.0), (1.0, -99.0, 5.0), (1.0, -1.0, 99.0)


def views_of(place_mm: tuple[float, float, float]) -> dict[str, tuple[float, float]]:
    """Return the place's pixels by view, as shares of that view's width and height."""
    width, height = SKIN.size_px[0] / 3, SKIN.size_px[1]
    found = {}
    for x, y in SKIN.place(np.array([place_mm])):
        found[NAMES[int(x // width)]] = ((x % width) / width, y / height)
    return found


def test_a_place_is_in_the_views_whose_half_of_the_head_it_is_on() -> None:
    assert set(views_of(LEFT_EAR)) == {"left side", "front"}
    assert set(views_of(NOSE)) == {"left side", "front"}
    assert set(views_of((-1.0, -99.0, 5.0))) == {"right side", "front"}


def test_the_patients_left_is_at_the_right_of_the_front_view_and_the_side_views_look_outwards() -> None:
    assert views_of(LEFT_EAR)["front"][0] > 0.9
    assert views_of(NOSE)["left side"][0] < 0.1
    assert views_of((-1.0, -99.0, 5.0))["right side"][0] > 0.9
    assert all(y < 0.1 for _, y in views_of(VERTEX).values())


@pytest.mark.parametrize("colour", [SCANNED, MISSING])
def test_a_place_has_its_colour_in_the_picture(colour: tuple[float, float, float]) -> None:
    places = np.array([LEFT_EAR, NOSE])
    content = SKIN.draw(places, np.array([colour] * 2), radius_px=2)
    picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape[:2][::-1] == SKIN.size_px
    for x, y in SKIN.place(places):
        assert tuple(picture[y, x]) == colour


def test_skin_is_grey_on_paper() -> None:
    picture = cv2.imdecode(np.frombuffer(SKIN.draw(), np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert tuple(picture[-1, 0]) == PAPER
    middle = picture[SKIN.size_px[1] // 2, SKIN.size_px[0] // 2]
    assert len(set(middle.tolist())) == 1
    assert middle[0] > 200  # seen face on

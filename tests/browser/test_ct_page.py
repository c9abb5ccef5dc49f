"""The page that `ronna-ct view` writes, used as a person does who looks for spheres."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from painted_ct import Scan, write_series
from user_commands import in_this_process

from procedures.cli.ct import app

ORIGIN_MM = np.array([10.0, -20.0, 30.0])
LOWER_MM, UPPER_MM = np.array([38.2, -9.3, 49.6]), np.array([24.4, 3.1, 83.7])  # LPS
HOLLOW_MM = np.array([40.1, -2.2, 114.3])
PHONE = {"width": 390, "height": 844}
PIXEL_MM = 0.5
NOTCHES_OUT = 12  # of 0.5 mm at least, from the middle of a ball: more than its radius
FOUND = (255, 166, 77)  # colour of the rings
AXIAL, CORONAL, SAGITTAL = range(3)
# The middle of the pixels of a colour, as shares of a plane's width and height; null without any.
MIDDLE_OF = """(canvas, [red, green, blue]) => {
  const {width, height} = canvas, near = (one, other) => Math.abs(one - other) < 40;
  const pixels = canvas.getContext("2d").getImageData(0, 0, width, height).data;
  let count = 0, across = 0, down = 0;
  for (let k = 0; k < width * height; k++)
    if (near(pixels[4 * k], red) && near(pixels[4 * k + 1], green) && near(pixels[4 * k + 2], blue)) {
      count++; across += k % width + 0.5; down += Math.floor(k / width) + 0.5;
    }
  return count ? [across / count / width, down / count / height] : null;
}"""
BRIGHTNESS = """(canvas, [across, down]) => canvas.getContext("2d")
  .getImageData(Math.floor(across * canvas.width) + 3, Math.floor(down * canvas.height) + 3, 1, 1).data[0]"""


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two markers, and a ball with a hole that is doubtful."""
    scan = Scan(shape=(100, 80, 100))
    for centre_mm in (LOWER_MM, UPPER_MM, HOLLOW_MM):
        scan.ball((centre_mm - ORIGIN_MM)[::-1])
    scan.ball((HOLLOW_MM - ORIGIN_MM)[::-1], 2.8, -1000.0)
    folder = tmp_path_factory.mktemp("series")
    return write_series(folder, scan.voxels(), scan.spacing_mm, origin_mm=tuple(ORIGIN_MM))


@pytest.fixture(scope="module")
def written(series: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of that series."""
    out = tmp_path_factory.mktemp("page") / "ct.html"
    done = in_this_process(app, "view", series, "--out", out)
    assert done.returncode == 0, done.stderr
    return out


@pytest.fixture
def shown(page: Any, written: Path) -> Any:
    """The page in a browser, as it opens: at the first marker, the upper one."""
    page.goto(written.as_uri())
    page.wait_for_function("document.getElementById('place').textContent")
    return page


def scroll(page: Any, plane: int, notches: int) -> None:
    page.locator("canvas").nth(plane).hover()
    for _ in range(abs(notches)):
        page.mouse.wheel(0, 100 if notches > 0 else -100)


def ring(page: Any, plane: int) -> list[float] | None:
    """Where a marker is drawn in a plane."""
    middle: list[float] | None = page.locator("canvas").nth(plane).evaluate(MIDDLE_OF, FOUND)
    return middle


def click_ring(page: Any, plane: int) -> None:
    canvas, middle = page.locator("canvas").nth(plane), ring(page, plane)
    assert middle is not None
    box = canvas.bounding_box()
    canvas.click(position={"x": middle[0] * box["width"], "y": middle[1] * box["height"]})


def place_mm(page: Any) -> Any:
    words = page.locator("#place").text_content().removeprefix("LPS ").removesuffix(" mm")
    return np.array([float(word) for word in words.split(", ")])


@pytest.mark.parametrize(
    "plane", [AXIAL, *(pytest.param(one, marks=pytest.mark.slow) for one in (CORONAL, SAGITTAL))]
)
def test_scrolling_a_plane_goes_through_a_sphere_and_out_of_it(shown: Any, plane: int) -> None:
    canvas, numbers = shown.locator("canvas").nth(plane), shown.locator("figcaption span:last-child")
    before = numbers.all_text_contents()
    middle = ring(shown, plane)
    assert middle is not None
    assert canvas.evaluate(BRIGHTNESS, middle) > 150  # polymer
    scroll(shown, plane, 1)
    number, of = before[plane].split(" ", 1)
    assert numbers.nth(plane).text_content() == f"{int(number) + 1} {of}"
    assert ring(shown, plane) == pytest.approx(middle, abs=0.02)
    scroll(shown, plane, NOTCHES_OUT)
    assert ring(shown, plane) is None
    assert canvas.evaluate(BRIGHTNESS, middle) < 50  # air
    after = numbers.all_text_contents()
    assert [after[other] for other in range(3) if other != plane] == [
        before[other] for other in range(3) if other != plane
    ]


def test_the_place_clicked_at_a_marker_is_picked_saved_and_located(
    shown: Any, series: Path, tmp_path: Path
) -> None:
    assert place_mm(shown) == pytest.approx(UPPER_MM, abs=0.06)
    scroll(shown, AXIAL, round(LOWER_MM[2] - UPPER_MM[2]))
    click_ring(shown, AXIAL)
    click_ring(shown, CORONAL)
    assert place_mm(shown) == pytest.approx(LOWER_MM, abs=2.0 * PIXEL_MM)
    shown.get_by_role("button", name="Pick this place").click()
    with shown.expect_download() as saved:
        shown.get_by_role("link", name="Save picks.json").click()
    saved.value.save_as(tmp_path / saved.value.suggested_filename)
    assert (tmp_path / "picks.json").read_text() == shown.locator("#picks").input_value()
    done = in_this_process(app, "localize", series, "--pick", tmp_path / "picks.json", "--json")
    assert done.returncode == 0, done.stderr
    (marker,) = json.loads(done.stdout)["markers"]
    assert marker["centre_mm"] == pytest.approx(LOWER_MM, abs=0.05)
    assert shown.complaints == []


def test_what_is_doubtful_is_listed_apart_with_its_reason_and_odds(shown: Any) -> None:
    assert shown.locator("tbody th").all_text_contents()[0] == "Markers"
    odds = shown.locator("thead th").all_text_contents().index("odds")
    for row in shown.locator("tbody.found tr.jump").all():
        assert float(row.locator("td").nth(odds).text_content()) > 0.9
    (doubtful,) = shown.locator("tbody.doubtful tr.jump").all()
    assert doubtful.locator("td").nth(odds).text_content() == "< 0.01"  # not 0: there is a sphere
    assert "of its core is a different material" in doubtful.locator("td").last.text_content()
    doubtful.click()
    assert place_mm(shown) == pytest.approx(HOLLOW_MM, abs=PIXEL_MM)
    assert "Below 0.5 it is doubtful" in shown.locator("body").text_content()


def test_the_page_asks_nobody_for_anything(shown: Any, written: Path) -> None:
    assert {url for url in shown.requested if not url.startswith("data:")} == {written.as_uri()}


def test_on_a_phone_nothing_is_cut_off_and_reasons_have_the_whole_width(page: Any, written: Path) -> None:
    page.set_viewport_size(PHONE)
    page.goto(written.as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") == PHONE["width"]
    remarks = page.locator("td.remarks").all()
    assert len(remarks) >= 3
    assert all(one.bounding_box()["width"] > 0.85 * PHONE["width"] for one in remarks)
    remarks[-1].click()
    box = page.locator("canvas").first.bounding_box()
    assert 0.0 < box["y"] < box["y"] + box["height"] < PHONE["height"]  # what was asked for is in view

"""Planner screenshots for the docs, taken of a real plan in a real browser.

.venv/bin/python tools/docs/planner_pictures.py [FOLDER]     # docs/pictures by default; half a minute
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path += map(str, (ROOT / "tests" / "support").iterdir())

# These stand beside the tests, whose folders are on the path only now.
from modest_chromium import MISSING, modest_chromium, opened_context  # noqa: E402
from open_planner import await_judged, enter_planner, make_phantom, open_planner  # noqa: E402

DRAWN_MS = 2500  # for software graphics to have drawn the scene
PAGES = tuple((scheme, size) for size in ((1280, 720), (390, 844)) for scheme in ("light", "dark"))


def main() -> None:
    """Take the screenshots and write them to files."""
    if MISSING:
        sys.exit(MISSING)
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "pictures"
    with tempfile.TemporaryDirectory() as name, modest_chromium(Path(name)) as browser:
        place = Path(name)
        patient = make_phantom(place / "case", "--markers", 5)
        with open_planner(place, patient / "ct") as addresses:
            for scheme, (width, height) in PAGES:
                context = opened_context(
                    browser, viewport={"width": width, "height": height}, color_scheme=scheme
                )
                page = context.new_page()
                enter_planner(page, addresses["url"])
                await_judged(page)
                page.get_by_label("crosshair to the target").click()
                if page.locator("[data-distance]").count() == 0:
                    _draw(page)
                page.mouse.move(0, 0)  # no tooltip of a button under the pointer
                page.evaluate("window.scrollTo(0, 0)")
                page.wait_for_timeout(DRAWN_MS)
                page.screenshot(path=str(out / f"planner-{scheme}-{width}.png"))
                context.close()


def _draw(page: Any) -> None:
    """Draw a structure next to the target, shaped like a vessel."""
    page.get_by_role("button", name="draw a structure").click()
    picture = page.locator("[data-plane=axial]").bounding_box()
    for number, (across, down) in enumerate(((0.36, 0.5), (0.40, 0.56), (0.41, 0.63), (0.39, 0.70))):
        page.mouse.move(
            picture["x"] + across * picture["width"], picture["y"] + down * picture["height"], steps=3
        )
        if number == 0:
            page.mouse.down()
    page.mouse.up()
    page.wait_for_selector("[data-distance]")


if __name__ == "__main__":
    main()

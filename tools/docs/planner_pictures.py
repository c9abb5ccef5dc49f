"""Takes the pictures of the planner in the docs, from a real plan in a real browser.

.venv/bin/python tools/docs/planner_pictures.py [FOLDER]     # docs/pictures by default; half a minute
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "support"))

# These stand beside the tests, whose folder is on the path only now.
from modest_chromium import MISSING, modest_chromium  # noqa: E402
from open_planner import await_judged, enter_planner, make_phantom, open_planner  # noqa: E402

DRAWN_MS = 2500  # for software graphics to have drawn the scene
PAGES = (("light", (1280, 720)), ("dark", (1280, 720)), ("light", (390, 844)))


def main() -> None:
    """Write the pictures."""
    if MISSING:
        sys.exit(MISSING)
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "pictures"
    with tempfile.TemporaryDirectory() as name, modest_chromium(Path(name)) as browser:
        place = Path(name)
        patient = make_phantom(place / "case", "--markers", 5)
        with open_planner(place, patient / "ct") as addresses:
            for scheme, (width, height) in PAGES:
                context = browser.new_context(
                    viewport={"width": width, "height": height}, color_scheme=scheme
                )
                page = context.new_page()
                enter_planner(page, addresses["url"])
                await_judged(page)
                page.get_by_label("crosshair to the target").click()
                page.wait_for_timeout(DRAWN_MS)
                page.screenshot(path=str(out / f"planner-{scheme}-{width}.png"))
                context.close()


if __name__ == "__main__":
    main()

"""Console screenshots for the docs, taken during a real case in a real browser.

.venv/bin/python tools/docs/console_pictures.py [FOLDER]     # docs/pictures by default; a minute
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path += map(str, (ROOT / "tests" / "support").iterdir())

# These stand beside the tests, whose folders are on the path only now.
from console_clicks import answer, answer_until, await_next, run_to, take_seat  # noqa: E402
from modest_chromium import MISSING, modest_chromium, opened_context  # noqa: E402
from operated_case import enter, operated_cases, reviewed  # noqa: E402

DRAWN = """
async () => {
  // a picture further down is loaded when it is scrolled to, and decoded never
  const decoded = [...document.images].map(image => image.decode().catch(() => null));
  await Promise.race([Promise.all(decoded), new Promise(given_up => setTimeout(given_up, 5000))]);
  for (let frame = 0; frame < 8; frame++) await new Promise(requestAnimationFrame);
}
"""  # software graphics have drawn the scene, and every picture is there
AT_TARGET = "the instrument is at depth"  # text of the question at the target
WIDE, PHONE = (1280, 720), (390, 844)


def main() -> None:
    """Take the screenshots and write them to files."""
    if MISSING:
        sys.exit(MISSING)
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "pictures"
    with (
        tempfile.TemporaryDirectory() as place,
        modest_chromium(Path(place)) as browser,
        operated_cases(Path(place)) as start,
    ):
        case = start("step")
        page = _open_page(browser, WIDE, "light")
        enter(page, case.addresses["url"])
        take_seat(page, "Dr Rehearsal")
        await_next(page, "ct_import")
        run_to(page, "registration:T1")
        answer_until(page, "accept the registration")
        _take(page, out / "console-registration.png")
        for scheme, size in (("dark", WIDE), ("light", PHONE), ("dark", PHONE)):
            page.emulate_media(color_scheme=scheme)
            page.set_viewport_size({"width": size[0], "height": size[1]})
            _take(page, out / f"console-operator-{scheme}-{size[0]}.png")
        page.emulate_media(color_scheme="light")
        page.set_viewport_size({"width": WIDE[0], "height": WIDE[1]})
        for scheme, size in (("dark", WIDE), ("light", PHONE)):
            watching = _open_page(browser, size, scheme)
            enter(watching, case.addresses["viewer_url"])
            _take(watching, out / f"console-viewer-{scheme}-{size[0]}.png")
            watching.context.close()
        answer(page)
        await_next(page, "tool_change")
        run_to(page, "at_target:T1")
        answer_until(page, AT_TARGET)
        page.get_by_role("button", name="head", exact=True).click()
        _take(page, out / "console-at-target.png")
        page.locator(".devicebox").scroll_into_view_if_needed()
        _take(page, out / "console-devices.png")
        with reviewed(case.run, Path(place) / "review-errors") as address:
            for scheme in ("light", "dark"):
                looking = _open_page(browser, WIDE, scheme)
                enter(looking, address)
                _take(looking, out / f"console-review-{scheme}-1280.png")
                looking.context.close()


def _open_page(browser: Any, size: tuple[int, int], scheme: str) -> Any:
    width, height = size
    context = opened_context(browser, viewport={"width": width, "height": height}, color_scheme=scheme)
    return context.new_page()


def _take(page: Any, path: Path) -> None:
    page.evaluate(DRAWN)
    page.screenshot(path=str(path))


if __name__ == "__main__":
    main()

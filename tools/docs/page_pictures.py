"""Screenshots of the console and the planner for the docs, of a real case and a real plan in a real browser.

.venv/bin/python tools/docs/page_pictures.py [--all] [FOLDER]     # docs/pictures by default; two minutes

Takes those of a page that has changed since, or all. Each moment is taken at 1280 x 800 and 390 x 844, light
and dark, with at most 256 colours.
"""

from __future__ import annotations

import argparse
import io
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from page_digest import MADE_OF, PICTURES, ROOT, digest_chunk, stale_pictures
from PIL import Image

sys.path += map(str, (ROOT / "tests" / "support").iterdir())

# These stand beside the tests, whose folders are on the path only now.
from console_clicks import answer, answer_until, await_next, run_to, take_seat
from modest_chromium import MISSING, modest_chromium, opened_context
from open_planner import await_judged, enter_planner, make_phantom, open_planner
from operated_case import enter, operated_cases, reviewed

DRAWN = """
async () => {
  // a picture further down is loaded when it is scrolled to, and decoded never
  const decoded = [...document.images].map(image => image.decode().catch(() => null));
  await Promise.race([Promise.all(decoded), new Promise(given_up => setTimeout(given_up, 3000))]);
  for (let frame = 0; frame < 8; frame++) await new Promise(requestAnimationFrame);
}
"""  # software graphics have drawn the scene, and every picture is there
IS_SCHEME = "dark => document.body.classList.contains('body--dark') === dark"
WIDE, PHONE = (1280, 800), (390, 844)
LOOKS = tuple((scheme, size) for size in (WIDE, PHONE) for scheme in ("light", "dark"))
COLOURS = 256
HOLD_WHILE_RUNNING = """
() => {
  const now = performance.now();
  const step = "li.now[data-step='relocalization:T1']";
  if (!document.querySelector(`${step} progress:not([value='0.000'])`)) return false;
  if (!document.querySelector("figure.live:not(.old) img")?.naturalWidth) return false;
  const scene = getElement(Number(document.querySelector(".stage").id.slice(1))).scene;
  const count = scene.children.length;  // bodies are exchanged one by one
  if (count !== window.bodies) [window.bodies, window.since] = [count, now];
  const isGrey = document.querySelector(".scenebox .warn.num") !== null;
  if (isGrey || now - window.since < 700) return false;
  window.socket.disconnect();  // the page keeps this moment for all its looks: steps are quick
  performance.now = () => now;
  return true;
}
"""
SPEED = "1"  # real time: a step lasts until software graphics have drawn it
DRAWN_MS = 2500  # for software graphics to have drawn the planner's scene


def main() -> None:
    """Take the screenshots, write them to files, and delete those that the pages no longer have."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", nargs="?", type=Path, default=PICTURES)
    parser.add_argument("--all", action="store_true", help="also those of a page that has not changed")
    asked = parser.parse_args()
    out: Path = asked.folder
    pages = [page for page in MADE_OF if asked.all or stale_pictures(page, out) or not _pictures(page, out)]
    if not pages:
        sys.stderr.write("The pictures are those of today's pages.\n")
        return
    if MISSING:
        sys.exit(f"The pictures of {' and '.join(pages)} are of an older page, and {MISSING}.")
    sys.stderr.write(f"Taking the pictures of {' and '.join(pages)}, about a minute each.\n")
    with tempfile.TemporaryDirectory() as name, modest_chromium(Path(name)) as browser:
        for page in pages:
            before = _pictures(page, out)
            taken = {file for take in TAKE[page] for file in take(browser, Path(name), out)}
            for file in before - taken:
                file.unlink()


def _pictures(page: str, folder: Path) -> set[Path]:
    return set(folder.glob(f"{page}-*.png"))


def _operated(browser: Any, place: Path, out: Path) -> Iterator[Path]:
    """Take the start of a case, the question about a registration, and steps that run."""
    with operated_cases(place) as start:
        case = start("step", "--speed", SPEED)
        page = _open_page(browser)
        enter(page, case.addresses["url"] + "&low")  # it is drawn beside those that are taken
        await_next(page, "ct_import")
        yield from _take(page, out, "console-start")
        take_seat(page, "Dr Rehearsal")
        run_to(page, "registration:T1")
        answer_until(page, "then as listed")
        moment = _open_beside(page)
        answer(page)
        moment.wait_for_function(HOLD_WHILE_RUNNING)
        yield from _take(moment, out, "console-running")
        moment.close()
        answer_until(page, "Accept the registration")
        yield from _take(_open_beside(page), out, "console-question")
        page.context.close()


def _reviewed(browser: Any, place: Path, out: Path) -> Iterator[Path]:
    """Take a finished case, from its top and from its devices."""
    place = place / "reviewed"  # the case before has a run of its own there
    place.mkdir()
    with operated_cases(place) as start:
        case = start("run", "--json")
        case.ended()
        with reviewed(case.run, place / "review-errors") as address:
            page = _open_page(browser)
            enter(page, address)
            page.wait_for_selector(".accuracy >> text=Predicted error")
            yield from _take(page, out, "console-review")
            yield from _take(page, out, "console-records", ".devicebox")
            page.context.close()


def _planned(browser: Any, place: Path, out: Path) -> Iterator[Path]:
    patient = make_phantom(place / "case", "--markers", 5)
    with open_planner(place, patient / "ct") as addresses:
        page = _open_page(browser)
        enter_planner(page, addresses["url"])
        await_judged(page)
        page.get_by_label("crosshair to the target").click()
        _draw(page)
        page.mouse.move(0, 0)  # no tooltip of a button under the pointer
        page.evaluate("window.scrollTo(0, 0)")
        page.wait_for_timeout(DRAWN_MS)
        yield from _take(page, out, "planner")
        page.context.close()


TAKE = {"console": (_operated, _reviewed), "planner": (_planned,)}


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


def _open_page(browser: Any) -> Any:
    width, height = WIDE
    return opened_context(browser, viewport={"width": width, "height": height}).new_page()


def _open_beside(page: Any) -> Any:
    """Open the same page with all its graphics, in the same session and hence for the same operator."""
    beside = page.context.new_page()
    beside.set_viewport_size({"width": WIDE[0], "height": WIDE[1]})
    enter(beside, page.url.partition("?")[0])
    beside.evaluate(DRAWN)
    return beside


def _take(page: Any, out: Path, moment: str, place: str = "body") -> Iterator[Path]:
    """Take one moment in every look, from that place downwards, and leave the page as it was."""
    for scheme, size in LOOKS:
        _show_as(page, scheme, size)
        page.locator(place).evaluate("place => place.scrollIntoView()")
        page.evaluate(DRAWN)
        yield _keep(page.screenshot(), out, moment, scheme, size)
    _show_as(page, *LOOKS[0])


def _keep(image: bytes, out: Path, moment: str, scheme: str, size: tuple[int, int]) -> Path:
    file = out / f"{moment}-{scheme}-{size[0]}.png"
    pixels = Image.open(io.BytesIO(image)).convert("RGB")
    few = pixels.quantize(COLOURS, kmeans=2, dither=Image.Dither.NONE)
    few.save(file, optimize=True, pnginfo=digest_chunk(moment.partition("-")[0]))
    return file


def _show_as(page: Any, scheme: str, size: tuple[int, int]) -> None:
    page.emulate_media(color_scheme=scheme)
    page.set_viewport_size({"width": size[0], "height": size[1]})
    page.wait_for_function(IS_SCHEME, arg=scheme == "dark")


if __name__ == "__main__":
    main()

"""Response times of the planner page: scrolling, dragging, and first display of the head.

A CT of 512 x 512 x 200 voxels in headless Chromium with software rendering; times are by the page's own
clock, from a person's event to its visible effect. For comparison with the head: how long a bare page of the
same library takes to show its number.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.figures import Figure
from console.planning.slice_panel import CHOSEN
from ronna_hw.arm.pose import Pose
from sim.theatre.theatre_file import theatre_content, write_theatre_file
from sim.world.scene.named_scenes import draw_scene

ROOT = Path(__file__).resolve().parents[2]
sys.path += map(str, (ROOT / "tests" / "support").iterdir())

# These are in the tests' folders, which are on the path only now.
from modest_chromium import MISSING, modest_chromium, opened_context  # noqa: E402
from open_planner import enter_planner, make_phantom, open_planner  # noqa: E402
from recording_cell import ENDPOINTS  # noqa: E402

from benchmarks.pages.console_page import BARE, bare_page  # noqa: E402  # it also needs these folders

OURS = "planner"
SCROLLS, DRAGS, DRAGS_WITH_ARM = 60, 30, 8  # with an arm each is checked for seconds
SMALLEST = (2, 2, 1)
SCROLL_MS, HEAD_S, DRAG_MS = 50.0, 2.0, 200.0
HANDLE = f"[data-plane=axial] svg circle[r='6.0'][stroke='{CHOSEN}']"  # of the target being edited
WATCH = """
window.times = {};
window.noted = (name) => { const at = performance.now(); (window.times[name] ||= []).push(at); };
for (const name of ["wheel", "mousemove"])
  document.addEventListener(name, () => noted(name), {capture: true, passive: true});
document.addEventListener("load", (e) => {
  if (e.target.closest?.("[data-plane=axial]")) noted("picture");
}, true);
new MutationObserver(() => {
  const rms = document.querySelector("[data-expected=T1]")?.dataset.rms;
  if (rms && rms !== window.rms) { window.rms = rms; noted("expected"); }
}).observe(document, {childList: true, subtree: true, attributes: true});
"""


def measure(smallest: bool = False) -> list[Figure]:
    """Measure the response times. The smallest size uses the mini scene, which has a smaller CT."""
    if MISSING:
        return []
    scrolls, drags, drags_with_arm = SMALLEST if smallest else (SCROLLS, DRAGS, DRAGS_WITH_ARM)
    scene = "mini" if smallest else "default"
    with tempfile.TemporaryDirectory() as name, modest_chromium(Path(name)) as browser:
        place = Path(name)
        with bare_page() as (_, address):
            page = opened_context(browser).new_page()
            began_s = time.monotonic()
            page.goto(address)
            page.wait_for_selector("#clock", state="attached")
            bare_s = time.monotonic() - began_s
            page.close()
        patient = make_phantom(place / "case", "--scene", scene, "--protocol", "good")
        with open_planner(place, patient / "ct") as addresses:
            page = opened_context(browser, viewport={"width": 1280, "height": 720}).new_page()
            page.add_init_script(WATCH)
            began_s = time.monotonic()
            with page.expect_response("**/picture/head.stl") as head:
                page.goto(addresses["url"])
            head.value.finished()
            head_s = time.monotonic() - began_s
            enter_planner(page, page.url)
            shape = page.locator(".case .dim").inner_text()
            scrolls_ms = [
                _measure_scroll_ms(page, 1 if number % 20 < 10 else -1) for number in range(scrolls)
            ]
            drags_ms = _measure_drags_ms(page, drags)
            page.close()
        with open_planner(place, patient / "ct", *_arm_options(place, scene)) as addresses:
            page = opened_context(browser, viewport={"width": 1280, "height": 720}).new_page()
            page.add_init_script(WATCH)
            enter_planner(page, addresses["url"])
            with_arm_ms = _measure_drags_ms(page, drags_with_arm)
    label = shape.split(",")[0].removeprefix("CT of ")
    return [
        _time_figure(f"scroll to picture, {label}", scrolls_ms).at_most(SCROLL_MS),
        _time_figure("drag to expected error", drags_ms).at_most(DRAG_MS),
        _time_figure("drag to expected error, with an arm", with_arm_ms).at_most(DRAG_MS),
        Figure("page to head", OURS, head_s, "s", head_s / bare_s, BARE).at_most(HEAD_S),
        Figure("page to its number", BARE, bare_s, "s"),
    ]


def _time_figure(what: str, times_ms: list[float]) -> Figure:
    p95_ms = sorted(times_ms)[int(0.95 * len(times_ms))]
    return Figure(what, OURS, median(times_ms), "ms", more={"p95": p95_ms})


def _measure_scroll_ms(page: Any, steps: int) -> float:
    picture = page.locator("[data-plane=axial]").bounding_box()
    page.mouse.move(picture["x"] + 20, picture["y"] + 20)
    page.evaluate("window.times = {}")
    page.mouse.wheel(0, 100 * steps)
    page.wait_for_function("window.times.picture")
    return float(page.evaluate("window.times.picture[0] - window.times.wheel[0]"))


def _arm_options(place: Path, scene_name: str) -> list[str]:
    """Return the command-line options for the scene's arm, with the head at its true position."""
    scene = draw_scene(scene_name, seed=3)
    write_theatre_file(theatre_content(scene, ENDPOINTS, "host:", {}, 1.0), place / "theatre.toml")
    head = scene.head.robot_from_ct
    pose = Pose.from_quaternion(head.translation_mm, head.quaternion_wxyz).to_kuka()
    return ["--config", str(place / "theatre.toml"), "--robot-from-ct", *(f"{one:.6f}" for one in pose)]


def _measure_drags_ms(page: Any, count: int) -> list[float]:
    page.get_by_label("crosshair to the target").click()
    page.wait_for_selector(HANDLE, state="attached")
    page.wait_for_selector("[data-state=judged]")
    return [_measure_drag_ms(page, 3 if number % 2 else -3) for number in range(count)]


def _measure_drag_ms(page: Any, right_px: int) -> float:
    handle = page.locator(HANDLE).bounding_box()
    x, y = handle["x"] + handle["width"] / 2, handle["y"] + handle["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.wait_for_timeout(100)
    page.evaluate("window.times = {}")
    page.mouse.move(x + right_px, y)
    page.wait_for_function("window.times.expected")
    found = float(page.evaluate("window.times.expected[0] - window.times.mousemove[0]"))
    page.mouse.up()
    page.wait_for_selector("[data-state=judged]")
    return found

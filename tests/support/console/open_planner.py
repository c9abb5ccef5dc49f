"""`ronna-plan open` on a phantom, and what a person does on its page."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from waiting import eventually

READY_S = 60.0
FOUND_MS, JUDGED_MS = 60_000, 60_000


def command(module: str, *arguments: object) -> list[str]:
    """A command of ours, as a line for a process."""
    return [sys.executable, "-P", "-m", module, *map(str, arguments)]


def make_phantom(folder: Path, *options: object) -> Path:
    """The patient of the mini scene: a folder with `ct` and `plan.toml`."""
    scene = ("--scene", "mini", "--seed", 3, *options)
    subprocess.run(command("sim.cli", "phantom", *scene, "--out", folder), check=True, capture_output=True)
    return folder


@contextmanager
def open_planner(folder: Path, series: Path, *options: object) -> Iterator[dict[str, str]]:
    """Its addresses while it serves; what it says is kept in `folder`."""
    errors = folder / "planner-errors"
    with errors.open("w") as file:
        line = command("procedures.cli.plan", "open", series, *options)
        process = subprocess.Popen(line, stdin=subprocess.DEVNULL, stdout=file, stderr=file)
    try:
        eventually(lambda: "CONSOLE {" in errors.read_text() or process.poll() is not None, READY_S)
        yield json.loads(re.findall(r"^CONSOLE (\{.*\})$", errors.read_text(), re.M)[0])
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(30)


def enter_planner(page: Any, address: str) -> None:
    """Open the page and wait until the spheres were looked for."""
    page.goto(address)
    page.wait_for_selector("#clock[data-beat]", state="attached")
    page.wait_for_selector("[data-found]", timeout=FOUND_MS)


def type_number(page: Any, name: str, words: str) -> None:
    """Type into the field of that name."""
    field = page.locator(f'[data-field="{name}"]')
    field.fill(words)
    field.press("Enter")


def type_place(page: Any, end: str, words: tuple[str, str, str]) -> None:
    """Type the coordinates of an end."""
    for letter, number in zip("LPS", words, strict=True):
        type_number(page, f"{end} {letter}", number)


def click_picture(page: Any, plane: str, across: float, down: float) -> None:
    """Click a picture at shares of its width and height."""
    picture = page.locator(f"[data-plane={plane}]")
    box = picture.bounding_box()
    picture.click(position={"x": across * box["width"], "y": down * box["height"]})


def field_value(page: Any, name: str) -> str:
    """What stands in a field."""
    return str(page.locator(f'[data-field="{name}"]').input_value())


def await_judged(page: Any) -> str:
    """Wait for the whole verdict; returns its words."""
    page.wait_for_selector("[data-state=judged]", timeout=JUDGED_MS)
    return str(page.locator(".verdictbox").inner_text())

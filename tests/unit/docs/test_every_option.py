"""Every command, argument and option has a help text, and so has everything on the Python API pages."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from typing import Any

import api_pages
import pytest
import typer

from ronna_hw.command_line.launch import COMMANDS
from ronna_hw.command_line.options import with_common_options


def commands_below(command: Any, path: str) -> Iterator[tuple[str, Any]]:
    yield path, command
    for name, one in getattr(command, "commands", {}).items():
        yield from commands_below(one, f"{path} {name}")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_and_option_has_a_help_text(name: str) -> None:
    application = import_module(COMMANDS[name]).app
    whole = with_common_options(typer.main.get_command(application))
    silent = [
        f"{path} {' '.join(one.opts) if one is not command else ''}"
        for path, command in commands_below(whole, name)
        for one in (command, *command.params)
        if not (one.help or "").strip()
    ]
    assert silent == []


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_of_every_program_has_the_common_options(name: str) -> None:
    whole = with_common_options(typer.main.get_command(import_module(COMMANDS[name]).app))
    for path, command in commands_below(whole, name):
        offered = {word for one in command.params for word in one.opts}
        is_group = bool(getattr(command, "commands", {}))
        assert ({"--version"} if is_group else {"--version", "--verbose", "--log-level"}) <= offered, path


@pytest.mark.parametrize("page", [api_pages.numerics, api_pages.devices], ids=["numerics", "devices"])
def test_everything_on_the_python_api_pages_is_described(page: Any) -> None:
    lines = page().splitlines()
    assert [line for line in lines if line.startswith("- ") and line.endswith(": ")] == []
    assert len([line for line in lines if line.startswith("- ")]) > 30


def test_api_pages_show_field_types_enumeration_members_and_signatures() -> None:
    devices, numerics = api_pages.devices(), api_pages.numerics()
    assert "- `position_mm`: `Vector3 | None`\n- `fit_error_mm`: `float | None`; rms of the fit" in devices
    assert "Members: `OK`, `PARTIAL`, `MISSING`, " in devices
    assert "### `open_theatre(path, timeout_s=10.0)`" in devices
    assert "- **`Pairing(image_mm, physical_mm, *, sigma_image_mm, sigma_physical_mm)`**: " in numerics


def test_a_driver_method_without_a_docstring_shows_that_of_its_interface() -> None:
    driver = api_pages.devices().partition("class `PolarisTracker`")[2]
    said = next(line for line in driver.splitlines() if line.startswith("- **`observe("))
    interface = api_pages.devices().partition("class `OpticalTracker`")[2]
    assert said in interface

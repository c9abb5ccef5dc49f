"""Entry point of every command: check that our packages are ours before importing one.

A foreign `sim` would otherwise end the command with a traceback about a module that nobody knows.
"""

from __future__ import annotations

import ronna_hw.command_line.early_interruption  # noqa: F401 - first of all: imports can be interrupted

# isort: split
import sys
from importlib import import_module
from pathlib import Path
from typing import NoReturn

from ronna_hw.errors import RonnaError
from ronna_hw.host.own_packages import ForeignPackage, explain_failed_import, require_own_packages

COMMANDS = {
    "ronna-procedure": "procedures.cli.procedure",
    "ronna-ct": "procedures.cli.ct",
    "ronna-plan": "procedures.cli.plan",
    "ronna-campaign": "studies.cli",
    "ronna-stereo": "procedures.cli.stereo.command",
    "ronna-arm": "procedures.cli.arm.command",
    "ronna-tool": "procedures.cli.tool.command",
    "ronna-dicom": "procedures.cli.dicom",
    "ronna-sim": "sim.cli",
    "ronna-console": "console.command",
    "ronna-conformance": "conformance.cli",
    "ronna-rom": "drivers.ndi_polaris.rom_command",
    "ronna-link": "procedures.cli.link",
}


def main() -> None:
    """Run the command by whose name this program was called."""
    try:
        require_own_packages()
    except ForeignPackage as foreign:
        _refuse(foreign)
    module = _find_module(Path(sys.argv[0]))
    try:
        command = import_module(module).main
    except (ImportError, AttributeError) as error:
        if (explained := explain_failed_import(module, error)) is None:
            raise
        _refuse(explained)
    command()


def _find_module(program: Path) -> str:
    """Return the command's module, also if the program was called by a link of another name."""
    for name in (program.name, program.resolve().name):
        if name in COMMANDS:
            return COMMANDS[name]
    from ronna_hw.command_line.errors import UsageMistake

    mistake = UsageMistake(
        f"{program.name!r} is no command",
        expected=f"one of {', '.join(COMMANDS)}",
        action="Call the installed program, or a symbolic link to it; a copy needs the same name.",
    )
    return _refuse(mistake)


def _refuse(error: RonnaError) -> NoReturn:
    from ronna_hw.command_line.messages import fail_with

    fail_with(error)
    sys.exit(error.exit_code)

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

from ronna_hw.host.own_packages import ForeignPackage, explain_failed_import, require_own_packages

COMMANDS = {
    "ronna-procedure": "procedures.cli.procedure",
    "ronna-ct": "procedures.cli.ct",
    "ronna-plan": "procedures.cli.plan",
    "ronna-campaign": "studies.cli",
    "ronna-stereo": "procedures.cli.stereo.command",
    "ronna-arm": "procedures.cli.arm.command",
    "ronna-tool": "procedures.cli.tool.command",
    "ronna-sim": "sim.cli",
    "ronna-console": "console.command",
    "ronna-conformance": "conformance.cli",
    "ronna-rom": "drivers.ndi_polaris.rom_command",
}


def main() -> None:
    """Run the command by whose name this program was called."""
    module = COMMANDS[Path(sys.argv[0]).name]
    try:
        require_own_packages()
    except ForeignPackage as foreign:
        _refuse(foreign)
    try:
        command = import_module(module).main
    except (ImportError, AttributeError) as error:
        if (explained := explain_failed_import(module, error)) is None:
            raise
        _refuse(explained)
    command()


def _refuse(error: ForeignPackage) -> NoReturn:
    from ronna_hw.command_line.messages import fail_with

    fail_with(error)
    sys.exit(error.exit_code)

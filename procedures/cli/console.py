"""The command-line conventions, under the name that the commands of this folder use."""

from ronna_hw.command_line.console import (
    JsonOption,
    Progress,
    VerboseOption,
    exit_code_of,
    fail_with,
    message_console,
    on_terminal,
    print_json,
    print_table,
    progress_bar,
    run,
    set_up_logging,
    tell,
)
from ronna_hw.command_line.errors import (
    DiskFull,
    InternalFault,
    NotWritable,
    PathProblem,
    PortInUse,
    UsageMistake,
    as_ronna_error,
)

__all__ = [
    "DiskFull",
    "InternalFault",
    "JsonOption",
    "NotWritable",
    "PathProblem",
    "PortInUse",
    "Progress",
    "UsageMistake",
    "VerboseOption",
    "as_ronna_error",
    "exit_code_of",
    "fail_with",
    "message_console",
    "on_terminal",
    "print_json",
    "print_table",
    "progress_bar",
    "run",
    "set_up_logging",
    "tell",
]

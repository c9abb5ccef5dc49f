"""Command-line interface of the clinical side."""

import ronna_hw.command_line.early_interruption  # noqa: F401 - first of all: imports can be interrupted

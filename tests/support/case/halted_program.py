"""A program: `ronna-procedure`, which halts itself (SIGSTOP) each time a line of its journal is on disk."""

from __future__ import annotations

import os
import signal
import sys
from typing import Any

from drivers.kuka_rsi import arm
from procedures.cli.procedure import main
from procedures.journal.journal import Journal

HALTED_S = 60.0  # longer than anybody needs to copy a folder; the arm's process would stop the arm
append, read_options = Journal._append, arm.read_options


def append_and_halt(journal: Journal, *words: Any, **more: Any) -> None:
    append(journal, *words, **more)
    os.kill(os.getpid(), signal.SIGSTOP)


if __name__ == "__main__":
    arm.read_options = lambda name, options: read_options(name, {**options, "heartbeat_limit_s": HALTED_S})
    Journal._append = append_and_halt  # type: ignore[method-assign]
    sys.exit(main())

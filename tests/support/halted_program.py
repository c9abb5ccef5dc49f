"""A program: `ronna-procedure`, which halts itself (SIGSTOP) each time a line of its journal is on disk."""

from __future__ import annotations

import os
import signal
import sys
from typing import Any

from procedures.cli.procedure import main
from procedures.engine.journal import Journal

append = Journal._append


def append_and_halt(journal: Journal, *words: Any, **more: Any) -> None:
    append(journal, *words, **more)
    os.kill(os.getpid(), signal.SIGSTOP)


if __name__ == "__main__":
    Journal._append = append_and_halt  # type: ignore[method-assign]
    sys.exit(main())

"""Replace the traceback with one word if a command is interrupted during imports. Import this first."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import TracebackType

EXIT_INTERRUPTED = 130  # as in ronna_hw.errors, which is too slow to import here


def say_interrupted(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Report an early interruption; installed as the exception hook while there is nothing to clean up."""
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, trace)
        return
    os.write(2, b"interrupted\n")
    os._exit(EXIT_INTERRUPTED)


sys.excepthook = say_interrupted

"""What an interruption before a command has begun leaves behind: one word, not a trace.

To be imported first of all: the imports of a command last longer than a hand needs to change its mind.
"""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import TracebackType

EXIT_INTERRUPTED = 130  # as in ronna_hw.errors, which takes too long to import here


def say_interrupted(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Hook for what nobody caught: after an interruption there is nothing yet that must be undone."""
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, trace)
        return
    os.write(2, b"interrupted\n")
    os._exit(EXIT_INTERRUPTED)


sys.excepthook = say_interrupted

"""An interruption during the imports of a command prints one word, no traceback. Import this module first."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import TracebackType

EXIT_INTERRUPTED = 130  # as in ronna_hw.errors, which is too slow to import here


def say_interrupted(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Exception hook: nothing needs cleaning up this early."""
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, trace)
        return
    os.write(2, b"interrupted\n")
    os._exit(EXIT_INTERRUPTED)


sys.excepthook = say_interrupted

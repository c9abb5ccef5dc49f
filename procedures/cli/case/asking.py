"""A question on the terminal: nothing else writes over it, and one function shows what is to be typed."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

WritePrompt = Callable[[str], None]  # a prompt
Asking = Callable[[], AbstractContextManager[WritePrompt]]  # held while a question stands


def write_prompt(prompt: str) -> None:
    """Write a prompt."""
    sys.stderr.write(prompt)
    sys.stderr.flush()


def undisturbed() -> AbstractContextManager[WritePrompt]:
    """Where nothing else writes."""
    return nullcontext(write_prompt)

"""Messages on standard error: coloured and wrapped on a terminal, one unwrapped line elsewhere."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, TextIO

from ronna_hw.errors import RonnaError
from ronna_hw.text.printable import printable, printable_lines

if TYPE_CHECKING:
    from rich.console import Console


def on_terminal(stream: TextIO) -> bool:
    """Whether this stream is a terminal."""
    try:
        return stream.isatty()
    except ValueError:  # closed
        return False


def tell(line: str) -> None:
    """Print a one-line message on standard error, if that is still open."""
    with contextlib.suppress(OSError, ValueError):
        sys.stderr.write(printable(line) + "\n")
        sys.stderr.flush()


def tell_address(addresses: Mapping[str, str], tell: Callable[[str], None] = tell) -> None:
    """Print where a page is served: one line for scripts; on a terminal also its address, to click."""
    tell(f"CONSOLE {json.dumps(addresses)}")
    if on_terminal(sys.stderr):
        tell(f"open {addresses['url']}")


def say(line: str = "") -> None:
    """Print one or more lines for a person on standard output."""
    sys.stdout.write(printable_lines(line) + "\n")
    sys.stdout.flush()


def fail_with(error: RonnaError, advice: str | None = None) -> None:
    """Print an error as `run` does, for commands that continue after it.

    `advice` replaces the error's own, if the caller knows better what to do.
    """
    line = " ".join(str(error).split())
    if advice is not None:
        line = f"{line.removesuffix(error.advice).rstrip()} {advice}".rstrip()
    if not on_terminal(sys.stderr):
        tell(line)
        return
    from rich.text import Text

    code, _, rest = line.partition(": ") if error.code else ("", "", line)
    console = message_console()
    with console.capture() as rendered:
        console.print(Text.assemble((f"{code} " if code else "", "bold red"), rest))
    with contextlib.suppress(OSError):
        sys.stderr.write(rendered.get())  # a live display keeps this above itself, unlike direct output
        sys.stderr.flush()


def message_console() -> Console:
    """The rich console for messages (standard error)."""
    from rich.console import Console

    return Console(stderr=True, soft_wrap=not on_terminal(sys.stderr))

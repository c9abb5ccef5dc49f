"""What is imported in a process, asked by arguments `NAME: UNWANTED...`; tells only what is wrong.

NAME is a module, or a command with its words, which is to show its help.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import sys
from importlib.metadata import entry_points


def main() -> None:
    for question in sys.argv[1:]:
        asked, _, unwanted = question.partition(": ")
        name, *words = asked.split()
        if name.startswith("ronna-"):
            if "Usage:" not in help_of(name, *words):
                print(asked, "shows no help")
        else:
            importlib.import_module(name)
        if found := set(unwanted.split()) & set(sys.modules):
            print(asked, "imports", *sorted(found))


def help_of(name: str, *words: str) -> str:
    """What its console script shows."""
    (script,) = entry_points(group="console_scripts", name=name)
    sys.argv = [name, *words, "--help"]
    shown = io.StringIO()
    with contextlib.redirect_stdout(shown):
        try:
            script.load()()
        except SystemExit as end:
            if end.code:
                raise
    return shown.getvalue()


if __name__ == "__main__":
    main()

"""The truth of a simulated theatre, hashed during a run, so that replacing it before the end is detected.

The first line of the journal and every result state the length of its files and their hashes so far. The
scene is constant, and samples are added only while a step runs.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from ronna_hw.evidence.journal_reading import Entry, JournalValue, Line
from ronna_hw.host.regular_file import open_regular

TRUTH_FILES = ("theatre/scene.json", "theatre/truth.jsonl")  # small
GROWING = TRUTH_FILES[1:]
LARGEST_BYTES = 10_000_000  # ten times what the verifier reads
FIELD = "truth"  # of a line: name -> [bytes, SHA-256]


def truth_so_far(folder: Path) -> dict[str, JournalValue]:
    """The field of a line; empty for a run without a simulated theatre."""
    known: dict[str, JournalValue] = {}
    for name in TRUTH_FILES:
        with contextlib.suppress(OSError), open_regular(folder / name) as file:
            content = file.read(LARGEST_BYTES)
            known[name] = [len(content), hashlib.sha256(content).hexdigest()]
    return {FIELD: known} if known else {}


def unlike_truth(folder: Path, lines: Sequence[Line]) -> Iterator[tuple[str, str]]:
    """Files of a run that do not match its lines, and how."""
    for name in journalled_truth(lines):
        try:
            with open_regular(folder / name) as file:
                content = file.read(LARGEST_BYTES + 1)
        except FileNotFoundError:
            yield name, "missing"
        except OSError as error:
            yield name, f"replaced, or cannot be read: {error.strerror}"
        else:
            if what := unlike_content(name, content, lines):
                yield name, what


def unlike_content(name: str, content: bytes, lines: Sequence[Line]) -> str:
    """How the content of such a file does not match the lines; empty if it does, or they do not name it."""
    if name not in (known := journalled_truth(lines)):
        return ""
    size, sha256, number = known[name]
    if len(content) < size or hashlib.sha256(content[:size]).hexdigest() != sha256:
        return "changed"
    if len(content) > size and not (name in GROWING and _begun(lines[number + 1 :])):
        return "continues beyond the journal, and no step was running"
    return ""


def journalled_truth(lines: Sequence[Line]) -> dict[str, tuple[int, str, int]]:
    """Length and hash of each file according to the last line that states them, and that line's number."""
    known: dict[str, tuple[int, str, int]] = {}
    for number, line in enumerate(lines):
        field = line.get(FIELD)
        for name, value in field.items() if isinstance(field, Mapping) else ():
            match value:
                case [int(length), str(sha256)] if name in TRUTH_FILES and length >= 0:
                    known[name] = (int(length), sha256, number)
    return known


def _begun(lines: Sequence[Line]) -> bool:
    return any(line["entry"] in (Entry.INTENT, Entry.RESTARTED) for line in lines)

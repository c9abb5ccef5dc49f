"""Updates of a theatre file in place, and its history: each earlier state, who changed it, when and by what.

FOLDER/theatre.toml               the theatre file, updated atomically
FOLDER/theatre.toml.history       lines for each update, with the file as it became

The history is written first and locked for the whole update, so two updates follow one another and neither is
lost. A run records the hash of its theatre file; the history says which state that was, and can restore it.
The lines are those of `theatre_history_file`.
"""

from __future__ import annotations

import fcntl
import getpass
import os
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from procedures.runs.theatre_history_file import CarriedOut, Update, append, hash_bytes, read_history
from ronna_hw.bounded_input import LARGEST_TOML_BYTES, parse_toml_bytes, read_bounded
from ronna_hw.config import BadTheatreFile, parse_theatre
from ronna_hw.records import write_atomically

SUFFIX = ".history"
Tables = dict[str, dict[str, object]]


@dataclass(frozen=True)
class UpdateAuthor:
    """Author of an update: the person, the command and the calibration behind it."""

    command: str
    by: str = ""
    source: str = ""


@dataclass(frozen=True)
class TheatreState:
    """A state of a theatre file. `update` led to it, except to the first and to one edited by hand."""

    number: int
    sha256: str
    text: str
    update: Update | None


def history_path(theatre: Path) -> Path:
    """Return the path of a theatre file's history."""
    theatre = theatre.resolve()
    return theatre.with_name(theatre.name + SUFFIX)


def update_tables(theatre: Path, tables: Tables, signature: UpdateAuthor) -> None:
    """Put new entries into a theatre file's tables, keeping its comments.

    Raises CFG-001 without writing anything if the file would be invalid, PRO-046 if its history was changed.
    """

    from procedures.runs.theatre_tables import replace_tables  # few commands update: the others start sooner

    def change(content: bytes) -> bytes:
        text = content.decode("utf-8-sig").replace("\r\n", "\n")
        return replace_tables(text, tables).encode()

    with _locked(theatre) as history:
        _replace(theatre, history, change, signature)


def restore(theatre: Path, state: TheatreState, signature: UpdateAuthor) -> None:
    """Put an earlier state of a theatre file back in force, byte for byte, as an update of its own."""
    with _locked(theatre) as history:
        _replace(theatre, history, lambda _content: state.text.encode(), signature)


@contextmanager
def _locked(theatre: Path) -> Iterator[int]:
    file = os.open(history_path(theatre), os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o664)
    try:
        fcntl.flock(file, fcntl.LOCK_EX)  # an update takes milliseconds
        yield file
    finally:
        os.close(file)


def _replace(theatre: Path, history: int, change: Callable[[bytes], bytes], signature: UpdateAuthor) -> None:
    theatre = theatre.resolve()
    content = read_bounded(theatre, LARGEST_TOML_BYTES)
    before = parse_toml_bytes(content, theatre.name, BadTheatreFile)
    new = change(content)
    if new == content:
        return
    after = parse_toml_bytes(new, theatre.name, BadTheatreFile)
    parse_theatre(after, f"{theatre.name} with the update")
    path = history_path(theatre)
    account, earlier = getpass.getuser(), read_history(path)
    is_known = bool(earlier.updates) and earlier.updates[-1].sha256_after == hash_bytes(content)
    size = os.fstat(history).st_size
    written = append(
        history,
        path,
        Update(
            time=_format_now(),
            by=signature.by or account,
            account=f"{account}@{socket.gethostname()}",
            command=signature.command,
            source=signature.source,
            changes=tuple(_describe_changes(before, after)),
            sha256_before=hash_bytes(content),
            sha256_after=hash_bytes(new),
            former=None if is_known else content.decode(),
            text=new.decode(),
            previous=earlier.end_sha256,
        ),
    )
    mode = theatre.stat().st_mode
    try:
        write_atomically(theatre, new)
        theatre.chmod(mode)
    except BaseException:  # an interruption too must not leave the line of an update that never was
        if read_bounded(theatre, LARGEST_TOML_BYTES) == content:
            os.ftruncate(history, size)  # nothing came of it
        raise
    with suppress(OSError):  # the update is in force; without this line the file's hash says so
        append(history, path, CarriedOut(carried_out=_format_now(), previous=written))


def _format_now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _describe_changes(before: dict[str, object], after: dict[str, object]) -> Iterator[str]:
    """Describe each changed table, for records with the identifiers of the former and the new one."""
    for name in sorted(before.keys() | after.keys()):
        then, now = before.get(name), after.get(name)
        if then == now:
            continue
        if name not in ("calibration", "tools"):
            yield name
            continue
        then, now = (entries if isinstance(entries, dict) else {} for entries in (then, now))
        for key in sorted(then.keys() | now.keys()):
            if then.get(key) != now.get(key):
                former, new = _identifier(then.get(key)), _identifier(now.get(key))
                yield f"{name}.{key}: {former} -> {new if new != former else 'the same with other values'}"


def _identifier(record: object) -> str:
    return str(record.get("identifier", "unnamed")) if isinstance(record, dict) else "none"


def read_states(theatre: Path) -> tuple[TheatreState, ...]:
    """Return every known state of a theatre file, oldest first; the last is the present one.

    An update that was in force stays listed, whatever became of the file since. Left out are those cut off
    before the file was replaced. Raises PRO-046 if the history was changed.
    """
    theatre = theatre.resolve()
    present = read_bounded(theatre, LARGEST_TOML_BYTES)
    history = read_history(history_path(theatre))
    followed_by = [*(one.sha256_before for one in history.updates), hash_bytes(present)][1:]
    states: list[TheatreState] = []

    def add(text: str, sha256: str, update: Update | None = None) -> None:
        if update is not None or not states or states[-1].sha256 != sha256:
            states.append(TheatreState(len(states), sha256, text, update))

    for index, (update, next_sha256) in enumerate(zip(history.updates, followed_by, strict=True)):
        if index not in history.carried_out and next_sha256 == update.sha256_before:
            continue
        if update.former is not None:
            add(update.former, update.sha256_before)
        add(update.text, update.sha256_after, update)
    add(present.decode(), hash_bytes(present))
    return tuple(states)


def describe_updates_since(theatre: Path, sha256: str) -> str | None:
    """Describe how a theatre file was updated since it had this hash, or None if it has it still."""
    states = read_states(theatre)
    if states[-1].sha256 == sha256:
        return None
    number = find_state(states, sha256)
    if number is None:
        return f"{theatre.name} is not as it was, and its history does not know that state"
    said = "; ".join(describe_state(one) for one in states[number + 1 :])
    return f"{theatre.name} was updated since its state {number}: {said}"


def find_state(states: Sequence[TheatreState], sha256: str) -> int | None:
    """Return the number of the latest state with this hash, or None."""
    return next((one.number for one in reversed(states) if one.sha256 == sha256), None)


def describe_state(state: TheatreState) -> str:
    """Describe what led to a state, on one line."""
    if state.update is None:
        return "as first known" if state.number == 0 else "edited by hand"
    update = state.update
    return f"{update.time}, {update.by}, {update.command}: {', '.join(update.changes)}"

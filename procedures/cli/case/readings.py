"""Readings of scales and dials, typed at the terminal: several on a line, or one by one."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from procedures.cli.case.operators import LEAVING, Alarms, WritePrompt, read_typed, say_line
from procedures.operator.question import HELP, NOBODY, YES, Task, join_answers, misread, pick_answer
from ronna_hw.text import parse_typed_number

AGAIN = "again"
UNIT = "mm"  # of every reading; it may be typed with the number
SMALL_MM = 0.01  # as a dial shows it
SEPARATORS = ";\t"  # besides spaces; a comma may be a decimal one

Range = tuple[float, float] | None


def read_values(write: WritePrompt, task: Task, alarms: Alarms) -> tuple[float, ...]:
    """Read and return the task's values, confirmed if there are several; empty if nobody reads them."""
    while True:
        readings: list[float] = []
        ahead = False  # of several pasted lines, those after one that is refused are discarded
        while missing := task.reads[len(readings) :]:
            typed = read_typed(write, join_reads(missing), None, alarms, ahead)
            if not typed or pick_answer(typed, (NOBODY,)) is not None:
                return ()
            if pick_answer(typed, (HELP,)) is not None:
                _explain(task, len(missing))
                continue
            if pick_answer(typed, (AGAIN,)) is not None:
                readings, ahead = [], False
                say_line("Type all of them again." if len(task.reads) > 1 else "Type it.")
                continue
            found = _parse_line(typed, len(missing), task.plausible_mm)
            ahead = found is not None
            readings += found or ()
        if len(readings) == 1:
            return tuple(readings)
        for what, number in zip(task.reads, readings, strict=True):
            say_line(f"  {what}: {number:g}")
        if (answer := _confirm(write, alarms)) != AGAIN:
            return tuple(readings) if answer == YES else ()


def _confirm(write: WritePrompt, alarms: Alarms) -> str:
    """Return whether the readings shown are right or to be typed again; empty if the input has ended."""
    while typed := read_typed(write, join_answers((YES, AGAIN)), None, alarms):
        if (answer := pick_answer(typed, (YES, AGAIN))) is not None:
            return answer
        meaning = f"{YES} if these are the readings, {AGAIN} to type them all again."
        if pick_answer(typed, (HELP,)) is not None:
            say_line(f"Type {meaning} {LEAVING}.")
        else:
            say_line(f"{typed!r} is not an answer: {meaning}")
    return ""


def _explain(task: Task, missing: int) -> None:
    """Write what can be typed for the readings that are missing."""
    say_line(f"Type {_hint(missing, task.plausible_mm)}")
    if len(task.reads) > 1:
        say_line(f"{AGAIN!r} discards what was typed and begins with {task.reads[0]}.")
    say_line(f"{LEAVING}.")


def _parse_line(typed: str, most: int, plausible_mm: Range) -> list[float] | None:
    """Return the numbers of a line, or None after saying what is wrong with it."""
    words = _split(typed)
    if len(words) > most:
        say_line(f"{len(words)} readings were typed: type {_hint(most, plausible_mm)}")
        return None
    numbers: list[float] = []
    for word in words:
        number = None
        with suppress(ValueError):
            number = parse_typed_number(word, UNIT)
        if number is None:
            say_line(f"{word!r} is not a reading: type {_hint(most, plausible_mm)}")
            return None
        if wrong := misread(number, plausible_mm):
            say_line(f"{wrong}; type {_hint(most, plausible_mm)}")
            return None
        numbers.append(number)
    return numbers


def _split(typed: str) -> list[str]:
    """Split a line into readings; a word that is no number belongs to the reading before it, as a unit."""
    words: list[str] = []
    for word in typed.translate(str.maketrans(SEPARATORS, " " * len(SEPARATORS))).split():
        bare = word.rstrip(",") or word
        if words and not any(character.isdigit() for character in bare):
            words[-1] += f" {bare}"
        else:
            words.append(bare)
    return words or [typed]


def _hint(most: int, plausible_mm: Range) -> str:
    """Return the expected format of the readings, with a plausible example."""
    low, high = plausible_mm or (0.0, SMALL_MM)
    one = f"{SMALL_MM if low <= SMALL_MM <= high else round(0.5 * (low + high)):g}"
    if most == 1:
        return f"one number in mm, such as {one} or {one} mm, or {NOBODY!r} to end the step."
    example = " ".join([one] * most)
    return (
        f"up to {most} numbers in mm, with spaces between: such as {example}, or {NOBODY!r} to end the step."
    )


def join_reads(reads: Sequence[str]) -> str:
    """Join the names of readings: what they begin and end with alike is said once.

    `dial x in mm` and `dial y in mm` become `dial x and y in mm`.
    """
    if len(reads) < 2:
        return "".join(reads)
    words = [name.split() for name in reads]
    shortest = min(map(len, words)) - 1
    before = _alike(words, shortest)
    after = _alike([each[::-1] for each in words], shortest - before)
    own = [" ".join(each[before : len(each) - after]) for each in words]
    first = words[0]
    ends = first[len(first) - after :]
    return " ".join([*first[:before], f"{', '.join(own[:-1])} and {own[-1]}", *ends])


def _alike(words: Sequence[Sequence[str]], most: int) -> int:
    """Length of the common prefix, at most `most`."""
    for count in range(most):
        if len({each[count] for each in words}) > 1:
            return count
    return most

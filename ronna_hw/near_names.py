"""Names that are nearly right: what to suggest for a mistyped option, name or value.

Every message that refuses a name asks here, so that all suggest alike.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

LONGEST_COMPARED = 200  # characters: comparing takes the square of the length
LEAST_ALIKE = 0.6  # of 1, as difflib measures it


def find_near(
    name: str, known: Iterable[str], count: int = 1, *, least_alike: float = LEAST_ALIKE
) -> list[str]:
    """Return up to `count` known names most like the one given, ignoring case; the most alike first."""
    by_fold = {one.casefold(): one for one in known}
    near = get_close_matches(name[:LONGEST_COMPARED].casefold(), by_fold, count, least_alike)
    return [by_fold[one] for one in near]


def did_you_mean(name: str, known: Iterable[str], count: int = 1) -> str:
    """Return the known names most like the one given as a question, or an empty string if none is alike."""
    near = find_near(name, known, count)
    return f"Did you mean {' or '.join(near)}?" if near else ""

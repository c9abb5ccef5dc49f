"""A figure and the limit that refuses it, formatted so that it is visible on which side the figure is."""

from __future__ import annotations

MOST_MORE = 6  # decimals; a value still indistinguishable from the limit equals it


def beyond(value: float, limit: float, decimals: int) -> str:
    """The value with this many decimals, or as many more as needed to show its side of a limit shown in full.

    `beyond(0.1504, 0.15, 2)` is `0.1504`: "limit 0.15 mm, got 0.15 mm" would say nothing.
    """
    for more in range(MOST_MORE):
        shown = round(value, decimals + more)
        if (shown > limit) == (value > limit) and shown != limit:
            return f"{value:.{decimals + more}f}"
    return f"{value:.{decimals}f}"


def side_by_side(value: float, limit: float, decimals: int) -> tuple[str, str]:
    """The value and a computed limit, each with this many decimals, or as many more as distinguish them."""
    for more in range(MOST_MORE):
        shown, refused_from = (f"{one:.{decimals + more}f}" for one in (value, limit))
        if shown != refused_from:
            return shown, refused_from
    return f"{value:.{decimals}f}", f"{limit:.{decimals}f}"

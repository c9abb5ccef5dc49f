"""A figure that a limit refuses, so that the reader sees that it is beyond it."""

from __future__ import annotations

MOST_MORE = 6  # decimals; what is then still the limit equals it


def beyond(value: float, limit: float, decimals: int) -> str:
    """The value with so many decimals, or with as many more as tell it apart from the limit.

    `beyond(0.1504, 0.15, 2)` is `0.1504`: "limit 0.15 mm, got 0.15 mm" would say nothing.
    """
    shown = round(limit, decimals)
    for more in range(MOST_MORE):
        if round(value, decimals + more) != shown:
            return f"{value:.{decimals + more}f}"
    return f"{value:.{decimals}f}"

"""The few SVG elements that the figures need: rectangles, lines and text on a canvas of fixed width.

The canvas is as wide as a phone's screen, so that its text is readable there in portrait, and scales
with the page elsewhere.
"""

from __future__ import annotations

from html import escape
from typing import Literal

WIDTH = 420.0  # user units, equal to CSS pixels on a phone
TEXT_SIZE = 11.0


class Canvas:
    """Collects shapes from the top down; `svg` is the finished picture."""

    def __init__(self, height: float, title: str) -> None:
        self._height = height
        self._title = title
        self._shapes: list[str] = []

    def rectangle(
        self, x: float, y: float, width: float, height: float, fill: str, *, title: str = ""
    ) -> None:
        """A filled rectangle; `title` is shown on hover."""
        inside = f"<title>{escape(title)}</title>" if title else ""
        self._shapes.append(
            f'<rect x="{x:.2f}" y="{y:.2f}" width="{max(width, 0.0):.2f}" height="{height:.2f}" '
            f'fill="{fill}">{inside}</rect>'
        )

    def line(self, x1: float, y1: float, x2: float, y2: float, stroke: str) -> None:
        """A thin line."""
        self._shapes.append(
            f'<line x1="{x1:.2f}" y1="{y1:.2f}" x2="{x2:.2f}" y2="{y2:.2f}" stroke="{stroke}"/>'
        )

    def text(
        self, x: float, y: float, words: str, *, anchor: Literal["start", "middle", "end"] = "start"
    ) -> None:
        """Text with its baseline at y."""
        self._shapes.append(f'<text x="{x:.2f}" y="{y:.2f}" text-anchor="{anchor}">{escape(words)}</text>')

    @property
    def svg(self) -> str:
        """The picture, as a standalone file or embedded in a page."""
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {self._height:g}" role="img" '
            f'font-family="system-ui, sans-serif" font-size="{TEXT_SIZE:g}">'
            f"<title>{escape(self._title)}</title>{''.join(self._shapes)}</svg>"
        )

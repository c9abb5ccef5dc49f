"""The three CT planes through a target, side by side, or one below the other where the page is narrow."""

from __future__ import annotations

from procedures.imaging.trajectory_cuts import PLANES

# One picture holds the planes, as squares from left to right: style.css shows one of them in each image.
SHOWN = ("first", "second", "third")


def ct_planes(address: str, caption: str, *, is_lazy: bool = False) -> str:
    """Show the planes of the picture at an address. Both arguments must be escaped."""
    loading = ' loading="lazy"' if is_lazy else ""
    images = (
        f'<img class="{place}" src="{address}" alt="{caption}, {title}"{loading}>'
        for place, (title, *_) in zip(SHOWN, PLANES, strict=True)
    )
    return f'<div class="planes">{"".join(images)}</div>'

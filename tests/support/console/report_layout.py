"""How much room a report takes on a phone and on paper, and what of it cannot be seen there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from page_reading import low_contrast

PHONE_PX = {"width": 390, "height": 844}
MOST_SCREENS, MOST_PAGES = 12, 6
OPEN = "document.querySelectorAll('details').forEach(one => one.open = true)"
HIDDEN = """
() => [...document.querySelectorAll("table, td, th, pre, svg, img, p, li")]
  .filter(e => e.checkVisibility({contentVisibilityAuto: true}))
  .filter(e => e.getBoundingClientRect().right > innerWidth + 1
    || getComputedStyle(e).display !== "inline" && e.clientWidth && e.scrollWidth > e.clientWidth + 1)
  .map(e => `${e.tagName} ${e.textContent.slice(0, 60)}`)
"""


def hidden_by_width(page: Any) -> list[str]:
    """What reaches beyond its frame or the page, and how much wider than its window the page is."""
    over = page.evaluate("document.documentElement.scrollWidth - innerWidth")
    return [*([f"page wider by {over} px"] if over > 0 else []), *page.evaluate(HIDDEN)]


def count_pages(page: Any) -> int:
    """How many sheets of paper the page takes, on the paper that its style names."""
    return len(re.findall(rb"/Type\s*/Page\b", page.pdf(prefer_css_page_size=True)))


def misfits(page: Any, report: Path) -> list[str]:
    """What is wrong with a report on a phone, folded and opened, in both schemes, and on paper."""
    found = []
    page.set_viewport_size(PHONE_PX)
    page.goto(report.as_uri())
    screens = page.evaluate("document.documentElement.scrollHeight") / PHONE_PX["height"]
    if screens > MOST_SCREENS:
        found.append(f"{screens:.1f} screens")
    pages = count_pages(page)
    if not 0 < pages <= MOST_PAGES:
        found.append(f"{pages} pages")
    found += hidden_by_width(page)
    page.evaluate(OPEN)
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        found += hidden_by_width(page) + [f"{scheme}: {one}" for one in low_contrast(page)]
    return found

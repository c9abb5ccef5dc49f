"""Driver for optical trackers whose tools an OpenIGTLink server sends, such as PLUS.

`OpenIGTLinkTracker` is resolved on first use, so that the other modules can be imported without the driver.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ronna_hw.lazy_names import resolve_lazily

if TYPE_CHECKING:
    from drivers.openigtlink_tracker.driver import OpenIGTLinkTracker

__all__ = ["OpenIGTLinkTracker"]

__getattr__ = resolve_lazily(__name__, __all__, ("driver",))

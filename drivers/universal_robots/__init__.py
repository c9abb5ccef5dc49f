"""Driver for Universal Robots UR5 and UR5e: set-points by RTDE in a separate process, the rest by dashboard.

`UniversalRobotsArm` is resolved on first use, so that the real-time process does not import what only the
driver needs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ronna_hw.lazy_names import resolve_lazily

if TYPE_CHECKING:
    from drivers.universal_robots.arm import UniversalRobotsArm

__all__ = ["UniversalRobotsArm"]

__getattr__ = resolve_lazily(__name__, __all__, ("arm",))

"""Driver for KUKA KR C4: motion by RSI over UDP in a separate process, everything else by EKI over TCP.

`KukaRsiArm` is resolved on first use, so that the real-time process does not import what
only the driver needs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ronna_hw.lazy_names import resolve_lazily

if TYPE_CHECKING:
    from drivers.kuka_rsi.arm import KukaRsiArm

__all__ = ["KukaRsiArm"]

__getattr__ = resolve_lazily(__name__, __all__, ("arm",))

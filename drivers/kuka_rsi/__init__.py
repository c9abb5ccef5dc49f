"""KUKA KR C4: RSI over UDP in a process of its own, EKI over TCP for everything that is not motion.

`KukaRsiArm` is resolved on first use: the real-time process does not import what only the driver needs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.kuka_rsi.arm import KukaRsiArm

__all__ = ["KukaRsiArm"]


def __getattr__(name: str) -> Any:
    if name == "KukaRsiArm":
        from drivers.kuka_rsi.arm import KukaRsiArm

        return KukaRsiArm
    raise AttributeError(name)

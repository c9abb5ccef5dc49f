"""Driver for two Basler cameras over GigE Vision; needs no vendor library and no root privileges.

`BaslerStereoPair` is resolved on first use, so that the receiver process does not import what
only the driver needs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ronna_hw.lazy_names import resolve_lazily

if TYPE_CHECKING:
    from drivers.basler_stereo.pair import BaslerStereoPair

__all__ = ["BaslerStereoPair"]

__getattr__ = resolve_lazily(__name__, __all__, ("pair",))

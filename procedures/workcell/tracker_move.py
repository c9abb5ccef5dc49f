"""Move of the tracker since the localization, as a case has followed it.

It is journalled: a resumed case must expect everything where the pushed tracker sees it, also with the arm in
a pose in which the frame on it tells nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from procedures.journal.journal import JournalValue, Line
from procedures.journal.results import FramedPose
from ronna_hw.frames import Frame, Transform

STILL: Final = Transform.of(Frame.TRACKER, Frame.TRACKER)


@dataclass(frozen=True)
class TrackerMove:
    """`move` is TRACKER now <- TRACKER at the localization.

    `unnoticed_mm` is the rms of the moves of the head that the pushes may have hidden.
    """

    move: Transform = STILL
    unnoticed_mm: float = 0.0

    def then(self, push: Transform, unnoticed_mm: float = 0.0) -> TrackerMove:
        """Return the move after a further one, seen by the tracker as it was at the localization."""
        return TrackerMove(self.move @ push, math.hypot(self.unnoticed_mm, unnoticed_mm))

    def as_plain(self, localization: str) -> dict[str, JournalValue]:
        """Return plain values for the journal, with the record of the localization."""
        return {
            "localization": localization,
            "move": FramedPose.of(self.move).model_dump(mode="json"),
            "unnoticed_mm": self.unnoticed_mm,
        }

    @classmethod
    def from_plain(cls, line: Line) -> tuple[str, TrackerMove]:
        """Read the localization and the move. Raises LookupError, TypeError or ValueError if malformed."""
        move = FramedPose.model_validate(line["move"]).transform
        return str(line["localization"]), cls(move, float(str(line["unnoticed_mm"])))


UNPUSHED: Final = TrackerMove()

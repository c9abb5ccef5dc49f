"""Move of the tracker since the localization, as a case has followed it.

It is journalled: a resumed case must expect everything where the pushed tracker sees it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from procedures.journal.journal import JournalValue, Line
from procedures.journal.results import FramedPose
from ronna_hw.frames import Frame, Transform

STILL: Final = Transform.of(Frame.TRACKER, Frame.TRACKER)


@dataclass(frozen=True)
class TrackerMove:
    """`move` is TRACKER now <- TRACKER at the localization, by that many `pushes`."""

    move: Transform = STILL
    pushes: int = 0

    def then(self, push: Transform) -> TrackerMove:
        """Return the move after a further one, seen by the tracker as it was at the localization."""
        return TrackerMove(self.move @ push, self.pushes + 1)

    def as_plain(self, localization: str) -> dict[str, JournalValue]:
        """Return plain values for the journal, with the record of the localization."""
        return {
            "localization": localization,
            "move": FramedPose.of(self.move).model_dump(mode="json"),
            "pushes": self.pushes,
        }

    @classmethod
    def from_plain(cls, line: Line) -> tuple[str, TrackerMove]:
        """Read the localization and the move. Raises LookupError, TypeError or ValueError if malformed."""
        move = FramedPose.model_validate(line["move"]).transform
        return str(line["localization"]), cls(move, int(str(line.get("pushes", 1))))


UNPUSHED: Final = TrackerMove()

"""The best place of a map, checked by itself, and how far off it still serves."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Any

from procedures.planning.cart.cart_case import CartMove, Verdict
from procedures.planning.cart.place_map import FINEST_MM, Judge, PlaceMap
from procedures.planning.errors import NoPlace

TURNS_DEG = (2.5, 5.0, 10.0, 15.0)  # tried either way at the best place


@dataclass(frozen=True, eq=False)
class PlaceProposal:
    """Where the cart should stand against the assumed place, and what it may be missed by.

    `free_mm` in any direction, `turns_deg` the other way and this; `assumed` is the verdict there.
    """

    best: CartMove
    free_mm: float
    turns_deg: tuple[float, float]
    places: PlaceMap

    @property
    def assumed(self) -> Verdict:
        """Of the place where the cart was assumed to stand."""
        return self.places.verdicts[(0, 0)]

    def as_payload(self) -> dict[str, Any]:
        """Plain values for a file or a script; rows of the map run along x, from the lowest y up."""
        places = self.places
        return {
            "best_mm": [self.best.x_mm, self.best.y_mm],
            "free_mm": self.free_mm,
            "turns_deg": list(self.turns_deg),
            "assumed_place_serves": self.assumed.serves,
            "within_mm": places.within_mm,
            "square_mm": FINEST_MM,
            "reachable_share": round(float(places.allowed.mean()), 4),
            "map": ["".join("#" if one else "." for one in row) for row in places.allowed.T],
            "judged": [
                {
                    "x_mm": i * FINEST_MM,
                    "y_mm": j * FINEST_MM,
                    "serves": verdict.serves,
                    **({} if verdict.serves else {"pose": verdict.pose, "reason": verdict.reason}),
                }
                for (i, j), verdict in sorted(places.verdicts.items())
            ],
        }


def propose_place(places: PlaceMap, judge: Judge) -> PlaceProposal:
    """The best place. Raises PLAN-020 when none serves."""
    found = places.best()
    if found is None:
        why = Counter(one.reason for one in places.verdicts.values() if one.reason)
        reason = f"; most often: {why.most_common(1)[0][0]}" if why else ""
        raise NoPlace(f"from no place within {places.within_mm:g} mm can the plan be done{reason}")
    best, free_mm = found
    turns = [(side, turn) for side in (-1.0, 1.0) for turn in TURNS_DEG]
    moves = [CartMove(best.x_mm, best.y_mm, math.radians(side * turn)) for side, turn in turns]
    verdicts = judge([(move, (), True) for move in (best, *moves)])
    if not verdicts[0].serves:
        raise NoPlace(f"the best place of the map does not serve: {verdicts[0].pose}: {verdicts[0].reason}")
    free = [0.0, 0.0]
    for number, side in enumerate((-1.0, 1.0)):
        for (one, turn), verdict in zip(turns, verdicts[1:], strict=True):
            if one == side:
                if not verdict.serves:
                    break
                free[number] = turn
    return PlaceProposal(best, free_mm, (free[0], free[1]), places)

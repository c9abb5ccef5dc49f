"""The best position of a map, checked directly, and its tolerance."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Any

from procedures.planning.cart.place import CartMove, Verdict
from procedures.planning.cart.place_map import FINEST_MM, Judge, PlaceMap
from procedures.planning.cart.proposed_place import TURNED_SHARE
from procedures.planning.errors import NoPlace

TURNS_DEG = (2.5, 5.0, 10.0, 15.0)  # tried either way, at the best position and around it
SIDES = ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))


@dataclass(frozen=True, eq=False)
class PlaceProposal:
    """Proposed offset of the cart from the assumed position, and its tolerance.

    `free_mm` in any direction; or half of that plus a further rotation by `turns_deg` (negative, positive).
    """

    best: CartMove
    free_mm: float
    turns_deg: tuple[float, float]
    places: PlaceMap

    @property
    def assumed(self) -> Verdict:
        """Verdict on the cart's assumed position, with the map's rotation."""
        return self.places.verdicts[(0, 0)]

    def as_payload(self) -> dict[str, Any]:
        """Plain values for a file or a script; rows of the map run along x, starting from the lowest y."""
        places = self.places
        return {
            "best_mm": [self.best.x_mm, self.best.y_mm],
            "turned_deg": round(math.degrees(self.best.turn_rad), 6),
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
    """The best position. Raises PLAN-020 when none serves."""
    found = places.best()
    if found is None:
        why = Counter(one.reason for one in places.verdicts.values() if one.reason)
        reason = f"; most frequent reason: {why.most_common(1)[0][0]}" if why else ""
        raise NoPlace(
            f"the plan cannot be carried out from any cart position within {places.within_mm:g} mm{reason}"
        )
    best, free_mm = found
    (verdict,) = judge([(best, (), True)])
    if verdict.found is None:
        raise NoPlace(f"the best position of the map does not work: {verdict.pose}: {verdict.reason}")
    free_deg = {-1.0: 0.0, 1.0: 0.0}  # by direction of rotation
    going = list(free_deg)
    for turn in TURNS_DEG:
        moves = [_beside(best, free_mm * TURNED_SHARE, way, side * turn) for side in going for way in SIDES]
        serving = [one.serves for one in judge([(move, (verdict.found,), True) for move in moves])]
        of_sides = [serving[first : first + len(SIDES)] for first in range(0, len(serving), len(SIDES))]
        going = [side for side, each in zip(going, of_sides, strict=True) if all(each)]
        free_deg |= dict.fromkeys(going, turn)
    return PlaceProposal(best, free_mm, (free_deg[-1.0], free_deg[1.0]), places)


def _beside(best: CartMove, way_mm: float, way: tuple[float, float], turn_deg: float) -> CartMove:
    x, y = way
    turn_rad = best.turn_rad + math.radians(turn_deg)
    return CartMove(best.x_mm + x * way_mm, best.y_mm + y * way_mm, turn_rad)

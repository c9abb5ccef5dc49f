"""The map: positions on a grid, refined where positions that serve meet positions that do not.

A square is reachable if all its corners serve; squares at the edge are halved twice. The map therefore errs
on the side of refusal, by half a finest square along its edge.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from procedures.planning.cart.place import CartMove, Found, Verdict

Node = tuple[int, int]
Judge = Callable[[Sequence[tuple[CartMove, tuple[Found, ...], bool]]], Sequence[Verdict]]

COARSE = 4  # finest squares along the side of a coarsest one
FINEST_MM = 15.0
HALF_DIAGONAL = math.sqrt(0.5)  # of a square: how much closer than its centre the edge of the next one may be
MOST_KNOWN = 3  # solutions from nearby that are tried before a position is refused


@dataclass(frozen=True, eq=False)
class PlaceMap:
    """Judged relative to the assumed position: `verdicts` by node, `allowed` (n, n) by square, x first.

    The cart is rotated by `turn_rad` from its assumed orientation everywhere.
    """

    half: int  # finest squares from the centre to the edge
    verdicts: dict[Node, Verdict]
    allowed: NDArray[np.bool_]
    turn_rad: float = 0.0

    @property
    def within_mm(self) -> float:
        """Extent of the map in each direction."""
        return self.half * FINEST_MM

    def allows(self, x_mm: float, y_mm: float) -> bool:
        """Whether the map calls a position reachable; none outside the map is."""
        i, j = (int(np.floor(value / FINEST_MM)) + self.half for value in (x_mm, y_mm))
        inside = 0 <= i < 2 * self.half and 0 <= j < 2 * self.half
        return inside and bool(self.allowed[i, j])

    def best(self) -> tuple[CartMove, float] | None:
        """The position farthest from any that does not serve, and its tolerance in mm; or None."""
        if not self.allowed.any():
            return None
        # nothing is known beyond the map
        room = ndimage.distance_transform_edt(np.pad(self.allowed, 1))[1:-1, 1:-1]
        centres = (np.indices(room.shape) - self.half + 0.5) * FINEST_MM
        away = np.hypot(*centres)
        most = room.max()
        place = np.unravel_index(np.argmin(np.where(room >= most - 0.5, away, np.inf)), room.shape)
        free_mm = (float(room[place]) - HALF_DIAGONAL) * FINEST_MM
        return CartMove(float(centres[0][place]), float(centres[1][place]), self.turn_rad), free_mm


@dataclass
class _Search:
    half: int
    judge: Judge
    turn_rad: float
    verdicts: dict[Node, Verdict] = field(default_factory=dict)

    def ask(self, nodes: Sequence[Node], known: Callable[[Node], tuple[Found, ...]], search: bool) -> None:
        new = [node for node in dict.fromkeys(nodes) if node not in self.verdicts]
        asked = [
            (CartMove(i * FINEST_MM, j * FINEST_MM, self.turn_rad), known((i, j)), search) for i, j in new
        ]
        self.verdicts.update(zip(new, self.judge(asked), strict=True))

    def known_at(self, nodes: Sequence[Node]) -> tuple[Found, ...]:
        found = [self.verdicts[node].found for node in nodes if node in self.verdicts]
        return tuple(dict.fromkeys(one for one in found if one is not None))[:MOST_KNOWN]


def map_places(
    within_mm: float,
    judge: Judge,
    progress: Callable[[float], None] = lambda share: None,
    turn_rad: float = 0.0,
) -> PlaceMap:
    """Judge positions up to `within_mm` from the assumed one in x and y; a whole number of coarse squares.

    With `turn_rad` the cart is rotated by that everywhere, about the z axis of its base,
    counter-clockwise from above.
    """
    coarse = max(1, round(within_mm / (COARSE * FINEST_MM)))
    half = coarse * COARSE
    search = _Search(half, judge, turn_rad)
    search.ask([(0, 0)], lambda node: (), True)
    progress(0.05)
    lines = range(-half, half + 1, COARSE)
    for ring in range(1, coarse + 1):  # outwards: what serves one position mostly serves the next
        far = ring * COARSE
        nodes = [(i, j) for i in lines for j in lines if max(abs(i), abs(j)) == far]
        known = {node: search.known_at([*_inward(node), (0, 0)]) for node in nodes}
        search.ask(nodes, known.__getitem__, True)
        progress(0.05 + 0.55 * (ring / coarse) ** 2)
    allowed = np.zeros((2 * half, 2 * half), dtype=bool)
    squares = [(i, j) for i in lines[:-1] for j in lines[:-1]]
    size = COARSE
    while squares:
        mixed = []
        for i, j in squares:
            serving = [search.verdicts[node].serves for node in _corners(i, j, size)]
            if all(serving):
                allowed[i + half : i + half + size, j + half : j + half + size] = True
            elif any(serving):
                mixed.append((i, j))
        if size == 1:
            break
        corners = {node: _corners(i, j, size) for i, j in mixed for node in _middles(i, j, size)}
        near = {node: search.known_at(around) for node, around in corners.items()}
        search.ask(list(corners), near.__getitem__, False)
        size //= 2
        squares = [(i + a, j + b) for i, j in mixed for a in (0, size) for b in (0, size)]
        progress(1.0 - 0.4 * (size - 1) / COARSE)
    return PlaceMap(half, search.verdicts, allowed, turn_rad)


def _inward(node: Node) -> list[Node]:
    """The inner neighbours on the coarsest grid, nearest first; outer ones are not judged yet."""
    i, j = node
    ways = [(a, b) for a in (-COARSE, 0, COARSE) for b in (-COARSE, 0, COARSE) if a or b]
    return [(i + a, j + b) for a, b in sorted(ways, key=lambda way: abs(way[0]) + abs(way[1]))]


def _corners(i: int, j: int, size: int) -> list[Node]:
    return [(i, j), (i + size, j), (i, j + size), (i + size, j + size)]


def _middles(i: int, j: int, size: int) -> list[Node]:
    half = size // 2
    return [(i + half, j), (i, j + half), (i + half, j + half), (i + size, j + half), (i + half, j + size)]

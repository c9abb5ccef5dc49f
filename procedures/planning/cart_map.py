"""Map of cart positions from which the plan can be executed, and choice of the best position.

Positions on a grid are judged in separate processes, refined where positions that serve meet others. A square
is reachable if all its corners serve; squares at the edge are halved twice. The map therefore errs on the
side of refusal, by half a finest square along its edge.
"""

from __future__ import annotations

import io
import math
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from scipy import ndimage

from procedures.planning.cart_place import CartCase, CartMove, PlaceSolution, PlaceVerdict
from procedures.planning.errors import NO_PLACE
from procedures.planning.proposed_place import TURNED_SHARE
from ronna_hw.arrays import Mask
from ronna_hw.host.worker_processes import collect_results, start_workers

Node = tuple[int, int]
Request = tuple[CartMove, tuple[PlaceSolution, ...], bool]  # position, known solutions, whether to search
Judge = Callable[[Sequence[Request]], Sequence[PlaceVerdict]]

COARSE = 4  # finest squares along the side of a coarsest one
FINEST_MM = 15.0
HALF_DIAGONAL = math.sqrt(0.5)  # of a square: how much closer than its centre the edge of the next one may be
MOST_KNOWN = 3  # solutions from nearby that are tried before a position is refused
CHUNK = 4  # positions per request: a request takes a millisecond, a position some tenths of a second
TURNS_DEG = (2.5, 5.0, 10.0, 15.0)  # tried either way, at the best position and around it
SIDES = ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
REACHABLE, REFUSED, BEST = "#bfe3c8", "#f1d3cf", "#1f6f8b"


@dataclass(frozen=True, eq=False)
class PlaceMap:
    """Map around the assumed position: `verdicts` by grid node, `allowed` (n, n) by square, x first.

    The cart is rotated by `turn_rad` from its assumed orientation everywhere.
    """

    half: int  # finest squares from the centre to the edge
    verdicts: dict[Node, PlaceVerdict]
    allowed: Mask
    turn_rad: float = 0.0

    @property
    def within_mm(self) -> float:
        """Half width of the map."""
        return self.half * FINEST_MM

    def allows(self, x_mm: float, y_mm: float) -> bool:
        """Return whether the map allows a position. Positions outside the map are not allowed."""
        i, j = (int(np.floor(value / FINEST_MM)) + self.half for value in (x_mm, y_mm))
        is_inside = 0 <= i < 2 * self.half and 0 <= j < 2 * self.half
        return is_inside and bool(self.allowed[i, j])

    def best(self) -> tuple[CartMove, float] | None:
        """Return the position farthest from unsuitable ones and its tolerance in mm, or None."""
        if not self.allowed.any():
            return None
        # nothing is known beyond the map
        room = ndimage.distance_transform_edt(np.pad(self.allowed, 1))[1:-1, 1:-1]
        centres = (np.indices(room.shape) - self.half + 0.5) * FINEST_MM
        distance = np.hypot(*centres)
        nearest = np.argmin(np.where(room >= room.max() - 0.5, distance, np.inf))
        place = np.unravel_index(nearest, room.shape)
        free_mm = (float(room[place]) - HALF_DIAGONAL) * FINEST_MM
        return CartMove(float(centres[0][place]), float(centres[1][place]), self.turn_rad), free_mm


@dataclass
class _Search:
    half: int
    judge: Judge
    turn_rad: float
    verdicts: dict[Node, PlaceVerdict] = field(default_factory=dict)

    def judge_nodes(
        self, nodes: Sequence[Node], known: Callable[[Node], tuple[PlaceSolution, ...]], search: bool
    ) -> None:
        unjudged = [node for node in dict.fromkeys(nodes) if node not in self.verdicts]
        moves = (CartMove(i * FINEST_MM, j * FINEST_MM, self.turn_rad) for i, j in unjudged)
        requests = [(move, known(node), search) for move, node in zip(moves, unjudged, strict=True)]
        self.verdicts.update(zip(unjudged, self.judge(requests), strict=True))

    def find_known(self, nodes: Sequence[Node]) -> tuple[PlaceSolution, ...]:
        found = [self.verdicts[node].found for node in nodes if node in self.verdicts]
        return tuple(dict.fromkeys(one for one in found if one is not None))[:MOST_KNOWN]


def map_places(
    within_mm: float,
    judge: Judge,
    progress: Callable[[float], None] = lambda share: None,
    turn_rad: float = 0.0,
) -> PlaceMap:
    """Judge positions up to `within_mm` from the assumed one in x and y, rounded to whole coarse squares.

    With `turn_rad` the cart is rotated by that everywhere, about the z axis of its base,
    counter-clockwise from above.
    """
    coarse = max(1, round(within_mm / (COARSE * FINEST_MM)))
    half = coarse * COARSE
    search = _Search(half, judge, turn_rad)
    search.judge_nodes([(0, 0)], lambda node: (), True)
    progress(0.05)
    lines = range(-half, half + 1, COARSE)
    for ring in range(1, coarse + 1):  # outwards: what serves one position mostly serves the next
        far = ring * COARSE
        nodes = [(i, j) for i in lines for j in lines if max(abs(i), abs(j)) == far]
        known = {node: search.find_known([*_inner_neighbours(node), (0, 0)]) for node in nodes}
        search.judge_nodes(nodes, known.__getitem__, True)
        progress(0.05 + 0.55 * (ring / coarse) ** 2)
    allowed = np.zeros((2 * half, 2 * half), dtype=bool)
    squares = [(i, j) for i in lines[:-1] for j in lines[:-1]]
    size = COARSE
    while squares:
        mixed = []
        for i, j in squares:
            serves_each = [search.verdicts[node].serves for node in _corners(i, j, size)]
            if all(serves_each):
                allowed[i + half : i + half + size, j + half : j + half + size] = True
            elif any(serves_each):
                mixed.append((i, j))
        if size == 1:
            break
        corners = {node: _corners(i, j, size) for i, j in mixed for node in _middles(i, j, size)}
        near = {node: search.find_known(around) for node, around in corners.items()}
        search.judge_nodes(list(corners), near.__getitem__, False)
        size //= 2
        squares = [(i + a, j + b) for i, j in mixed for a in (0, size) for b in (0, size)]
        progress(1.0 - 0.4 * (size - 1) / COARSE)
    return PlaceMap(half, search.verdicts, allowed, turn_rad)


def _inner_neighbours(node: Node) -> list[Node]:
    """Return the neighbours on the coarsest grid, nearest first."""
    i, j = node
    ways = [(a, b) for a in (-COARSE, 0, COARSE) for b in (-COARSE, 0, COARSE) if a or b]
    return [(i + a, j + b) for a, b in sorted(ways, key=lambda way: abs(way[0]) + abs(way[1]))]


def _corners(i: int, j: int, size: int) -> list[Node]:
    return [(i, j), (i + size, j), (i, j + size), (i + size, j + size)]


def _middles(i: int, j: int, size: int) -> list[Node]:
    half = size // 2
    return [(i + half, j), (i, j + half), (i + half, j + half), (i + size, j + half), (i + half, j + size)]


@contextmanager
def open_judge(case: CartCase, workers: int | None = None) -> Iterator[Judge]:
    """Provide a judge for many positions. `workers` 1 uses this process, None all processors.

    Raises PRC-001 when the processes halt.
    """
    count = workers or len(os.sched_getaffinity(0))
    if count == 1:
        yield partial(_judge, case)
        return
    with start_workers(count) as pool:

        def judge_in_processes(requests: Sequence[Request]) -> Sequence[PlaceVerdict]:
            parts = [requests[begin : begin + CHUNK] for begin in range(0, len(requests), CHUNK)]
            judged = collect_results([pool.submit(_judge, case, part) for part in parts])
            return [verdict for part in judged for verdict in part]

        yield judge_in_processes


def _judge(case: CartCase, requests: Sequence[Request]) -> list[PlaceVerdict]:
    return [case.judge(move, known, search=search) for move, known, search in requests]


@dataclass(frozen=True, eq=False)
class PlaceProposal:
    """Proposed offset of the cart from its assumed position, with tolerance.

    `free_mm` in any direction; or half of that plus a further rotation by `turns_deg` (negative, positive).
    """

    best: CartMove
    free_mm: float
    turns_deg: tuple[float, float]
    places: PlaceMap

    @property
    def assumed(self) -> PlaceVerdict:
        """Verdict on the cart's assumed position at the map's rotation."""
        return self.places.verdicts[(0, 0)]

    def as_payload(self) -> dict[str, Any]:
        """Return plain values for a file or script, with map rows along x from the lowest y."""
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
    """Propose the best position. Raises PLAN-020 if no position is suitable."""
    found = places.best()
    if found is None:
        reasons = Counter(one.reason for one in places.verdicts.values() if one.reason)
        reason = f"; most frequent reason: {reasons.most_common(1)[0][0]}" if reasons else ""
        raise NO_PLACE(
            f"the plan cannot be carried out from any cart position within {places.within_mm:g} mm{reason}"
        )
    best, free_mm = found
    (verdict,) = judge([(best, (), True)])
    if verdict.found is None:
        raise NO_PLACE(f"the best position of the map does not work: {verdict.pose}: {verdict.reason}")
    free_deg = {-1.0: 0.0, 1.0: 0.0}  # by direction of rotation
    free_sides = list(free_deg)
    for turn in TURNS_DEG:
        turns = [(side, way) for side in free_sides for way in SIDES]
        moves = [_shift_place(best, free_mm * TURNED_SHARE, way, side * turn) for side, way in turns]
        judged = judge([(move, (verdict.found,), True) for move in moves])
        refused = {side for (side, _), one in zip(turns, judged, strict=True) if not one.serves}
        free_sides = [side for side in free_sides if side not in refused]
        free_deg |= dict.fromkeys(free_sides, turn)
    return PlaceProposal(best, free_mm, (free_deg[-1.0], free_deg[1.0]), places)


def _shift_place(best: CartMove, step_mm: float, way: tuple[float, float], turn_deg: float) -> CartMove:
    x, y = way
    turn_rad = best.turn_rad + math.radians(turn_deg)
    return CartMove(best.x_mm + x * step_mm, best.y_mm + y * step_mm, turn_rad)


def draw_place(found: PlaceProposal, case: CartCase) -> bytes:
    """Draw an SVG of the reachable area, the assumed position, and the best position with its tolerance."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

    places, best = found.places, found.best
    figure = Figure(figsize=(6.0, 6.0))
    canvas = FigureCanvasSVG(figure)
    axes = figure.add_subplot(1, 1, 1)
    edge = places.within_mm
    axes.imshow(
        places.allowed.T,
        origin="lower",
        extent=(-edge, edge, -edge, edge),
        cmap=ListedColormap([REFUSED, REACHABLE]),
        vmin=0,
        vmax=1,
    )
    judged = np.array([(i * FINEST_MM, j * FINEST_MM, one.serves) for (i, j), one in places.verdicts.items()])
    for serves, mark in ((1.0, "+"), (0.0, "x")):
        chosen = judged[judged[:, 2] == serves]
        axes.scatter(chosen[:, 0], chosen[:, 1], marker=mark, s=12, linewidths=0.5, color="#5b6b73")
    axes.plot(0.0, 0.0, "o", color="#1c2b33", label="assumed base position")
    axes.plot(best.x_mm, best.y_mm, "*", markersize=12, color=BEST, label="best position")
    axes.add_patch(Circle((best.x_mm, best.y_mm), found.free_mm, fill=False, color=BEST))
    head = case.setting.robot_from_ct.apply(np.mean(case.fiducials_mm, axis=0))
    way = head[:2] / np.linalg.norm(head[:2])
    arrow = {"arrowstyle": "->", "color": "#1c2b33"}
    axes.annotate("", xy=tuple(way * edge), xytext=(0.0, 0.0), arrowprops=arrow)
    note = f"arrow: to the head, {np.linalg.norm(head[:2]):.0f} mm from the assumed position"
    axes.text(0.02, 0.02, note, transform=axes.transAxes, fontsize=8)
    axes.set_xlabel("x mm")
    axes.set_ylabel("y mm")
    axes.set_title("Base positions: in green ones the plan is reachable", fontsize=10)
    axes.legend(fontsize=8, loc="upper left")
    svg = io.BytesIO()
    canvas.print_svg(svg)
    return svg.getvalue()

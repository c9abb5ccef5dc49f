"""A picture of the map from above, in the assumed $ROBROOT."""

from __future__ import annotations

import io

import numpy as np

from procedures.planning.cart.place import CartCase
from procedures.planning.cart.place_map import FINEST_MM
from procedures.planning.cart.proposal import PlaceProposal

REACHABLE, REFUSED, BEST = "#bfe3c8", "#f1d3cf", "#1f6f8b"


def place_picture(found: PlaceProposal, case: CartCase) -> bytes:
    """An SVG: the reachable area, the assumed position, the best one and its tolerance."""
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

"""Proposed markers on the head, from the right, from the front and from above."""

from __future__ import annotations

import io
from collections.abc import Sequence

from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.planning.marker_sites import ProposedMarkers
from procedures.strategies.trajectory import Trajectory

DOTS_PER_INCH, SIZE_IN = 110, (10.0, 3.8)
VIEWS = (  # title, axis across, axis upwards, and which of the two are reversed
    ("from the right", 1, 2, (True, False)),
    ("from the front", 0, 2, (False, False)),
    ("from above", 0, 1, (True, True)),
)


def marker_picture(
    proposed: ProposedMarkers, head: HeadEllipsoid, trajectories: Sequence[Trajectory]
) -> bytes:
    """PNG: the head's ellipsoid, numbered markers, and each trajectory. LPS, mm."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Ellipse

    figure = Figure(figsize=SIZE_IN, layout="constrained")
    for axes, (title, across, up, (leftwards, downwards)) in zip(
        figure.subplots(1, len(VIEWS)), VIEWS, strict=True
    ):
        middle = head.centre_mm[across], head.centre_mm[up]
        size = 2.0 * head.semi_axes_mm[across], 2.0 * head.semi_axes_mm[up]
        axes.add_patch(Ellipse(middle, *size, fill=False, color="grey"))
        for one in trajectories:
            ends = one.entry_mm, one.target_mm
            axes.plot([end[across] for end in ends], [end[up] for end in ends], "-", color="C0")
            axes.annotate(one.identifier, (one.target_mm[across], one.target_mm[up]), color="C0")
        for number, centre in enumerate(proposed.centres_mm, start=1):
            axes.plot(centre[across], centre[up], "o", color="C3")
            axes.annotate(str(number), (centre[across], centre[up]), color="C3")
        axes.set_title(title)
        axes.set_aspect("equal")
        if leftwards:
            axes.invert_xaxis()
        if downwards:
            axes.invert_yaxis()
        axes.set_xlabel("xyz"[across] + " mm")
        axes.set_ylabel("xyz"[up] + " mm")
    FigureCanvasAgg(figure)
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=DOTS_PER_INCH)
    return content.getvalue()

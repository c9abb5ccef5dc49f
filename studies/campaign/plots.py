"""Study plots as PNG bytes. Matplotlib is imported only when a plot is drawn."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from studies.campaign.bounds import CAPTION, Bounded

DOTS_PER_INCH = 110
SIZE_IN = (6.4, 4.0)
BAND_ALPHA = 0.15  # of the bounds about a curve
LEGEND = f"{CAPTION} bounds"
PANEL_IN = 2.6  # of points
MARKER_POINTS, POINT_ALPHA = 3, 0.35
CAP_POINTS = 2  # width of the ends of a bar's bounds

Point = tuple[float, float | Bounded]
Curve = Sequence[Point]


def curves(
    title: str,
    x_label: str,
    y_label: str,
    lines: Mapping[str, Curve],
    *,
    bands: Mapping[str, tuple[float, float]] | None = None,
) -> bytes:
    """Plot labelled curves with their bounds as bands, over optional labelled ranges of the x axis."""
    figure, axes = _make_figure(title, x_label, y_label)
    _draw_curves(axes, lines, bands or {})
    return encode_png(figure)


def curve_panels(title: str, x_label: str, panels: Mapping[str, Mapping[str, Curve]]) -> bytes:
    """Plot labelled curves in panels above one x axis, one panel for each label of a y axis."""
    figure, first = _make_figure(title, "", next(iter(panels)), rows=len(panels))
    every = [
        first,
        *(figure.add_subplot(len(panels), 1, 1 + row, sharex=first) for row in range(1, len(panels))),
    ]
    for axes, (y_label, lines) in zip(every, panels.items(), strict=True):
        axes.set_ylabel(y_label)
        _draw_curves(axes, lines, {})
    every[-1].set_xlabel(x_label)
    return encode_png(figure)


def _draw_curves(axes: Any, lines: Mapping[str, Curve], bands: Mapping[str, tuple[float, float]]) -> None:
    for name, points in lines.items():
        places, values = [x for x, _ in points], _list_bounded(points)
        (line,) = axes.plot(places, [one.value for one in values], marker=".", label=name)
        axes.fill_between(
            places,
            *zip(*map(_bounds_or_value, values), strict=True),
            color=line.get_color(),
            alpha=BAND_ALPHA,
            lw=0,
        )
    if any(
        _bounds_or_value(one)[0] < _bounds_or_value(one)[1]
        for points in lines.values()
        for one in _list_bounded(points)
    ):
        axes.fill_between([], [], [], color="grey", alpha=BAND_ALPHA, lw=0, label=LEGEND)
    for shade, (name, (left, right)) in enumerate(bands.items(), start=1):
        axes.axvspan(left, right, color="grey", alpha=0.12 * shade, label=name)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)


def bars(
    title: str,
    y_label: str,
    groups: Mapping[str, Mapping[str, float | Bounded]],
    *,
    logarithmic: bool = False,
    x_label: str = "",
) -> bytes:
    """Plot grouped bars (group -> series -> value), with bounds as whiskers.

    A zero count has no bar: a downward triangle marks its upper bound.
    """
    figure, axes = _make_figure(title, x_label, y_label)
    names = list(dict.fromkeys(name for group in groups.values() for name in group))
    width = 0.8 / max(1, len(names))
    none_counted = whiskers = False
    for place, name in enumerate(names):
        middles = [k + (place - len(names) / 2 + 0.5) * width for k in range(len(groups))]
        values = [_as_bounded(group.get(name, 0.0)) for group in groups.values()]
        drawn = axes.bar(middles, [one.value for one in values], width, label=name)
        colour = drawn.patches[0].get_facecolor()
        for middle, one in zip(middles, values, strict=True):
            low, high = _bounds_or_value(one)
            if one.low is None and one.high is not None:
                none_counted = True
                axes.plot([middle], [high], marker="v", markersize=4, color=colour)
            elif high > low:
                whiskers = True
                axes.errorbar(
                    [middle],
                    [one.value],
                    [[one.value - low], [high - one.value]],
                    color="black",
                    capsize=CAP_POINTS,
                    lw=0.7,
                )
    if whiskers:
        axes.plot([], [], "|", markersize=8, color="black", label=LEGEND)
    if none_counted:
        axes.plot([], [], "v", markersize=4, color="grey", label="none counted: at most")
    axes.set_xticks(range(len(groups)), list(groups))
    if logarithmic:
        axes.set_yscale("log")
    figure.legend(fontsize=8, loc="outside right upper")  # outside the axes, so that it never covers a bar
    return encode_png(figure)


def boxes(title: str, y_label: str, groups: Mapping[str, ArrayLike], *, x_label: str = "") -> bytes:
    """Plot a box per group: quartiles, median, mean as a cross, whiskers to 1.5 IQR, no outliers."""
    figure, axes = _make_figure(title, x_label, y_label, fontsize=9)
    axes.boxplot(
        [np.asarray(values) for values in groups.values()],
        tick_labels=list(groups),
        showfliers=False,
        showmeans=True,
        meanprops={"marker": "x"},
    )
    axes.tick_params(axis="x", labelsize=7, rotation=60)
    for label in axes.get_xticklabels():
        label.set_horizontalalignment("right")
    axes.grid(alpha=0.3)
    return encode_png(figure)


def scatters(
    title: str, x_label: str, y_label: str, panels: Mapping[str, tuple[ArrayLike, ArrayLike]]
) -> bytes:
    """Plot points in panels side by side, one for each label; each has a vertical axis of its own."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(PANEL_IN * len(panels), PANEL_IN), layout="constrained")
    FigureCanvasAgg(figure)
    every = figure.subplots(1, len(panels), squeeze=False)[0]
    for axes, (name, (across, up)) in zip(every, panels.items(), strict=True):
        axes.plot(across, up, ".", markersize=MARKER_POINTS, alpha=POINT_ALPHA)
        axes.set_title(name, fontsize=9)
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.3)
    figure.suptitle(title, fontsize=10)
    figure.supxlabel(x_label, fontsize=9)
    figure.supylabel(y_label, fontsize=9)
    return encode_png(figure)


def _list_bounded(points: Curve) -> list[Bounded]:
    return [_as_bounded(y) for _, y in points]


def _as_bounded(value: float | Bounded) -> Bounded:
    return value if isinstance(value, Bounded) else Bounded(value, None, None)


def _bounds_or_value(one: Bounded) -> tuple[float, float]:
    """Return the bounds, substituting the value for a missing one."""
    return one.value if one.low is None else one.low, one.value if one.high is None else one.high


def _make_figure(
    title: str, x_label: str, y_label: str, *, rows: int = 1, **of_title: Any
) -> tuple[Any, Any]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(SIZE_IN[0], rows * SIZE_IN[1]), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(rows, 1, 1)
    axes.set_title(title, **of_title)
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    return figure, axes


def encode_png(figure: Any) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH)
    return buffer.getvalue()

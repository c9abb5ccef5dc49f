"""Plots of the studies as PNG bytes. matplotlib is imported only when one is drawn."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

DOTS_PER_INCH = 110
SIZE_IN = (6.4, 4.0)

Curve = Sequence[tuple[float, float]]


def curves(
    title: str,
    x_label: str,
    y_label: str,
    lines: Mapping[str, Curve],
    *,
    logarithmic: bool = False,
    bands: Mapping[str, tuple[float, float]] | None = None,
) -> bytes:
    """Named curves over a common axis, with named ranges of it."""
    figure, axes = _figure()
    for name, points in lines.items():
        axes.plot([x for x, _ in points], [y for _, y in points], marker=".", label=name)
    for shade, (name, (left, right)) in enumerate((bands or {}).items(), start=1):
        axes.axvspan(left, right, color="grey", alpha=0.12 * shade, label=name)
    axes.set_title(title)
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    if logarithmic:
        axes.set_yscale("log")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    return _png(figure)


def bars(
    title: str, y_label: str, groups: Mapping[str, Mapping[str, float]], *, logarithmic: bool = False
) -> bytes:
    """Groups of bars: group -> series -> value."""
    figure, axes = _figure()
    names = list(dict.fromkeys(name for group in groups.values() for name in group))
    width = 0.8 / max(1, len(names))
    for place, name in enumerate(names):
        heights = [group.get(name, 0.0) for group in groups.values()]
        axes.bar(
            [k + (place - len(names) / 2 + 0.5) * width for k in range(len(groups))],
            heights,
            width,
            label=name,
        )
    axes.set_xticks(range(len(groups)), list(groups))
    axes.set_title(title)
    axes.set_ylabel(y_label)
    if logarithmic:
        axes.set_yscale("log")
    figure.legend(fontsize=8, loc="outside right upper")  # outside the axes: never over a bar
    return _png(figure)


def boxes(title: str, y_label: str, groups: Mapping[str, ArrayLike]) -> bytes:
    """A box for each group: quartiles, median, mean as a cross, whiskers to 1.5 boxes; no outliers."""
    figure, axes = _figure()
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
    axes.set_title(title, fontsize=9)
    axes.set_ylabel(y_label)
    axes.grid(alpha=0.3)
    return _png(figure)


def _figure() -> tuple[Any, Any]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE_IN, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.add_subplot()


def _png(figure: Any) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH)
    return buffer.getvalue()

"""Confidence bounds of counts, means and rms: published values, and how plots show them."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from studies.campaign import bounds, plots
from studies.campaign.plots import bars, curves


@pytest.mark.parametrize(
    ("count", "of", "text"),
    [
        (0, 1_000, "at most 0.3"),  # the rule of three
        (0, 100, "at most 3"),
        (1_000, 1_000, "at least 99.7"),
        (0, 0, ""),
        (5, 100, "1.64 to 11.3"),  # Clopper and Pearson, as tabulated: 1.6432 to 11.2835
    ],
)
def test_a_proportion_has_the_tabulated_bounds(count: int, of: int, text: str) -> None:
    assert bounds.percent(count, of).text == text


@pytest.mark.parametrize(
    ("count", "text"),
    [(0, "at most 3"), (1, "0.0253 to 5.57"), (10, "4.8 to 18.4")],  # Garwood 1936
)
def test_a_count_has_the_tabulated_poisson_bounds(count: int, text: str) -> None:
    assert bounds.number(count).text == text


@pytest.mark.slow
def test_95_percent_of_means_and_rms_lie_within_their_bounds() -> None:
    random = np.random.default_rng(3)
    means, roots = 0, 0
    for _ in range(2_000):
        values = random.normal(2.0, 1.0, size=200)
        mean = bounds.mean(values)
        root = bounds.root_mean_square((values**2).sum(), (values**4).sum(), len(values))
        assert None not in (mean.low, mean.high, root.low, root.high)
        means += mean.low < 2.0 < mean.high
        roots += root.low < np.sqrt(5.0) < root.high
    assert 0.935 < means / 2_000 < 0.965
    assert 0.93 < roots / 2_000 < 0.965


def test_one_value_has_no_bounds() -> None:
    assert bounds.mean([1.0]).text == bounds.root_mean_square(1.0, 1.0, 1.0).text == ""


@pytest.mark.slow
def test_bounds_change_the_plot_of_a_zero_count() -> None:
    drawn = {
        count: bars("t", "y", {"5": {"ours": bounds.percent(0, count)}}, logarithmic=True)
        for count in (100, 10_000)
    }
    assert drawn[100] != drawn[10_000]
    banded = curves("t", "x", "y", {"ours": [(1.0, bounds.percent(1, 10)), (2.0, bounds.percent(2, 10))]})
    assert banded != curves("t", "x", "y", {"ours": [(1.0, 10.0), (2.0, 20.0)]})


def test_plots_label_their_bands_and_whiskers(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(plots, "encode_png", drawn.append)
    said = bounds.percent(1, 10)
    curves("t", "x", "y", {"ours": [(1.0, said), (2.0, said)]})
    bars("t", "y", {"5": {"ours": said}}, x_label="x")
    for figure in drawn:
        (legend,) = figure.legends or [figure.axes[0].get_legend()]
        assert {text.get_text() for text in legend.get_texts()} == {"ours", "95 % bounds"}
        assert figure.axes[0].get_xlabel() == "x"


def test_a_mean_length_is_not_bounded_below_zero() -> None:
    assert bounds.mean([0.0, 1.0]).text == "-5.85 to 6.85"
    assert bounds.mean_length([0.0, 1.0]).text == "0 to 6.85"

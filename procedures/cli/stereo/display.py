"""Output tables of `ronna-stereo` for a check and for a single look."""

from __future__ import annotations

from procedures.relocalization import SphereImage
from procedures.relocalization.errors import NoSphere, NotTrusted
from procedures.reporting.calibration_figures import BallFigures, HeadCheckFigures, OutlineFigures
from procedures.workcell.stereo_look import Look
from ronna_hw.command_line import terminal


def print_check(figures: HeadCheckFigures) -> None:
    """Print the results of the three tests in a check."""
    rows = [
        [
            f"{sign.name}, {sign.unit}",
            " ".join(f"{value:.5f}" for value in sign.value),
            " ".join(f"{value:.5f}" for value in sign.sigma),
            f"{sign.statistic:.1f}",
            f"{sign.limit:.1f}",
            "CHANGED" if sign.sounds else "unchanged",
        ]
        for sign in figures.signs
    ]
    terminal.print_table(
        f"{figures.looks} measurements; arm repeatability {1000 * figures.repeatability_mm:.0f} um per axis",
        ["test", "change", "standard error", "chi-square", "limit", ""],
        rows,
    )


def show_look(view: Look, *, as_json: bool) -> BallFigures:
    """Print the ball in both images and in the tool frame; return the figures.

    Raises the look's error if it has no point.
    """
    point = view.point
    if view.left is None or view.right is None:
        raise view.problem or NoSphere("no ball was measured in this image pair")
    if not as_json:
        _print_outlines({"left": view.left, "right": view.right})
    if point is None:
        raise view.problem or NotTrusted("no ball was measured in this image pair")
    figures = BallFigures(
        position_mm=point.position_mm.tolist(),
        covariance_mm2=point.covariance_mm2.tolist(),
        ray_gap_mm=point.ray_gap_mm,
        radius_mm=point.radius_mm,
        left=OutlineFigures.model_validate(view.left),
        right=OutlineFigures.model_validate(view.right),
    )
    if as_json:
        terminal.print_json(figures.as_json())
        return figures
    terminal.print_table(
        "the ball in the tool frame",
        ["x y z mm", "standard error um", "ray gap um", "radius mm"],
        [
            [
                " ".join(f"{value:.4f}" for value in point.position_mm),
                " ".join(f"{1000 * value**0.5:.1f}" for value in point.covariance_mm2.diagonal()),
                f"{1000 * point.ray_gap_mm:.1f}",
                f"{point.radius_mm:.3f}",
            ]
        ],
    )
    return figures


def _print_outlines(sides: dict[str, SphereImage]) -> None:
    rows = [
        [
            side,
            f"{one.centre_px[0]:.3f} {one.centre_px[1]:.3f}",
            f"{one.axes_px[0]:.2f} {one.axes_px[1]:.2f}",
            f"{one.rim_fraction:.0%}",
            f"{one.scatter_px:.3f}",
            f"{one.blur_px:.1f}",
            f"{one.quality:.2f}",
            str(one.status),
        ]
        for side, one in sides.items()
    ]
    terminal.print_table(
        "the ball in both images",
        ["camera", "centre px", "semi-axes px", "rim", "scatter px", "blur px", "quality", ""],
        rows,
    )

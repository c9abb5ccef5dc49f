"""Outlines measured in pictures by a path tracer that shares nothing with the simulated cameras.

    python -m benchmarks.stereo_head.traced_views [FOLDER] [--keep JSON]

Prints one row per light: error, stated error, chi square, refusals. FOLDER holds views by
`benchmarks/peers/path_tracer.py`; without it the few kept ones are measured, each exposed several times. The
rows are also written to a file, to be kept.

A view is linear light in three parts, which are mixed here: the head's own ring of lamps, a theatre lamp from
above that also lights the drape, and a lamp from the side.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from procedures.relocalization import SphereStatus, measure_sphere
from procedures.relocalization.errors import NoContrast, NoSphere
from ronna_hw.arrays import Array

Picture = NDArray[np.uint8] | NDArray[np.uint16]

KEPT = Path(__file__).parents[2] / "tests" / "unit" / "relocalization" / "traced_views.npz"
PARTS = ("ring", "top", "side")
FULL_WELL_ELECTRONS, READ_NOISE_ELECTRONS, GAIN = 11900.0, 13.5, 100.0 / 32.0
BLACK_GREY = 8.0
LIMB_SHARE = (0.95, 0.99)  # of the radius, where the levels of the film are taken
BESIDE_SHARE = (1.01, 1.05)  # of the radius, where those of the drape are taken
DARK_SHARE = 0.02  # of the brightest; a lamp that reaches the ball less is behind a fold
LARGEST_FILM_OVER_DRAPE = 3.0  # under the lamp from above; beyond it, the drape lies in shadow
SHEET, SHEET_BLUR_PX = (0.02, 0.3), (1.5, 15.0)  # its brightness, of the film's; blur of its edge
EXPOSURES = 3  # of each view and light: another mixture and other noise


@dataclass(frozen=True)
class TracedView:
    """Light on the sensor by part, and the true outline."""

    ring: Array
    top: Array
    side: Array
    centre_px: Array
    radius_px: float


@dataclass(frozen=True)
class Light:
    """A mixture, with smallest and largest values that are drawn evenly.

    `film` is the grey level of the film, of 255 before clipping: of the limb under the ring of lamps, or of
    the brightest 5 % if `is_exposed`. `drape` and `side` are the brightness of the drape and of the side's
    limb by their lamps, over that of the limb under the ring. `hidden` is the share of the rim behind a grey
    sheet with a blurred edge, `defocus_px` the radius of the disc that a point becomes.
    """

    name: str
    film: tuple[float, float]
    drape: tuple[float, float] = (0.0, 0.0)
    side: tuple[float, float] = (0.0, 0.0)
    is_exposed: bool = False
    bits: int = 8
    hidden: float = 0.0
    defocus_px: float = 0.0


ORDINARY = Light("ordinary", (180.0, 180.0), drape=(0.03, 0.08))
TWELVE_BITS = Light("12 bits", (180.0, 180.0), drape=(0.03, 0.08), bits=12)
FAINT = Light("faint", (35.0, 35.0), drape=(0.03, 0.12))
BRIGHT_DRAPE = Light("bright drape", (200.0, 200.0), drape=(0.3, 0.9), is_exposed=True)
SATURATED = Light("saturated", (280.0, 765.0), drape=(0.02, 0.08))
SATURATED_DRAPE = Light("saturated, bright drape", (280.0, 510.0), drape=(0.1, 0.3))
SIDE_LAMP = Light("lamp from the side", (200.0, 200.0), side=(0.5, 2.0), is_exposed=True)
STRONG_SIDE_LAMP = Light("strong lamp from the side", (220.0, 220.0), side=(2.0, 6.0), is_exposed=True)
SATURATED_SIDE = Light("lamp from the side, saturated", (180.0, 180.0), side=(1.0, 3.0))
HIDDEN_FIFTH = Light("a fifth hidden", (180.0, 180.0), drape=(0.03, 0.08), hidden=0.2)
OUT_OF_FOCUS = Light("out of focus", (180.0, 180.0), drape=(0.03, 0.08), defocus_px=5.0)
HIDDEN_BEFORE_DRAPE = replace(BRIGHT_DRAPE, name="a fifth hidden, bright drape", hidden=0.2)
BLURRED_DRAPE = replace(BRIGHT_DRAPE, name="out of focus, bright drape", defocus_px=5.0)
LIGHTS = (
    ORDINARY, TWELVE_BITS, FAINT, BRIGHT_DRAPE, SATURATED, SATURATED_DRAPE, SIDE_LAMP, STRONG_SIDE_LAMP,
    SATURATED_SIDE, HIDDEN_FIFTH, OUT_OF_FOCUS, HIDDEN_BEFORE_DRAPE, BLURRED_DRAPE,
)  # fmt: skip


@dataclass
class Outcome:
    """Errors of the centres that were given, their stated variances, and the reasons for the others."""

    errors_px: list[Array] = field(default_factory=list)
    squared_sigmas: list[float] = field(default_factory=list)
    variances_px2: list[float] = field(default_factory=list)
    refused: Counter[str] = field(default_factory=Counter)

    @property
    def rms_px(self) -> float:
        return float(np.sqrt(np.mean(np.square(self.errors_px)))) if self.errors_px else float("nan")

    @property
    def stated_px(self) -> float:
        return float(np.sqrt(np.mean(self.variances_px2))) if self.errors_px else float("nan")

    @property
    def chi_square(self) -> float:
        """Mean squared error normalized by the stated covariance, per degree of freedom."""
        return float(np.mean(self.squared_sigmas)) / 2.0 if self.errors_px else float("nan")


def kept_views(path: Path = KEPT) -> Iterator[TracedView]:
    """Yield the kept views: compressed, and smooth far from the rim."""
    with np.load(path) as kept:
        for number, (x, y, radius) in enumerate(kept["outlines"]):
            ring, top, side = (
                np.asarray(cv2.imdecode(kept[f"{part}_{number}"], cv2.IMREAD_GRAYSCALE), dtype=float)
                for part in PARTS
            )
            yield TracedView(ring, top, side, np.array([x, y]), float(radius))


def traced_views(folder: Path) -> Iterator[TracedView]:
    for path in sorted(folder.glob("*.npz")):
        with np.load(path) as traced:
            ring, top, side = (traced[part].astype(float) for part in PARTS)
            x, y, radius = traced["outline"]
            yield TracedView(ring, top, side, np.array([x, y]), float(radius))


def expose(view: TracedView, light: Light, random: np.random.Generator) -> Picture | None:
    """Return a picture of a view, or None where a lamp of the mixture is hidden from ball or drape."""
    rows, columns = np.mgrid[: view.ring.shape[0], : view.ring.shape[1]]
    distance = np.hypot(columns - view.centre_px[0], rows - view.centre_px[1]) / view.radius_px
    limb, beside = ((distance > low) & (distance < high) for low, high in (LIMB_SHARE, BESIDE_SHARE))
    film, drape, side, grey = (
        float(np.median(view.ring[limb])),
        float(np.percentile(view.top[beside], 90)),
        float(np.percentile(view.side[limb], 95)),
        random.uniform(*light.film),
    )
    is_drape_hidden = float(np.percentile(view.top[limb], 90)) > LARGEST_FILM_OVER_DRAPE * drape
    if (light.side[1] and side < DARK_SHARE * view.side.max()) or (light.drape[1] and is_drape_hidden):
        return None
    mixed = view.ring / film
    mixed += random.uniform(*light.drape) * view.top / drape + random.uniform(*light.side) * view.side / max(
        side, 1e-9
    )
    if light.is_exposed:
        mixed /= float(np.percentile(mixed[distance < LIMB_SHARE[1]], 95))
    if light.defocus_px:
        mixed = cv2.filter2D(mixed, -1, _disc(light.defocus_px), borderType=cv2.BORDER_REPLICATE)
    if light.hidden:
        mixed = _cover(mixed, view, light.hidden, random)
    return _read_out(grey * mixed, light.bits, random)


def _disc(radius_px: float) -> Array:
    half = int(radius_px) + 2
    rows, columns = np.mgrid[-half : half + 1, -half : half + 1]
    kernel = np.clip(radius_px + 0.5 - np.hypot(rows, columns), 0.0, 1.0)
    return np.asarray(kernel / kernel.sum())


def _cover(mixed: Array, view: TracedView, hidden: float, random: np.random.Generator) -> Array:
    """Return the light with a straight sheet over a share of the rim, grey and out of focus at random."""
    turn, blur_px = random.uniform(0.0, 2.0 * np.pi), random.uniform(*SHEET_BLUR_PX)
    level = random.uniform(*SHEET)
    rows, columns = np.mgrid[: mixed.shape[0], : mixed.shape[1]]
    along = (columns - view.centre_px[0]) * np.cos(turn) + (rows - view.centre_px[1]) * np.sin(turn)
    share = ndtr((along - view.radius_px * np.cos(np.pi * hidden)) / blur_px)
    return np.asarray((1.0 - share) * mixed + share * level)


def _read_out(grey: Array, bits: int, random: np.random.Generator) -> Picture:
    electrons = grey * (FULL_WELL_ELECTRONS / 255.0 / GAIN)
    electrons += np.sqrt(electrons + READ_NOISE_ELECTRONS**2) * random.standard_normal(grey.shape)
    top = 2**bits - 1
    values = (
        np.minimum(electrons, FULL_WELL_ELECTRONS) * GAIN / FULL_WELL_ELECTRONS + BLACK_GREY / 255.0
    ) * top
    whole = np.clip(np.rint(values), 0, top)
    return np.asarray(whole, dtype=np.uint8) if bits == 8 else np.asarray(whole, dtype=np.uint16)


def measure_views(views: list[TracedView], light: Light, exposures: int = EXPOSURES) -> Outcome:
    outcome = Outcome()
    for number, view in enumerate(views):
        for exposure in range(exposures):
            picture = expose(view, light, np.random.default_rng([number, exposure, LIGHTS.index(light)]))
            if picture is not None:
                _measure(picture, view, outcome)
    return outcome


def _measure(picture: Picture, view: TracedView, outcome: Outcome) -> None:
    try:
        found = measure_sphere(picture, radius_range_px=(0.75 * view.radius_px, 1.25 * view.radius_px))
    except (NoSphere, NoContrast) as fault:
        outcome.refused[fault.code] += 1
        return
    if found.status is not SphereStatus.OK:
        outcome.refused[found.doubt] += 1
        return
    error = np.array(found.centre_px) - view.centre_px
    covariance = np.array(found.covariance_px2)
    outcome.errors_px.append(error)
    outcome.squared_sigmas.append(float(error @ np.linalg.solve(covariance, error)))
    outcome.variances_px2.append(float(np.trace(covariance)) / 2.0)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--keep", type=Path, metavar="JSON")
    options = parser.parse_args()
    views = list(traced_views(options.folder) if options.folder else kept_views())
    rows: dict[str, dict[str, float]] = {}
    print(f"{'light':30} {'given':>5} {'rms px':>7} {'stated':>7} {'chi2':>5}  refused")
    for light in LIGHTS:
        found = measure_views(views, light)
        refused = "; ".join(f"{count} {why}" for why, count in found.refused.items())
        figures = f"{found.rms_px:7.4f} {found.stated_px:7.4f} {found.chi_square:5.2f}"
        print(f"{light.name:30} {len(found.errors_px):5d} {figures}  {refused}")
        rows[light.name.replace(",", "").replace(" ", "_")] = _row(found)
    if options.keep:
        options.keep.write_text(json.dumps(rows, indent=1) + "\n")


def _row(found: Outcome) -> dict[str, float]:
    row: dict[str, float] = {"given": len(found.errors_px), "refused": sum(found.refused.values())}
    if found.errors_px:
        row |= {
            "rms_px": found.rms_px,
            "stated_px": found.stated_px,
            "normalized_square": found.chi_square,
        }
    return row


if __name__ == "__main__":
    main()

"""How far the skin in the theatre is from that in the CT, along its normal, by its kind."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from ronna_hw.arrays import Array
from sim.world.head_surface.parametric_head import ParametricHead
from sim.world.head_surface.skin_shift import ShiftedHead, SkinShift
from sim.world.head_surface.smooth_field import SmoothField
from studies.surface.conditions import SHIFT_EDGE_MM, SHIFT_MM, SHIFTED_SHARE, Draw, Skin
from studies.surface.first_judged_skins import FIRST_JUDGED_KINDS, displace_beside
from studies.surface.judged_skins import JUDGED_KINDS
from studies.surface.second_judged_skins import SECOND_JUDGED_KINDS
from studies.surface.third_judged_skins import THIRD_JUDGED_KINDS

ORDERS = {Skin.ROUGH: 0.5, Skin.SMOOTH: 2.5, Skin.SMOOTHEST: float("inf")}
PATCHES, PATCH_EDGE_MM, PATCH_RADII = (6, 15), 4.0, (0.6, 1.5)  # radii relative to the length
QUADRATIC_TERMS = 6
# Sizes of the events relative to that of a field: they displace a smaller part of the skin (U)
TAPE_SHARE, JAW_SHARE, PILLOW_SHARE, PIN_SHARE = 2.0, 4.0, 4.0, 3.0
BESIDE_MM, BESIDE_LENGTH_MM = 0.1, 20.0  # field beside the events
MOST_EVENT_MM = 10.0

Displacement = Callable[[ParametricHead, Array, Draw, np.random.Generator], Array]


def displace(
    skin: Skin, head: ParametricHead, points_mm: Array, draw: Draw, random: np.random.Generator
) -> Array:
    """Return the displacement (n,) of the skin at points (n, 3) of the CT, outwards positive, in mm."""
    return np.asarray(_KINDS[skin](head, points_mm, draw, random))


def shift_third(points_mm: Array, random: np.random.Generator) -> Array:
    """Return a displacement (n,) by 1 mm, out or in, of the third of the points around one of them."""
    distances = np.linalg.norm(points_mm - points_mm[random.integers(len(points_mm))], axis=1)
    edge = float(np.quantile(distances, SHIFTED_SHARE))
    size_mm = SHIFT_MM * float(random.choice((-1.0, 1.0)))
    return np.asarray(size_mm * _inside(distances, edge, SHIFT_EDGE_MM))


def _none(head: ParametricHead, points_mm: Array, draw: Draw, random: np.random.Generator) -> Array:
    return np.zeros(len(points_mm))


def _field(order: float) -> Displacement:
    def displaced(head: ParametricHead, points_mm: Array, draw: Draw, random: np.random.Generator) -> Array:
        field = SmoothField(_seed(random), "surface study", draw.length_mm, order)
        return np.asarray(draw.size_mm * field.at(points_mm))

    return displaced


def _patches(head: ParametricHead, points_mm: Array, draw: Draw, random: np.random.Generator) -> Array:
    """Displace discs of random places, sizes and signs; of two that overlap, the later one counts."""
    moved = np.zeros(len(points_mm))
    for _ in range(int(random.integers(*PATCHES))):
        centre = points_mm[random.integers(len(points_mm))]
        radius_mm = draw.length_mm * float(random.uniform(*PATCH_RADII))
        inside = _inside(np.linalg.norm(points_mm - centre, axis=1), radius_mm, PATCH_EDGE_MM)
        moved += inside * (draw.size_mm * float(random.standard_normal()) - moved)
    return moved


def _swelling(head: ParametricHead, points_mm: Array, draw: Draw, random: np.random.Generator) -> Array:
    """Displace by a quadratic form of the place, of the stated size in the mean of the points.

    A linear one would nearly be a movement, not a misfit.
    """
    x, y, z = (points_mm / np.asarray(head.semi_axes_mm)).T
    terms = np.array([x * x, y * y, z * z, x * y, y * z, z * x])
    form = random.standard_normal(QUADRATIC_TERMS) @ terms
    return np.asarray(draw.size_mm * form / np.sqrt(np.mean(form**2)))


def _tape(head: ParametricHead, points_mm: Array, draw: Draw, random: np.random.Generator) -> Array:
    shift = SkinShift(
        tape_mm=_event(TAPE_SHARE * draw.size_mm * random.standard_normal()),
        jaw_mm=_event(JAW_SHARE * draw.size_mm * abs(random.standard_normal())),
    )
    return _events(head, points_mm, shift, random)


def _pillow(head: ParametricHead, points_mm: Array, draw: Draw, random: np.random.Generator) -> Array:
    shift = SkinShift(
        pillow_mm=_event(-PILLOW_SHARE * draw.size_mm * abs(random.standard_normal())),
        pins_mm=_event(PIN_SHARE * draw.size_mm * random.standard_normal()),
    )
    return _events(head, points_mm, shift, random)


def _events(head: ParametricHead, points_mm: Array, events: SkinShift, random: np.random.Generator) -> Array:
    """Displace by named events beside a weak field."""
    field = {
        "seed": _seed(random),
        "field_mm": BESIDE_MM,
        "field_length_mm": BESIDE_LENGTH_MM,
        "field_order": ORDERS[Skin.SMOOTH],
    }
    return ShiftedHead(head, events.model_copy(update=field)).shift_mm(points_mm)


_KINDS: Mapping[Skin, Displacement] = {
    Skin.RIGID: _none,
    **{skin: _field(order) for skin, order in ORDERS.items()},
    Skin.PATCHES: _patches,
    Skin.SWELLING: _swelling,
    Skin.TAPE: _tape,
    Skin.PILLOW: _pillow,
    **{
        skin: partial(displace_beside, kind)
        for kinds in (FIRST_JUDGED_KINDS, SECOND_JUDGED_KINDS, THIRD_JUDGED_KINDS, JUDGED_KINDS)
        for skin, kind in kinds.items()
    },
}


def _inside(distances_mm: Array, radius_mm: float, edge_mm: float) -> Array:
    """Return 1 inside a radius and 0 beyond, smooth over an edge."""
    return np.asarray(1.0 / (1.0 + np.exp(np.clip(4.0 * (distances_mm - radius_mm) / edge_mm, -50.0, 50.0))))


def _event(size_mm: float) -> float:
    return float(np.clip(size_mm, -MOST_EVENT_MM, MOST_EVENT_MM))


def _seed(random: np.random.Generator) -> int:
    return int(random.integers(2**31))

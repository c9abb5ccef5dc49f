"""Measures of a face, and how they are drawn from the spread of adults.

Means and standard deviations of men and women are of a survey of 3997 users of respirators (Zhuang and
Bradtmiller, J. Occup. Environ. Hyg. 2:567, 2005), those of heights below the vertex and of ears of the army's
survey ANSUR (1988), quoted without the tables at hand. Estimates of ours are marked (U).
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from ronna_hw.calibration import Strict

# Wider than people are, and not so far that parts of the head vanish in others
Large = Annotated[float, Field(ge=60, le=250)]
Small = Annotated[float, Field(ge=4, le=120)]
Share = Annotated[float, Field(ge=0, le=1)]


class Face(Strict):
    """Measures of a face on the cranium, which is the head's ellipsoid."""

    sellion_below_vertex_mm: Large = Field(
        default=108.0, description="Height of the vertex above the root of the nose."
    )
    tragion_below_vertex_mm: Large = Field(
        default=131.0, description="Height of the vertex above the ear's opening."
    )
    face_length_mm: Large = Field(default=121.0, description="Root of the nose to the chin's lowest point.")
    face_width_mm: Large = Field(default=141.0, description="Width over the cheekbones.")
    jaw_width_mm: Large = Field(default=116.0, description="Width over the angles of the jaw.")
    nose_length_mm: Small = Field(default=51.0, description="Root of the nose to its base.")
    nose_breadth_mm: Small = Field(default=36.0, description="Width over the wings of the nose.")
    nose_protrusion_mm: Small = Field(default=21.0, description="Tip of the nose before its base.")
    eye_distance_mm: Small = Field(default=64.0, description="Distance of the pupils.")
    brow_mm: Small = Field(default=7.0, description="Radius of the ridge of the brows.")
    ear_length_mm: Small = Field(default=62.0, description="Length of the ears.")
    ear_breadth_mm: Small = Field(default=37.0, description="Breadth of the ears.")
    ear_protrusion_mm: Small = Field(default=21.0, description="Edge of the ears from the head.")
    neck_mm: Small = Field(default=57.0, description="Radius of the neck.")
    ear_folds: tuple[Share, Share] = Field(
        default=(0.0, 0.0),
        description="How far the ears are folded against the head, left and right: 0 to 1.",
    )
    hair_line_mm: Small = Field(
        default=70.0, description="Height of the hair line at the forehead above the root of the nose."
    )
    hair_mm: Annotated[float, Field(ge=0, le=50)] = Field(
        default=0.0, description="Thickness of the hair behind that line; 0: shaved."
    )
    hair_share: Share = Field(default=0.0, description="Share of the skin that the hair hides.")
    hair_seed: Annotated[int, Field(ge=0)] = Field(default=0, description="Seed of the hair's strands.")


class Spread(NamedTuple):
    """Mean and standard deviation of a measure, of men and of women."""

    men: tuple[float, float]
    women: tuple[float, float]


CRANIUM = {
    "breadth": Spread((153.0, 6.0), (146.8, 5.6)),
    "length": Spread((197.3, 7.4), (187.5, 7.2)),
}
VERTEX_ABOVE_CENTRE_MM = Spread((90.0, 3.0), (86.5, 3.0))  # (U)
MEASURES = {
    "sellion_below_vertex_mm": Spread((109.0, 4.0), (104.0, 4.0)),  # (U) from sitting and eye height
    "tragion_below_vertex_mm": Spread((131.0, 5.0), (126.0, 5.0)),
    "face_length_mm": Spread((122.7, 7.0), (113.4, 6.1)),
    "face_width_mm": Spread((143.5, 6.9), (135.1, 6.5)),
    "jaw_width_mm": Spread((120.4, 8.0), (110.1, 7.0)),
    "nose_length_mm": Spread((52.0, 4.1), (48.2, 3.8)),
    "nose_breadth_mm": Spread((36.6, 4.1), (33.2, 3.9)),
    "nose_protrusion_mm": Spread((21.1, 2.7), (19.8, 2.7)),
    "eye_distance_mm": Spread((64.5, 3.6), (61.9, 3.5)),
    "brow_mm": Spread((7.5, 1.0), (6.0, 0.8)),  # (U)
    "ear_length_mm": Spread((62.9, 4.5), (59.0, 4.0)),
    "ear_breadth_mm": Spread((37.6, 3.0), (34.0, 3.0)),
    "ear_protrusion_mm": Spread((21.5, 3.0), (19.5, 3.0)),
    "neck_mm": Spread((60.0, 3.0), (51.0, 2.5)),
    "hair_line_mm": Spread((69.0, 7.0), (67.0, 6.0)),
}
BEYOND = 2.0  # standard deviations: rarer sizes are not drawn
DIGITS = 2
# Above the ears a patient is shaved where the surgeon works, or not at all (U).
HAIR_MM, HAIR_SHARE, SHAVED = (2.0, 12.0), (0.3, 0.97), 0.4


class Measures(NamedTuple):
    """Drawn measures of a head: semi-axes of the cranium and the face."""

    semi_axes_mm: tuple[float, float, float]
    face: Face


def draw_measures(generator: np.random.Generator) -> Measures:
    """Draw the measures of an adult: a man or a woman by equal chances, each measure by itself."""
    is_man = bool(generator.uniform() < 0.5)

    def draw(spread: Spread) -> float:
        mean, deviation = spread.men if is_man else spread.women
        return round(mean + deviation * float(np.clip(generator.standard_normal(), -BEYOND, BEYOND)), DIGITS)

    breadth, length = (draw(CRANIUM[name]) for name in ("breadth", "length"))
    height = draw(VERTEX_ABOVE_CENTRE_MM)
    measures = {name: draw(spread) for name, spread in MEASURES.items()}
    shaved = bool(generator.uniform() < SHAVED)
    thickness, share = (round(float(generator.uniform(*one)), DIGITS) for one in (HAIR_MM, HAIR_SHARE))
    hair: dict[str, float] = {} if shaved else {"hair_mm": thickness, "hair_share": share}
    face = Face.model_validate(measures | hair | {"hair_seed": int(generator.integers(2**31))})
    return Measures((0.5 * breadth, 0.5 * length, height), face)

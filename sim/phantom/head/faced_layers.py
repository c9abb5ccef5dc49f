"""Intensity of a head with a face: soft tissue by depth below the skin, bone by depth in the skull."""

from __future__ import annotations

from math import sqrt
from typing import Protocol

import numpy as np

from sim.errors import BAD_SCENE
from sim.phantom.head.anatomy import AIR_HU, LAYERS, HeadLayers, blur_table
from sim.phantom.head.shapes import Values
from sim.world.head_surface.parametric_head import ParametricHead
from sim.world.head_surface.regions import EDGE_MM, above_hair_line_mm
from sim.world.head_surface.skull_surface import SkullSurface
from sim.world.rigid import Point
from sim.world.scene.model import Head
from sim.world.scene.skin import head_with_face

BY_SKIN = 3  # layers of the scalp: skin, fat, galea and muscle; those after them are of the cranium
STEP_MM = 0.02
OUTSIDE_MM = 4.0
HAIR_HU = 130.0  # above air, at the roots (U)
FIRM_MM = 1.0  # around ears and nose, which have no fat
CORTEX_MM = 2.0  # of the bones of the face
EMPTY_MM = 10.0  # coarse distance beyond which there is air
DEEP_MM, BRAIN_ABOVE_MM = 32.0, -15.0  # coarse depth and height at which there is white matter
BELOW_FOREHEAD_MM = 40.0  # above the nose's root: higher up there is the cranium alone


class Layers(Protocol):
    """A painted head without bodies, in the CT frame."""

    centre: Point
    semi_axes: Point

    def hu_at(self, x: Values, y: Values, z: Values) -> Values:
        """Return the HU at the given points, using air outside the head."""
        ...

    def half_widths(self, z_mm: float, margin_mm: float) -> tuple[float, float] | None:
        """Return the head's half extents in x and y at `z_mm` plus a margin, or None outside."""
        ...


def layers_of(
    head: Head, blur_mm: float, layers: tuple[tuple[float, float], ...] = LAYERS, air: float = AIR_HU
) -> Layers:
    """Return the layers of a head, with edges blurred by a Gaussian of `blur_mm`."""
    if head.own_ct is not None:
        raise BAD_SCENE("the head is a CT of your own: it cannot be scanned again")
    faced = head_with_face(head)
    if faced is None:
        return HeadLayers(head.centre_ct_mm, head.semi_axes_mm, blur_mm, layers, air)
    return FacedLayers(faced, blur_mm, layers, air)


class FacedLayers:
    """Layers of a head with a face."""

    def __init__(
        self, head: ParametricHead, blur_mm: float, layers: tuple[tuple[float, float], ...], air: float
    ) -> None:
        self.centre = head.centre_ct_mm
        low, high = np.array(head.extent_mm) - self.centre
        x, y, z = np.maximum(-low, high).tolist()
        self.semi_axes = (x, y, z)
        self._head, self._skull = head, SkullSurface(head)
        (_, muscle), (_, bone), (_, marrow) = layers[BY_SKIN - 1 : BY_SKIN + 2]
        self._air, self._brain = np.float32(air), np.float32(layers[-1][1])
        self._scalp = _DepthTable(air, layers[:BY_SKIN], blur_mm)
        self._firm = _DepthTable(air, (layers[0], (0.0, muscle)), blur_mm)
        self._cranium = _DepthTable(layers[BY_SKIN][1], layers[BY_SKIN:], blur_mm)
        self._bones = _DepthTable(bone, ((CORTEX_MM, bone), (0.0, marrow)), blur_mm)
        self._inside = _DepthTable(0.0, ((0.0, 1.0),), blur_mm)  # share of bone across its surface

    def hu_at(self, x: Values, y: Values, z: Values) -> Values:
        """Return the HU at the given points, using air outside the head."""
        coarse = self._head.grid.nearest(x, y, z)
        found = np.full(coarse.shape, self._air, dtype=np.float32)
        in_brain = (coarse < -DEEP_MM) & (z > self.centre[2] + BRAIN_ABOVE_MM)
        found[in_brain] = self._brain
        edges = (coarse < EMPTY_MM) & ~in_brain
        if edges.any():
            found[edges] = self._hu_of(*(np.broadcast_to(one, edges.shape)[edges] for one in (x, y, z)))
        return found

    def _hu_of(self, x: Values, y: Values, z: Values) -> Values:
        parts = self._head.parts(x, y, z)
        depth = -parts.whole().distance()
        firm = np.minimum(parts.nose.value, parts.ear.value) < FIRM_MM
        hu = np.where(firm, self._firm.at(depth), self._scalp.at(depth))
        for bone, table in (
            (self._skull.face_bones(x, y, z).distance(), self._bones),
            (self._skull.cranium(x, y, z).value, self._cranium),
        ):
            share = self._inside.at(-bone)
            hu += share * (table.at(-bone) - hu)
        if self._head.face.hair_mm:
            hu += self._hair(x, y, z, depth)
        return hu

    def _hair(self, x: Values, y: Values, z: Values, depth: Values) -> Values:
        """Return what hair adds: thinner with the distance from the skin."""
        points = np.column_stack([x, y, z]).astype(float)
        roots = np.clip(above_hair_line_mm(self._head, points) / EDGE_MM, 0.0, 1.0).astype(np.float32)
        share = np.clip(1.0 + depth / np.float32(self._head.face.hair_mm), 0.0, 1.0)
        added: Values = np.float32(HAIR_HU) * roots * share * (np.float32(1.0) - self._inside.at(depth))
        return added

    def half_widths(self, z_mm: float, margin_mm: float) -> tuple[float, float] | None:
        """Return the head's half extents in x and y at `z_mm` plus a margin, or None outside."""
        a, b, c = (axis + margin_mm for axis in self._head.semi_axes_mm)
        height = z_mm - self.centre[2]
        if height > c:
            return None
        if height < self._head.landmarks.sellion_mm + BELOW_FOREHEAD_MM:
            return self.semi_axes[0] + margin_mm, self.semi_axes[1] + margin_mm
        share = sqrt(1.0 - (height / c) ** 2)
        return a * share, b * share


class _DepthTable:
    """Intensity by depth below a surface, its layers blurred; the last one fills the rest."""

    def __init__(self, outside: float, layers: tuple[tuple[float, float], ...], blur_mm: float) -> None:
        depths = np.arange(-OUTSIDE_MM, sum(thickness for thickness, _ in layers) + OUTSIDE_MM, STEP_MM)
        table = np.full(len(depths), outside)
        top = 0.0
        for thickness, hu in layers:
            table[depths >= top] = hu
            top += thickness
        self._table = blur_table(table, blur_mm / STEP_MM).astype(np.float32)

    def at(self, depth_mm: Values) -> Values:
        # An edge lies between its two nodes: each node stands for the step after it.
        place = (depth_mm + np.float32(OUTSIDE_MM)) * np.float32(1.0 / STEP_MM)
        last = np.float32(len(self._table) - 1)
        hu: Values = self._table[np.clip(place, np.float32(0.0), last).astype(np.int32)]
        return hu

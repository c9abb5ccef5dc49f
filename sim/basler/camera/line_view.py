"""The projector's line as one camera sees it: on the head, its spheres, and a hand that is in the way."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sim.basler.optics.canvas import Area, Lens
from sim.basler.optics.laser_line import FILM, FURTHEST_MM, SKIN, Body, Hair, LineRun, trace_line
from sim.basler.optics.sphere import DrawnSphere
from sim.world.displacements import RoomShift, rigid_move
from sim.world.head_surface.bare_bone import HeadWithBareBone
from sim.world.head_surface.ellipsoidal_head import EllipsoidalHead
from sim.world.head_surface.parametric_head import ParametricHead
from sim.world.head_surface.regions import hair_mm, hidden_by_hair
from sim.world.head_surface.surface import HeadSurface
from sim.world.rigid import Matrix, Vectors, apply, as_point, inverse, matrix_of
from sim.world.scene.model import CameraTruth, Scene
from sim.world.scene.skin import head_in_theatre, prepare_skin, skin_in_theatre

HAND_RADIUS_MM = 12.0  # of a finger's end
HAND_BESIDE_MM = 8.0  # of the line's middle: it takes half of what the cameras see
HAND = replace(SKIN, gloss=0.0)  # in a glove


class LineView:
    """The line projector of a scene and what its light meets."""

    def __init__(self, scene: Scene, camera: CameraTruth) -> None:
        self._lens = Lens.from_camera(camera)
        self._projector = scene.projector
        self._seed = scene.seed
        head = scene.head
        self._robot_from_ct = matrix_of(head.robot_from_ct)
        self._skin = Body(skin_in_theatre(head), SKIN)
        faced = head_in_theatre(head)
        self._hair = None
        if faced is not None:
            hides = partial(is_under_hair, faced, self._skin.surface)
            self._hair = Hair(hides, partial(hair_mm, faced))
        if self._projector is not None:
            prepare_skin(head)
            if faced is not None:
                hidden_by_hair(faced, np.array([head.centre_ct_mm]))

    def runs(
        self,
        area: Area,
        robot_from_tool: Matrix | None,
        camera_from_tool: Matrix,
        spheres: tuple[DrawnSphere, ...],
        room: RoomShift,
        hand_mm: float | None = None,
    ) -> tuple[LineRun, ...]:
        """Return the runs of the line in an area of a camera's picture, empty without projector or arm.

        `hand_mm` is the height over the skin of a hand in the line, if there is one.
        """
        if self._projector is None or robot_from_tool is None:
            return ()
        robot_from_ct = rigid_move(room.head_rad, room.head_mm) @ self._robot_from_ct
        ct_from_tool = inverse(robot_from_ct) @ robot_from_tool
        camera_from_ct = camera_from_tool @ inverse(ct_from_tool)
        ct_from_projector = ct_from_tool @ matrix_of(self._projector.tool_from_projector)
        ct_from_camera = inverse(camera_from_ct)
        bodies = [self._skin]
        for sphere in spheres:
            centre = as_point(apply(ct_from_camera, sphere.centre_mm))
            bodies.append(Body(EllipsoidalHead(centre, (sphere.radius_mm,) * 3), FILM))
        if hand_mm is not None and (hand := self._hand(ct_from_projector, hand_mm)) is not None:
            bodies.append(hand)
        return trace_line(
            self._projector,
            ct_from_projector,
            camera_from_ct,
            (self._lens, area),
            bodies,
            self._hair,
            self._seed,
        )

    def _hand(self, ct_from_projector: Matrix, height_mm: float) -> Body | None:
        """Return a hand over the place where the projector's axis meets the skin, if it does."""
        axis = ct_from_projector[None, :3, 2]
        (away_mm,) = self._skin.surface.cast(ct_from_projector[None, :3, 3], axis, FURTHEST_MM)
        if np.isnan(away_mm):
            return None
        centre = apply(ct_from_projector, (HAND_BESIDE_MM, 0.0, away_mm - height_mm))
        return Body(EllipsoidalHead(as_point(centre), (HAND_RADIUS_MM,) * 3), HAND)


def is_under_hair(faced: ParametricHead, surface: HeadSurface, points_mm: Vectors) -> NDArray[np.bool_]:
    """Return whether hair hides points (n,) of a head's surface: bone laid bare has none."""
    hidden = hidden_by_hair(faced, points_mm)
    if not isinstance(surface, HeadWithBareBone):
        return hidden
    return hidden & np.logical_not(surface.shows_bone(points_mm))

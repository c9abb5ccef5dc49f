"""How the skin moved between CT and theatre: a correlated field, and named events.

Displacements are along the outward normal, positive outwards, in the CT frame.
"""

from __future__ import annotations

from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import Field

from ronna_hw.calibration import Strict
from sim.world.head_surface.blending import Field as Body
from sim.world.head_surface.face import Face
from sim.world.head_surface.parametric_head import ParametricHead
from sim.world.head_surface.smooth_field import smooth_field
from sim.world.head_surface.surface import march
from sim.world.rigid import Array, Point, Vector, Vectors

Size = Annotated[float, Field(ge=-20, le=20)]

PILLOW_MM = 45.0  # radius of the flattened back
PILLOW_FROM = (0.0, 1.0, -0.1)  # from the centre
PIN_MM = 13.0  # radius of the skin that a pin moves
# Single pin on the left, two on the right, above the ears (U): directions from the centre
PINS = ((1.0, 0.15, 0.25), (-1.0, -0.15, 0.28), (-1.0, 0.45, 0.22))
TAPE_MM = 22.0  # radius of the skin that a tape over an eye moves
TAPE_BELOW_MM = 8.0  # of its middle below the pupil
JAW_EDGE_MM = 12.0  # over which skin begins to follow the jaw
JAW_HINGE_BELOW_MM = 5.0  # of the joints below the tragion
JAW_LINE_SHARE = 0.25  # of the way from the nose to the chin
STEP_MM = 0.05  # of the differences that give normals
SURE_SIGMAS = 5.0  # of the field: rays start outside its largest values


class SkinShift(Strict):
    """Displacement of the skin since the CT."""

    seed: Annotated[int, Field(ge=0)] = Field(default=0, description="Seed of the random field.")
    field_mm: Annotated[float, Field(ge=0, le=10)] = Field(
        default=0.0, description="Standard deviation of the random field."
    )
    field_length_mm: Annotated[float, Field(ge=1, le=500)] = Field(
        default=30.0, description="Length over which that field is correlated."
    )
    field_order: Annotated[float, Field(ge=0.5, le=10)] = Field(
        default=1.5, description="Order of its Matérn covariance: 0.5 is rough, 2.5 smooth."
    )
    offset_mm: Size = Field(default=0.0, description="Displacement of all skin, as by fluid.")
    pillow_mm: Size = Field(
        default=0.0, description="Displacement of the back of the head; negative: flattened by a pillow."
    )
    pins_mm: Size = Field(
        default=0.0, description="Displacement around each pin of the clamp; negative: pressed in."
    )
    tape_mm: Size = Field(
        default=0.0, description="Displacement of lids and upper cheeks under tape, left and right."
    )
    jaw_mm: Size = Field(default=0.0, description="Way of the chin as the jaw opened: the lower face moved.")
    ears_unfold: bool = Field(default=False, description="True: ears folded in the CT stand off now.")

    @property
    def is_none(self) -> bool:
        """Whether the skin is as it was."""
        return self == SkinShift(
            seed=self.seed, field_length_mm=self.field_length_mm, field_order=self.field_order
        )


# What a clamped, intubated head has to expect: ranges of each displacement (U)
FIELD_MM, FIELD_LENGTH_MM, OFFSET_MM = (0.1, 0.4), (15.0, 40.0), 0.1
PILLOW_RANGE_MM, PINS_RANGE_MM, TAPE_RANGE_MM, JAW_RANGE_MM = (
    (-2.0, 0.5),
    (-2.0, 1.0),
    (-0.8, 0.8),
    (0.0, 4.0),
)
DIGITS = 3


def draw_shift(generator: np.random.Generator) -> SkinShift:
    """Draw how the skin of a patient moved."""

    def between(low: float, high: float) -> float:
        return round(float(generator.uniform(low, high)), DIGITS)

    return SkinShift(
        seed=int(generator.integers(2**31)),
        field_mm=between(*FIELD_MM),
        field_length_mm=between(*FIELD_LENGTH_MM),
        offset_mm=round(float(generator.normal(0.0, OFFSET_MM)), DIGITS),
        pillow_mm=between(*PILLOW_RANGE_MM),
        pins_mm=between(*PINS_RANGE_MM),
        tape_mm=between(*TAPE_RANGE_MM),
        jaw_mm=between(*JAW_RANGE_MM),
    )


class ShiftedHead:
    """A head as it is in the theatre: its surface in the CT, displaced along the normal.

    Points are in the CT frame: the head's pose in the room is the scene's.
    """

    def __init__(self, head: ParametricHead, shift: SkinShift) -> None:
        self.in_ct, self.shift = head, shift
        face = head.face
        if shift.ears_unfold:
            face = face.model_copy(update={"ear_folds": Face().ear_folds})
        self.undisplaced = head
        if face != head.face:
            self.undisplaced = ParametricHead(head.centre_ct_mm, head.semi_axes_mm, face)

    def shift_mm(self, points_mm: Vectors) -> Array:
        """Return the displacement (n,) of the skin along its outward normal at points (n, 3) near it."""
        return self._look(points_mm)[1]

    def distance_mm(self, points_mm: Vectors) -> Array:
        """Return the distance (n,) of points (n, 3), positive outside; exact near the surface."""
        distance, shift = self._look(points_mm)
        return np.asarray(distance - shift)

    def _look(self, points_mm: Vectors) -> tuple[Array, Array]:
        """Return distance from the undisplaced skin, and displacement."""
        points, shift = np.asarray(points_mm, dtype=float).reshape(-1, 3), self.shift
        x, y, z = np.ascontiguousarray(points.T)
        parts = self.undisplaced.parts(x, y, z)
        skin = self.undisplaced.mirrored(x, parts.whole())
        moved = np.full(len(points), shift.offset_mm)
        if shift.field_mm:
            field = smooth_field(shift.seed, "skin shift", shift.field_length_mm, shift.field_order)
            moved += shift.field_mm * field.at(points)
        for size_mm, radius_mm, centre in self._events:
            squared = np.square(points - centre).sum(axis=1)
            moved += size_mm * np.exp(-0.5 * squared / radius_mm**2)
        if shift.jaw_mm:
            moved += self._jaw_mm(points, parts.jaw, skin)
        return np.asarray(skin.distance()), moved

    def normals(self, points_mm: Vectors) -> Vectors:
        """Return outward unit normals (n, 3) at points near the surface."""
        points = np.asarray(points_mm, dtype=float).reshape(-1, 3)
        steps = STEP_MM * np.concatenate([np.eye(3), -np.eye(3)])[:, None]
        ahead, behind = self.distance_mm(points + steps).reshape(2, 3, -1)  # at once: few points, many bodies
        normals = (ahead - behind).T
        return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))

    def cast(self, origins_mm: Vectors, directions: Vectors, furthest_mm: float) -> Array:
        """Return the distance (n,) along unit directions to the first hit; NaN without one."""
        start, end = self.undisplaced.fine_grid.approach(
            origins_mm, directions, furthest_mm, self._largest_mm()
        )
        return march(self.distance_mm, origins_mm, directions, end, start)

    def _largest_mm(self) -> float:
        shift = self.shift
        events = sum(max(size_mm, 0.0) for size_mm, _, _ in self._events)
        return max(shift.offset_mm, 0.0) + SURE_SIGMAS * shift.field_mm + events + abs(shift.jaw_mm)

    @cached_property
    def _events(self) -> list[tuple[float, float, Vector]]:
        """Return size, radius and centre of each local displacement."""
        shift, head = self.shift, self.in_ct
        eye = (0.5 * head.face.eye_distance_mm, head.landmarks.face_front_mm + 14.0, 0.0)
        height = head.landmarks.sellion_mm - TAPE_BELOW_MM
        sides = [(side * eye[0], eye[1], height) for side in (1.0, -1.0)]
        events = [
            *((shift.pillow_mm, PILLOW_MM, self._on_cranium(PILLOW_FROM)),),
            *((shift.pins_mm, PIN_MM, self._on_cranium(pin)) for pin in PINS),
            *((shift.tape_mm, TAPE_MM, np.add(side, head.centre_ct_mm)) for side in sides),
        ]
        return [event for event in events if event[0]]

    def _on_cranium(self, direction: Point) -> Vector:
        reach = np.linalg.norm(np.divide(direction, self.in_ct.semi_axes_mm))
        return np.asarray(np.divide(direction, reach) + self.in_ct.centre_ct_mm)

    def _jaw_mm(self, points: Vectors, jaw: Body, skin: Body) -> Array:
        """Return the displacement along the normal of a turn of the jaw about its joints."""
        head, marks = self.in_ct, self.in_ct.landmarks
        hinge = np.array([0.0, marks.ear[1], marks.ear[2] - JAW_HINGE_BELOW_MM])
        own = points - head.centre_ct_mm - hinge
        chin = np.array([0.0, marks.face_front_mm, marks.menton_mm]) - hinge
        turn = self.shift.jaw_mm / float(np.hypot(*chin[1:]))
        # Opening turns the chin down and back, about the axis to the left.
        moved_y, moved_z = -turn * own[:, 2], turn * own[:, 1]
        normals = skin.normals()
        mouth = marks.nose_base_mm + JAW_LINE_SHARE * (marks.menton_mm - marks.nose_base_mm) - hinge[2]
        below = mouth * np.clip(own[:, 1] / chin[1], 0.0, 1.0) - own[:, 2]  # the line from joints to mouth
        away = np.asarray(jaw.value)
        follows = np.clip(below / JAW_EDGE_MM, 0.0, 1.0) * np.clip(1.5 - away / JAW_EDGE_MM, 0.0, 1.0)
        return np.asarray(follows * (moved_y * normals[:, 1] + moved_z * normals[:, 2]))

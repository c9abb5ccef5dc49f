"""Objects on and around the head, such as cushions, clamps, electrodes, bandages and the x-shaped frame."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, radians

import numpy as np

from ronna_hw.x_frame import (
    BAR_BELOW_MM,
    BAR_RADIUS_MM,
    BARS,
    CLOSE_SPHERE_CENTRES_MM,
    FOOT_RADIUS_MM,
    SPHERE_CENTRES_MM,
    STANDOFF_MM,
)
from sim.errors import BAD_SCENE
from sim.phantom.head.anatomy import (
    FLANGE_MM,
    FOAM_HU,
    METAL_HU,
    SHELL_HU,
    SkinMarker,
    marker_on_foot,
    marker_on_post,
    shift_point,
)
from sim.phantom.head.painting import Streak
from sim.phantom.head.shapes import Ball, EllipsoidShell, Rod, Shape, Slab
from sim.world.rigid import Point, Vector, as_point, rotation_towards
from sim.world.scene.head import CAP_AXIS_CT, skin_at
from sim.world.scene.model import Fiducial, Head

BOARD_MM, CUSHION_MM, CUSHION_GAP_MM = 8.0, 40.0, 2.0
CUSHION_HALF_WIDTH_MM = 100.0

PIN_RADIUS_MM, PIN_MM, PIN_IN_SKULL_MM = 2.0, 35.0, 9.0
HOLDER_RADIUS_MM, HOLDER_MM, HOLDER_HU = 9.0, 30.0, 260.0  # carbon fibre
PIN_STREAK_HU, PIN_STREAK_FALL_MM, PIN_STREAK_LOBES = 250.0, 5.0, 6
PIN_AZIMUTHS_RAD = (0.15 * pi, -0.15 * pi, 0.95 * pi)  # from the patient's left towards the back
PIN_HEIGHT = 0.35  # of the head's semi-axis, below its centre

CUP_RADIUS_MM, CUP_MM, CUP_HU = 5.0, 2.0, 3500.0
LEAD_RADIUS_MM, LEAD_MM = 0.6, 60.0
BOLT_RADIUS_MM, BOLT_MM, BOLT_IN_SKULL_MM = 1.4, 30.0, 10.0

HEADS_BESIDE = 0.33  # share of amalgam balls, as large as a filling, among the metal beside markers
HEAD_BESIDE_MM, BESIDE_ABOVE_MM = 1.7, 4.0
BESIDE_RADIUS_MM, BESIDE_LENGTH_MM = (0.8, 1.5), (12.0, 22.0)

DISTRACTOR_HU = (100.0, 150.0)  # polymer, like the markers
DISTRACTOR_BALL_MM, DISTRACTOR_CYLINDER_MM = 16.0, 12.0  # diameters
CYLINDER_LENGTH_MM = (24.0, 40.0)
DISTRACTOR_STANDOFF_MM = (22.0, 32.0)

FREE, XFRAME, XFRAME_CLOSE, ADHESIVE = "free", "xframe", "xframe-close", "adhesive"
SKIN_ONLY, WITH_SKIN = "surface", "mixed"  # a head with a face, without spheres or with few
FRAMES = {XFRAME: SPHERE_CENTRES_MM, XFRAME_CLOSE: CLOSE_SPHERE_CENTRES_MM}
SPHERES = 4

TILT_RAD = radians(20.0)  # largest tilt of the foot from the middle of the cap
BAR_HU = (260.0, 2500.0)  # plastic or aluminium
FOOT_HU, FOOT_IN_SKULL_MM = 3500.0, 10.0
ATTEMPTS = 200


@dataclass(frozen=True)
class Obstacles:
    """Bodies, with the streaks from metal ones."""

    shapes: tuple[Shape, ...] = ()
    streaks: tuple[Streak, ...] = ()

    def __add__(self, other: Obstacles) -> Obstacles:
        return Obstacles(self.shapes + other.shapes, self.streaks + other.streaks)


def skin_point(head: Head, direction: Vector) -> tuple[Vector, Vector]:
    """Return the skin point in a direction from the head's centre (CT frame), and its outward normal."""
    point, normal = skin_at(direction, head.semi_axes_mm)
    return point + np.array(head.centre_ct_mm), normal


def cushion(head: Head) -> Obstacles:
    """Return a flat foam block on a board, under the back of the head."""
    back = head.centre_ct_mm[1] + head.semi_axes_mm[1] + CUSHION_GAP_MM
    x = head.centre_ct_mm[0]
    foam = Slab(FOAM_HU, (x - CUSHION_HALF_WIDTH_MM, back), (x + CUSHION_HALF_WIDTH_MM, back + CUSHION_MM))
    board = Slab(
        SHELL_HU,
        (x - CUSHION_HALF_WIDTH_MM, back + CUSHION_MM),
        (x + CUSHION_HALF_WIDTH_MM, back + CUSHION_MM + BOARD_MM),
    )
    return Obstacles((foam, board))


def clamp(head: Head, count: int, generator: np.random.Generator) -> Obstacles:
    """Return pins pressed into the skull, with their holders."""
    shapes: list[Shape] = []
    streaks = []
    for azimuth in PIN_AZIMUTHS_RAD[:count]:
        turn = azimuth + generator.uniform(-0.2, 0.2)
        skin, normal = skin_point(head, np.array([np.cos(turn), np.sin(turn), -PIN_HEIGHT]))
        outward = as_point(normal)
        tip = shift_point(as_point(skin), outward, -PIN_IN_SKULL_MM)
        shapes.append(Rod(METAL_HU, tip, outward, PIN_MM, PIN_RADIUS_MM))
        holder = shift_point(tip, outward, PIN_MM)
        shapes.append(Rod(HOLDER_HU, holder, outward, HOLDER_MM, HOLDER_RADIUS_MM))
        middle = shift_point(tip, outward, PIN_MM / 2)
        phase = float(generator.uniform(0.0, 2 * pi))
        streaks.append(
            Streak(middle, PIN_STREAK_HU, PIN_STREAK_FALL_MM, PIN_STREAK_LOBES, phase, PIN_RADIUS_MM)
        )
    return Obstacles(tuple(shapes), tuple(streaks))


def electrode(head: Head, direction: Vector) -> Obstacles:
    """Return a metal cup on the skin, with its lead running towards the feet."""
    skin, normal = skin_point(head, direction)
    outward = as_point(normal)
    downwards = np.array([0.0, 0.0, -1.0]) + 0.4 * normal  # clear of the skin
    downwards /= np.linalg.norm(downwards)
    start = shift_point(as_point(skin), outward, CUP_MM)
    return Obstacles(
        (
            Rod(CUP_HU, as_point(skin), outward, CUP_MM, CUP_RADIUS_MM),
            Rod(METAL_HU, start, as_point(downwards), LEAD_MM, LEAD_RADIUS_MM),
        )
    )


def bolt(head: Head, direction: Vector) -> Obstacles:
    """Return the bolt of a depth electrode."""
    skin, normal = skin_point(head, direction)
    outward = as_point(normal)
    start = shift_point(as_point(skin), outward, -BOLT_IN_SKULL_MM)
    return Obstacles((Rod(CUP_HU, start, outward, BOLT_IN_SKULL_MM + BOLT_MM, BOLT_RADIUS_MM),))


def metal_beside(
    fiducial: Fiducial, head: Head, apart_mm: float, hu: float, generator: np.random.Generator
) -> Obstacles:
    """Return a bare screw, or the head of one, that stands beside a marker at the height of its sphere."""
    normal = np.array(fiducial.post_ct)
    side = np.cross(normal, generator.standard_normal(3))
    side /= np.linalg.norm(side)
    centre = as_point(np.array(fiducial.centre_ct_mm) + apart_mm * side)
    if generator.uniform() < HEADS_BESIDE:
        return Obstacles((Ball(METAL_HU, centre, HEAD_BESIDE_MM),))
    top = shift_point(centre, fiducial.post_ct, float(generator.uniform(-2.0, BESIDE_ABOVE_MM)))
    down = as_point(-normal)
    length = float(generator.uniform(*BESIDE_LENGTH_MM))
    return Obstacles((Rod(hu, top, down, length, float(generator.uniform(*BESIDE_RADIUS_MM))),))


def bandage(head: Head, thickness_mm: float, hu: float) -> Obstacles:
    """Return a layer around the whole head."""
    return Obstacles((EllipsoidShell(hu, head.centre_ct_mm, head.semi_axes_mm, thickness_mm),))


def distractor(
    head: Head, direction: Vector, cylinder: bool, generator: np.random.Generator
) -> tuple[Shape, Point]:
    """Return a polymer ball or cylinder next to the head, with its centre."""
    skin, normal = skin_point(head, direction)
    middle = as_point(skin + normal * generator.uniform(*DISTRACTOR_STANDOFF_MM))
    hu = float(generator.uniform(*DISTRACTOR_HU))
    if not cylinder:
        return Ball(hu, middle, DISTRACTOR_BALL_MM / 2), middle
    # at most 45 degrees, so that it does not run into the head
    along = generator.standard_normal(3)
    along -= (along @ normal) * normal
    along = along / np.linalg.norm(along) + generator.uniform(-0.5, 0.5) * normal
    along /= np.linalg.norm(along)
    length = float(generator.uniform(*CYLINDER_LENGTH_MM))
    start = shift_point(middle, as_point(along), -length / 2)
    return Rod(hu, start, as_point(along), length, DISTRACTOR_CYLINDER_MM / 2), middle


def frame_fiducials(head: Head, frame: str, generator: np.random.Generator) -> tuple[Fiducial, ...]:
    """Place the frame's spheres; raises SIM-001 if the frame collides with the head."""
    in_frame = np.array(FRAMES[frame])
    axis = np.array(CAP_AXIS_CT) / np.linalg.norm(CAP_AXIS_CT)
    for _ in range(ATTEMPTS):
        direction = axis + np.tan(TILT_RAD) * generator.uniform(-1.0, 1.0, 3)
        skin, normal = skin_point(head, direction)
        turn = generator.uniform(0.0, 2.0 * pi)
        hint = np.array([np.cos(turn), np.sin(turn), np.sin(turn)])
        rotation = rotation_towards(normal, hint)
        centres = in_frame @ rotation.T + skin + STANDOFF_MM * normal
        if all(_is_outside(head, centre) for centre in centres):
            return tuple(
                Fiducial(number=k + 1, centre_ct_mm=as_point(centre), post_ct=as_point(normal))
                for k, centre in enumerate(centres)
            )
    raise BAD_SCENE("the x-shaped frame is not clear of the head")


def frame_markers(head: Head, generator: np.random.Generator) -> tuple[SkinMarker, ...]:
    """Create the frame's spheres on short posts in its bars, and all others on individual screws."""
    flange_mm = BAR_BELOW_MM - BAR_RADIUS_MM - FLANGE_MM
    on_frame = [marker_on_foot(one, flange_mm, BAR_BELOW_MM, generator) for one in head.fiducials[:SPHERES]]
    return (*on_frame, *(marker_on_post(one, head, generator) for one in head.fiducials[SPHERES:]))


def frame_shapes(head: Head, frame: str, generator: np.random.Generator) -> tuple[Shape, ...]:
    """Return the frame's two crossed bars and its foot."""
    first_x, third_x = FRAMES[frame][0][0], FRAMES[frame][2][0]
    hu = float(generator.choice(BAR_HU))
    down = as_point(-np.array(head.fiducials[0].post_ct))
    ends = [np.array(shift_point(one.centre_ct_mm, down, BAR_BELOW_MM)) for one in head.fiducials[:SPHERES]]
    bars: list[Shape] = []
    for first, second in BARS:
        length = float(np.linalg.norm(ends[second] - ends[first]))
        along = as_point((ends[second] - ends[first]) / length)
        bars.append(Rod(hu, as_point(ends[first]), along, length, BAR_RADIUS_MM))
    crossing = ends[0] + first_x / (first_x - third_x) * (ends[2] - ends[0])
    depth = STANDOFF_MM - BAR_BELOW_MM + FOOT_IN_SKULL_MM
    return (*bars, Rod(FOOT_HU, as_point(crossing), down, depth, FOOT_RADIUS_MM))


def _is_outside(head: Head, centre: Vector) -> bool:
    axes = np.array(head.semi_axes_mm) + BAR_BELOW_MM + BAR_RADIUS_MM
    return bool(np.linalg.norm((centre - head.centre_ct_mm) / axes) > 1.0)

"""Random patient: an ellipsoidal head, spheres on it, and trajectories between them.

Spheres are on bone screws within the cap of skin that a surgeon can reach, or on the x-shaped frame: it is
screwed to the skull by one foot, next to the entry points, and stays on from the CT to the end of the
operation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, radians, sin

import numpy as np

from ronna_hw.adhesive_marker import THICKNESS_MM
from ronna_hw.marker_template import MarkerTemplate
from ronna_hw.x_frame import BAR_BELOW_MM, BAR_RADIUS_MM, SPHERE_CENTRES_MM, STANDOFF_MM, bodies
from sim.errors import BAD_SCENE
from sim.world.head_surface.face import Measures
from sim.world.head_surface.parametric_head import ParametricHead
from sim.world.head_surface.surface import march
from sim.world.rigid import (
    Point,
    Vector,
    apply,
    as_rounded_point,
    matrix_from,
    pose_of,
    rotation_from_vector,
    rotation_towards,
)
from sim.world.scene.arm_design import KR6, ArmDesign
from sim.world.scene.model import Adhesive, Fiducial, Head
from sim.world.scene.parts import Target
from sim.world.scene.plan_feasibility import PlanFeasibility

SEMI_AXES_MM = (75.0, 95.0, 90.0)  # left-right, front-back, foot-head
CENTRE_CT_MM = (3.2, -41.7, 812.4)  # off the origin, so that a swapped axis shows
CAP_AXIS_CT = (0.0, -1.0, 1.0)  # forehead to vertex: towards the ceiling

# The frame is tilted from the middle of the cap towards the patient's left, the tracker's side: the tracker
# sees a tool up to 60 degrees off its normal.
FRAME_TILT_RAD = (radians(15.0), radians(25.0))
SIDE_RAD = radians(35.0)  # to either side of straight left
LEFT_CT = (1.0, 0.0, 0.0)
HEAD_CLEARANCE_MM = 2.0  # between skin and bars
GUIDE_CLEARANCE_MM = 26.0  # between the axis of a trajectory and spheres or bars
GUIDE_MM, SAMPLE_MM = 90.0, 3.0  # length of the guide outside the skin; spacing of points along bars
FRAME_ATTEMPTS = 2000

POSITION_SPREAD_MM = 15.0
ROTATION_SPREAD_RAD = radians(5.0)
RECLINE_RAD = radians(60.0)  # elevation of the vertex above the horizontal
CAP_HALF_ANGLE_RAD = radians(50.0)

SPHERE_STANDOFF_MM = 16.0  # skin to the centre of the sphere
SMALLEST_DISTANCE_MM = 38.0
SMALLEST_SIDE_DIFFERENCE_MM = 8.0  # in triangles: below 6 mm three points are ambiguous
JIG_MM = 0.2  # per axis: deviation of a sphere from its template position

ENTRY_HALF_ANGLE_RAD = radians(22.0)
TILT_RAD = radians(10.0)  # between a trajectory and the skin's normal
DEPTH_RANGE_MM = (35.0, 75.0)
ENTRY_CLEARANCE_MM = 28.0  # from every sphere, so that guide and cameras fit

ATTEMPTS = 20_000

# Adhesive markers: as the study's sites (`studies.heads`), but not where the head lies.
ADHESIVES_APART_MM = 25.0
LOWEST_ADHESIVE = -0.1  # share of the direction towards the vertex
MOST_BEHIND = 0.5  # share of the direction towards the back


OUTSIDE_MM = 400.0  # from the centre: outside every head

Skin = Callable[[Vector], tuple[Vector, Vector]]  # point and normal from the centre, by the direction


@dataclass(frozen=True)
class DrawnHead:
    """A head, and how many trajectories were drawn and passed over because the arm could not take them.

    Over a face that includes those on which the guide would come too close to the head. Those too close to a
    sphere or to the frame are not counted: no surgeon would plan them.
    """

    head: Head
    passed_over: int


def draw_head(
    generator: np.random.Generator,
    markers: int,
    targets: int,
    template: MarkerTemplate | None = None,
    *,
    x_frame: bool = False,
    arm: ArmDesign = KR6,
    measures: Measures | None = None,
) -> DrawnHead:
    """Draw a head with 3 to 8 spheres (`markers`) and `targets` in an arm's reach.

    Raises SIM-001 if they do not fit.

    A template fixes the spheres' places, each slightly missed; with `x_frame` they are those of the frame.
    With `measures` the head has a face, and as few spheres as are asked for.
    """
    if not (0 if measures else 3) <= markers <= 8:
        raise BAD_SCENE(
            f"a head carries 3 to 8 markers, not {markers}",
            action="Give --markers 3 to 8, or --fiducials mixed, with the skin in addition.",
        )
    if not 1 <= targets <= 10:
        raise BAD_SCENE(f"a plan has 1 to 10 targets, not {targets}")
    skin = skin_at if measures is None else skin_of(measures)
    frame = draw_frame(generator) if x_frame else None
    if frame is not None:
        fiducials = frame.fiducials
    else:
        fiducials = (
            _implant_fiducials(generator, template) if template else _draw_fiducials(generator, markers, skin)
        )
    pose = _draw_pose(generator, arm.head_mm)
    feasibility = _feasibility_of(fiducials, pose, arm.variant, measures)
    drawn, passed_over = _draw_targets(generator, targets, fiducials, pose, frame, feasibility, skin)
    head = Head(
        robot_from_ct=pose_of(pose),
        centre_ct_mm=CENTRE_CT_MM,
        semi_axes_mm=SEMI_AXES_MM if measures is None else measures.semi_axes_mm,
        face=None if measures is None else measures.face,
        fiducials=fiducials,
        x_frame=x_frame,
        template_mm=template.centres_mm if template else None,
        targets=drawn,
    )
    return DrawnHead(head, passed_over)


def stick_adhesives(head: Head, count: int, generator: np.random.Generator) -> Head:
    """Return the head with adhesive rings on its upper side, 25 mm apart or more; raises SIM-001."""
    found: list[tuple[Vector, Vector]] = []
    for _ in range(ATTEMPTS):
        direction = generator.normal(size=3)
        direction /= np.linalg.norm(direction)
        point, normal = skin_at(direction, head.semi_axes_mm)
        high = direction[2] > LOWEST_ADHESIVE and direction[1] < MOST_BEHIND
        if high and all(np.linalg.norm(point - other) > ADHESIVES_APART_MM for other, _ in found):
            found.append((point, normal))
        if len(found) == count:
            break
    else:
        raise BAD_SCENE(f"{count} adhesive markers do not fit on the head")
    adhesives = tuple(
        Adhesive(
            number=number,
            centre_ct_mm=as_rounded_point(point + 0.5 * THICKNESS_MM * normal + head.centre_ct_mm),
            normal_ct=as_rounded_point(normal),
        )
        for number, (point, normal) in enumerate(found, start=1)
    )
    return head.model_copy(update={"adhesives": adhesives})


def _draw_pose(generator: np.random.Generator, middle_mm: Point) -> Vector:
    left = np.array([0.0, 1.0, 0.0])
    superior = np.array([-cos(RECLINE_RAD), 0.0, sin(RECLINE_RAD)])
    rotation = np.column_stack([left, np.cross(superior, left), superior])
    rotation = rotation_from_vector(generator.uniform(-1, 1, 3) * ROTATION_SPREAD_RAD) @ rotation
    centre = np.array(middle_mm) + generator.uniform(-1, 1, 3) * POSITION_SPREAD_MM
    return matrix_from(centre - rotation @ np.array(CENTRE_CT_MM), rotation)


def _draw_fiducials(generator: np.random.Generator, count: int, skin: Skin) -> tuple[Fiducial, ...]:
    axis = np.array(CAP_AXIS_CT)
    for _ in range(ATTEMPTS):
        found = [skin(draw_direction(generator, axis, CAP_HALF_ANGLE_RAD)) for _ in range(count)]
        centres = np.array([point + normal * SPHERE_STANDOFF_MM for point, normal in found]).reshape(-1, 3)
        if _is_well_spread(centres):
            break
    else:
        raise BAD_SCENE(f"{count} markers do not fit on the head")
    return tuple(
        Fiducial(
            number=k + 1,
            centre_ct_mm=as_rounded_point(centres[k] + CENTRE_CT_MM),
            post_ct=as_rounded_point(found[k][1]),
        )
        for k in range(count)
    )


def _implant_fiducials(generator: np.random.Generator, template: MarkerTemplate) -> tuple[Fiducial, ...]:
    """Return the spheres of a template as implanted with its jig."""
    found = []
    for number, marker in enumerate(template.markers, start=1):
        centre = np.array(marker.centre_mm) + generator.normal(0.0, JIG_MM, 3)
        fiducial = Fiducial(number=number, centre_ct_mm=as_rounded_point(centre), post_ct=marker.post)
        height = centre - CENTRE_CT_MM
        if np.linalg.norm(height / np.array(SEMI_AXES_MM)) <= 1.0 or np.dot(height, marker.post) <= 0.0:
            raise BAD_SCENE(f"marker {number} of the template is not on this head")
        found.append(fiducial)
    return tuple(found)


def _is_well_spread(centres: Vector) -> bool:
    if not np.isfinite(centres).all():  # a ray that did not meet the skin
        return False
    if len(centres) < 2:
        return True
    rows, columns = np.triu_indices(len(centres), 1)
    distances = np.linalg.norm(centres[rows] - centres[columns], axis=1)
    if distances.min() < SMALLEST_DISTANCE_MM:
        return False
    # With three or four points the distances alone must identify them.
    if 3 <= len(centres) <= 4:
        spacing = np.diff(np.sort(distances)).min()
        return bool(spacing >= (SMALLEST_SIDE_DIFFERENCE_MM if len(centres) == 3 else 2.0))
    return True


def _centres_of(fiducials: tuple[Fiducial, ...]) -> Vector:
    return np.array([fiducial.centre_ct_mm for fiducial in fiducials]).reshape(-1, 3)


def _feasibility_of(
    fiducials: tuple[Fiducial, ...], robot_from_ct: Vector, variant: str, measures: Measures | None
) -> PlanFeasibility:
    spheres_mm = apply(robot_from_ct, _centres_of(fiducials))
    if measures is None:
        return PlanFeasibility(spheres_mm, variant)
    # Only now: the bodies of a theatre file take longer to load than a head with spheres to draw.
    from sim.world.scene.guide_clearance import GuideClearance

    head = ParametricHead(CENTRE_CT_MM, measures.semi_axes_mm, measures.face)
    return PlanFeasibility(spheres_mm, variant, GuideClearance(head, robot_from_ct, spheres_mm))


def _draw_targets(
    generator: np.random.Generator,
    count: int,
    fiducials: tuple[Fiducial, ...],
    robot_from_ct: Vector,
    frame: FrameOnHead | None,
    feasibility: PlanFeasibility,
    skin: Skin,
) -> tuple[tuple[Target, ...], int]:
    """Draw trajectories between the spheres, all within reach of the arm in one posture, and count others."""
    axis = np.array(CAP_AXIS_CT)
    spheres = _centres_of(fiducials)
    targets: list[Target] = []
    drawn: list[tuple[Vector, Vector]] = []  # entries and targets in the robot frame
    passed_over = 0
    for _ in range(ATTEMPTS):
        point, normal = skin(draw_direction(generator, axis, ENTRY_HALF_ANGLE_RAD))
        inward = draw_direction(generator, -normal, TILT_RAD)
        entry = point + CENTRE_CT_MM
        if (np.linalg.norm(spheres - entry, axis=1) < ENTRY_CLEARANCE_MM).any():
            continue
        if frame is not None and not frame.leaves_free(entry, -inward):
            continue
        target = entry + inward * generator.uniform(*DEPTH_RANGE_MM)
        ends = apply(robot_from_ct, entry), apply(robot_from_ct, target)
        if not feasibility.is_feasible([*drawn, ends]):
            passed_over += 1
            continue
        drawn.append(ends)
        targets.append(
            Target(
                identifier=f"T{len(targets) + 1}",
                entry_ct_mm=as_rounded_point(entry),
                target_ct_mm=as_rounded_point(target),
            )
        )
        if len(targets) == count:
            return tuple(targets), passed_over
    raise BAD_SCENE(f"{count} trajectories do not fit between the markers within the arm's reach")


@dataclass(frozen=True)
class FrameOnHead:
    """The x-shaped frame on the head: its spheres and points (n, 3) on its body, in the CT frame."""

    fiducials: tuple[Fiducial, ...]
    body_mm: Vector

    def leaves_free(self, entry_mm: Vector, outwards: Vector) -> bool:
        """Return whether a guide along `outwards` (unit vector) over `entry_mm` clears the frame."""
        away = self.body_mm - entry_mm
        along = np.clip(away @ outwards, 0.0, GUIDE_MM)
        lateral_mm = np.linalg.norm(away - along[:, None] * outwards, axis=1)
        return bool(lateral_mm.min() >= GUIDE_CLEARANCE_MM)


def draw_frame(generator: np.random.Generator) -> FrameOnHead:
    """Draw the frame's place on the head; raises SIM-001 if no place clears the skin."""
    axis = np.array(CAP_AXIS_CT) / np.linalg.norm(CAP_AXIS_CT)
    left = np.array(LEFT_CT)
    front = np.cross(axis, left)
    for _ in range(FRAME_ATTEMPTS):
        tilt, side = generator.uniform(*FRAME_TILT_RAD), generator.uniform(-SIDE_RAD, SIDE_RAD)
        direction = cos(tilt) * axis + sin(tilt) * (cos(side) * left + sin(side) * front)
        skin, normal = skin_at(direction)
        turn = generator.uniform(0.0, 2.0 * np.pi)
        across = np.cross(normal, front)
        rotation = rotation_towards(normal, cos(turn) * front + sin(turn) * across)
        origin = skin + CENTRE_CT_MM + STANDOFF_MM * normal
        bars, foot = bodies()[:-1], bodies()[-1]
        on_bars = np.vstack([_along(one.start_mm, one.end_mm) for one in bars]) @ rotation.T + origin
        if not _is_clear_of_head(on_bars):
            continue
        centres = np.array(SPHERE_CENTRES_MM) @ rotation.T + origin
        on_foot = _along(foot.start_mm, foot.end_mm) @ rotation.T + origin
        return FrameOnHead(
            tuple(
                Fiducial(
                    number=number,
                    centre_ct_mm=as_rounded_point(centre),
                    post_ct=as_rounded_point(normal),
                    base_mm=BAR_BELOW_MM,
                )
                for number, centre in enumerate(centres, start=1)
            ),
            np.vstack([centres, on_bars, on_foot]),
        )
    raise BAD_SCENE("the x-shaped frame is not clear of the head")


def _is_clear_of_head(points_mm: Vector) -> bool:
    axes = np.array(SEMI_AXES_MM) + BAR_RADIUS_MM + HEAD_CLEARANCE_MM
    return bool((np.linalg.norm((points_mm - CENTRE_CT_MM) / axes, axis=1) > 1.0).all())


def _along(start: tuple[float, ...], end: tuple[float, ...]) -> Vector:
    length = float(np.linalg.norm(np.subtract(end, start)))
    return np.linspace(start, end, 2 + round(length / SAMPLE_MM))


def draw_direction(generator: np.random.Generator, axis: Vector, half_angle_rad: float) -> Vector:
    """Draw a direction uniformly distributed over the solid angle of a cone."""
    cosine = generator.uniform(cos(half_angle_rad), 1.0)
    turn = generator.uniform(0.0, 2 * np.pi)
    sine = (1 - cosine**2) ** 0.5
    frame = rotation_towards(axis, (1.0, 0.0, 0.0))
    direction: Vector = frame @ np.array([sine * np.cos(turn), sine * np.sin(turn), cosine])
    return direction


def skin_at(direction: Vector, semi_axes_mm: Point = SEMI_AXES_MM) -> tuple[Vector, Vector]:
    """Return the skin point in a direction from the centre, relative to it, and its outward normal."""
    axes = np.array(semi_axes_mm)
    point = direction / np.linalg.norm(direction / axes)
    normal = point / axes**2
    return point, normal / np.linalg.norm(normal)


def skin_of(measures: Measures) -> Skin:
    """Return the function that finds the skin of a head with a face, as `skin_at` does on the ellipsoid."""
    surface = ParametricHead((0.0, 0.0, 0.0), measures.semi_axes_mm, measures.face)

    def find(direction: Vector) -> tuple[Vector, Vector]:
        start = OUTSIDE_MM * direction / np.linalg.norm(direction)
        # So few rays are not worth the distances that `cast` prepares.
        along = march(surface.distance_mm, start[None], -start[None] / OUTSIDE_MM, OUTSIDE_MM)
        point = start * (1.0 - along[0] / OUTSIDE_MM)
        return point, surface.normals(point[None])[0]

    return find

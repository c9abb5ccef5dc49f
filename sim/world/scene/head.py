"""The patient: an ellipsoid head, spheres on bone screws where a surgeon can reach, trajectories."""

from __future__ import annotations

from math import cos, radians, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronna_hw.marker_template import MarkerTemplate
from sim.errors import BadScene
from sim.world.rigid import apply, matrix_from, pose_of, rotation_from_vector
from sim.world.scene.frame import FrameOnHead, draw_frame
from sim.world.scene.model import Fiducial, Head
from sim.world.scene.plan_feasibility import PlanFeasibility
from sim.world.scene.skin import CAP_AXIS_CT, CENTRE_CT_MM, SEMI_AXES_MM, drawn_direction, skin_at
from sim.world.scene.target import Target

Vector = NDArray[np.float64]

HEAD_IN_ROBOT_MM = (760.0, 0.0, 200.0)  # keeps the wrist away from its singularity
POSITION_SPREAD_MM = 15.0
ROTATION_SPREAD_RAD = radians(5.0)
RECLINE_RAD = radians(60.0)  # of the vertex above the horizontal
CAP_HALF_ANGLE_RAD = radians(50.0)
STANDOFF_MM = 16.0  # skin to the centre of the sphere
SMALLEST_DISTANCE_MM = 38.0
SMALLEST_SIDE_DIFFERENCE_MM = 8.0  # of triangles: below 6 mm three points are ambiguous
JIG_MM = 0.2  # per axis: deviation of a sphere from its template position
ENTRY_HALF_ANGLE_RAD = radians(22.0)
TILT_RAD = radians(10.0)  # between a trajectory and the skin's normal
DEPTH_RANGE_MM = (35.0, 75.0)
ENTRY_CLEARANCE_MM = 28.0  # from every sphere, so that guide and cameras fit
ATTEMPTS = 20_000


def draw_head(
    generator: np.random.Generator,
    markers: int,
    targets: int,
    template: MarkerTemplate | None = None,
    *,
    x_frame: bool = False,
) -> Head:
    """Draw a head with this many spheres (3..8) and targets; raises SIM-001 when they do not fit.

    With a template the spheres are implanted with it, each slightly off; with `x_frame` they are the frame's.
    """
    if not 3 <= markers <= 8:
        raise BadScene(f"a head carries 3 to 8 markers, not {markers}")
    if not 1 <= targets <= 10:
        raise BadScene(f"a plan has 1 to 10 targets, not {targets}")
    frame = draw_frame(generator) if x_frame else None
    if frame is not None:
        fiducials = frame.fiducials
    else:
        fiducials = _implanted(generator, template) if template else _draw_fiducials(generator, markers)
    pose = _draw_pose(generator)
    return Head(
        robot_from_ct=pose_of(pose),
        centre_ct_mm=CENTRE_CT_MM,
        semi_axes_mm=SEMI_AXES_MM,
        fiducials=fiducials,
        x_frame=x_frame,
        template_mm=template.centres_mm if template else None,
        targets=_draw_targets(generator, targets, fiducials, pose, frame),
    )


def _draw_pose(generator: np.random.Generator) -> Vector:
    left = np.array([0.0, 1.0, 0.0])
    superior = np.array([-cos(RECLINE_RAD), 0.0, sin(RECLINE_RAD)])
    rotation = np.column_stack([left, np.cross(superior, left), superior])
    rotation = rotation_from_vector(generator.uniform(-1, 1, 3) * ROTATION_SPREAD_RAD) @ rotation
    centre = np.array(HEAD_IN_ROBOT_MM) + generator.uniform(-1, 1, 3) * POSITION_SPREAD_MM
    return matrix_from(centre - rotation @ np.array(CENTRE_CT_MM), rotation)


def _draw_fiducials(generator: np.random.Generator, count: int) -> tuple[Fiducial, ...]:
    axis = np.array(CAP_AXIS_CT)
    for _ in range(ATTEMPTS):
        found = [skin_at(drawn_direction(generator, axis, CAP_HALF_ANGLE_RAD)) for _ in range(count)]
        centres = np.array([point + normal * STANDOFF_MM for point, normal in found])
        if _well_spread(centres):
            break
    else:
        raise BadScene(f"{count} markers do not fit on the head")
    return tuple(
        Fiducial(number=k + 1, centre_ct_mm=_three(centres[k] + CENTRE_CT_MM), post_ct=_three(found[k][1]))
        for k in range(count)
    )


def _implanted(generator: np.random.Generator, template: MarkerTemplate) -> tuple[Fiducial, ...]:
    """The spheres of a template, as placed with its jig."""
    found = []
    for number, marker in enumerate(template.markers, start=1):
        centre = np.array(marker.centre_mm) + generator.normal(0.0, JIG_MM, 3)
        fiducial = Fiducial(number=number, centre_ct_mm=_three(centre), post_ct=marker.post)
        height = centre - CENTRE_CT_MM
        if np.linalg.norm(height / np.array(SEMI_AXES_MM)) <= 1.0 or np.dot(height, marker.post) <= 0.0:
            raise BadScene(f"marker {number} of the template is not on this head")
        found.append(fiducial)
    return tuple(found)


def _well_spread(centres: Vector) -> bool:
    rows, columns = np.triu_indices(len(centres), 1)
    distances = np.linalg.norm(centres[rows] - centres[columns], axis=1)
    if distances.min() < SMALLEST_DISTANCE_MM:
        return False
    # With three or four points the distances alone must identify them.
    if len(centres) <= 4:
        spacing = np.diff(np.sort(distances)).min()
        return bool(spacing >= (SMALLEST_SIDE_DIFFERENCE_MM if len(centres) == 3 else 2.0))
    return True


def _draw_targets(
    generator: np.random.Generator,
    count: int,
    fiducials: tuple[Fiducial, ...],
    robot_from_ct: Vector,
    frame: FrameOnHead | None,
) -> tuple[Target, ...]:
    """Trajectories between the spheres that the arm can reach, all in one posture."""
    axis = np.array(CAP_AXIS_CT)
    spheres = np.array([fiducial.centre_ct_mm for fiducial in fiducials])
    feasibility = PlanFeasibility(apply(robot_from_ct, spheres))
    targets: list[Target] = []
    drawn: list[tuple[Vector, Vector]] = []  # entries and targets in the robot frame
    for _ in range(ATTEMPTS):
        point, normal = skin_at(drawn_direction(generator, axis, ENTRY_HALF_ANGLE_RAD))
        inward = drawn_direction(generator, -normal, TILT_RAD)
        entry = point + CENTRE_CT_MM
        if np.linalg.norm(spheres - entry, axis=1).min() < ENTRY_CLEARANCE_MM:
            continue
        if frame is not None and not frame.leaves_free(entry, -inward):
            continue
        target = entry + inward * generator.uniform(*DEPTH_RANGE_MM)
        ends = apply(robot_from_ct, entry), apply(robot_from_ct, target)
        if not feasibility.serves([*drawn, ends]):
            continue
        drawn.append(ends)
        targets.append(
            Target(identifier=f"T{len(targets) + 1}", entry_ct_mm=_three(entry), target_ct_mm=_three(target))
        )
        if len(targets) == count:
            return tuple(targets)
    raise BadScene(f"{count} trajectories do not fit between the markers within the arm's reach")


def _three(vector: Vector) -> Any:
    return tuple(round(float(value), 6) for value in vector)

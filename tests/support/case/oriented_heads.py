"""Heads as they lie in a room, as a CT shows them, and what the step that pairs their spheres finds."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from prepared_results import checked_plan, localized_fiducials
from scipy.spatial.transform import Rotation

from procedures.engine.context import StepContext
from procedures.engine.methods import CaseMethods
from procedures.journal.results import FramedPose, StepResult
from procedures.operator.question import Question, Task
from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.planning.plan_model import FiducialKind, PatientPosition
from procedures.steps.clinical.correspondence import STEP, Correspondence
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.plan_check import CheckedPlan
from ronna_hw.arrays import Array
from ronna_hw.config import ProcedureSettings
from ronna_hw.devices.crossed_sight import SENSORS_MM
from ronna_hw.frames import Frame, Transform
from sim.polaris.measurement.line_of_sight import head_ellipsoid, visible
from sim.world.options import Carrier
from sim.world.rigid import apply, inverse, matrix_from, matrix_of, pose_of
from sim.world.scene.head import CAP_AXIS_CT, CENTRE_CT_MM, SEMI_AXES_MM, draw_direction, skin_at
from sim.world.scene.named_scenes import draw_scene

CT_MM, TRACKER_MM = 0.05, 0.15  # per axis, of a sphere
POINTER_MM = 2.0  # per axis: where a person sets a pointer on skin
HEAD_MM, ROUND_HEAD_MM = 2.0, (2.0, 8.0)  # how well the CT's ellipsoid has the centre, and its excess
LAYOUTS = ("3", "4", "5", "6", "7", "8", "flat 4", "flat 5", "xframe")
RECLINED_DEG, YAW_DEG, TURNED_DEG = (0.0, 60.0), 15.0, 5.0
STANDOFF_MM, APART_MM, FLAT_MM = 16.0, 38.0, 1.5


@dataclass(frozen=True)
class OrientedHead:
    """Spheres and head in the CT, and where they are; `turn` is what was done to the CT since."""

    image_mm: Array
    centre_mm: Array
    semi_axes_mm: Array
    robot_from_ct: Array  # (4, 4), of the CT as it should be
    robot_from_tracker: Array
    strays_mm: Array
    x_frame: bool
    turn: Array = field(default_factory=lambda: np.eye(3))
    position: str = "HFS"

    def spoilt(self, turn: Array, position: str = "HFS") -> OrientedHead:
        """The same patient, with a CT that was mirrored or turned."""
        return replace(self, turn=turn, position=position)

    def touched(self, side: tuple[float, ...], random: np.random.Generator) -> tuple[float, ...]:
        """The pointer on the patient's head, not on that of the CT."""
        skin = np.array(CENTRE_CT_MM) + np.array(SEMI_AXES_MM) * side
        return tuple((apply(self.robot_from_ct, skin) + random.normal(0.0, POINTER_MM, 3)).tolist())

    def pair(self, random: np.random.Generator) -> Correspondence:
        """The result of the step; it raises what the step raises."""
        context = _Context(self, random)
        return STEP.run(cast(StepContext, context)).result


class _Context:
    """Of a step: the results before it, and hands that touch the patient."""

    def __init__(self, head: OrientedHead, random: np.random.Generator) -> None:
        self.head, self.random = head, random
        self.setting = SimpleNamespace(settings=ProcedureSettings())
        self.clinical = SimpleNamespace(methods=CaseMethods())
        self.workcell = SimpleNamespace(rest=lambda: None)
        image = head.image_mm + random.normal(0.0, CT_MM, head.image_mm.shape)
        room = apply(head.robot_from_ct, head.image_mm)
        room = np.vstack([room + random.normal(0.0, TRACKER_MM, room.shape), head.strays_mm])
        kind = FiducialKind.XFRAME if head.x_frame else FiducialKind.FREE
        planned = checked_plan()
        changes = {
            "patient_orientation": PatientPosition(head.position),
            "implanted": len(image),
            "fiducials": kind,
        }
        ellipsoid = HeadEllipsoid(
            centre_mm=tuple((head.turn @ head.centre_mm).tolist()),
            semi_axes_mm=tuple((np.abs(head.turn) @ head.semi_axes_mm).tolist()),
        )
        self.results: dict[type, Any] = {
            LocalizedFiducials: localized_fiducials(image @ head.turn.T),
            GlobalLocalization: SimpleNamespace(
                points_mm=room[random.permutation(len(room))],
                robot_from_tracker=FramedPose.of(
                    Transform.from_matrix(Frame.ROBOT, Frame.TRACKER, head.robot_from_tracker)
                ),
            ),
            CheckedPlan: planned.model_copy(
                update={
                    "plan": planned.plan.model_copy(update=changes),
                    "implanted": len(image),
                    "head": ellipsoid,
                }
            ),
        }

    def result(self, model: type[StepResult]) -> Any:
        return self.results[model]

    def choose(self, question: Question) -> str:
        return question.answers[0]

    def perform_task(self, task: Task) -> tuple[float, ...]:
        return self.head.touched(task.numbers, self.random)


def drawn_head(layout: str, random: np.random.Generator) -> OrientedHead:
    """A head with that layout, all of its spheres in view of the tracker."""
    while True:
        scene = draw_scene(
            "default",
            seed=int(random.integers(1 << 30)),
            markers=int(layout) if layout.isdigit() else None,
            targets=1,
            fiducials=Carrier.XFRAME if layout == "xframe" else Carrier.FREE,
        )
        head = scene.head
        image = np.array([one.centre_ct_mm for one in head.fiducials])
        if layout.startswith("flat"):
            image = _flat(int(layout[-1]), random)
        robot_from_ct = _lying(matrix_of(head.robot_from_ct), random)
        robot_from_tracker = matrix_of(scene.tracker.robot_from_tracker)
        posed = head.model_copy(update={"robot_from_ct": pose_of(robot_from_ct)})
        body = head_ellipsoid(posed, inverse(robot_from_tracker))
        seen = apply(inverse(robot_from_tracker), apply(robot_from_ct, image))
        if visible(np.array(SENSORS_MM), seen, (body,)).all():
            break
    directions = random.normal(size=(int(random.integers(3)), 3))
    strays = 300.0 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return OrientedHead(
        image,
        np.array(CENTRE_CT_MM) + random.normal(0.0, HEAD_MM, 3),
        np.array(SEMI_AXES_MM) + random.uniform(*ROUND_HEAD_MM),
        robot_from_ct,
        robot_from_tracker,
        strays + apply(robot_from_ct, np.array(CENTRE_CT_MM)),
        layout == "xframe",
    )


def _lying(robot_from_ct: Array, random: np.random.Generator) -> Array:
    """The scene's head, its patient reclined and its cart turned as a theatre may have them."""
    centre = apply(robot_from_ct, np.array(CENTRE_CT_MM))
    turns = Rotation.from_euler(
        "yz",
        [random.uniform(*RECLINED_DEG) - RECLINED_DEG[1], random.uniform(-YAW_DEG, YAW_DEG)],
        degrees=True,
    )
    own = Rotation.from_rotvec(random.uniform(-TURNED_DEG, TURNED_DEG, 3), degrees=True)
    rotation = (own * turns).as_matrix() @ robot_from_ct[:3, :3]
    return np.asarray(matrix_from(centre - rotation @ np.array(CENTRE_CT_MM), rotation))


def _flat(count: int, random: np.random.Generator) -> Array:
    """Spheres on bases of such lengths that all are nearly in one plane."""
    axis = np.array(CAP_AXIS_CT) / np.linalg.norm(CAP_AXIS_CT)
    while True:
        found = [skin_at(draw_direction(random, axis, np.radians(45.0))) for _ in range(count)]
        points = np.array([point + normal * STANDOFF_MM for point, normal in found])
        middle = points[:3].mean(axis=0)
        normal = np.cross(points[1] - points[0], points[2] - points[0])
        normal /= np.linalg.norm(normal)
        heights = (points - middle) @ normal
        flat = points - np.outer(heights - random.uniform(-FLAT_MM, FLAT_MM, count), normal)
        apart = np.linalg.norm(flat[:, None] - flat[None], axis=2)[np.triu_indices(count, 1)]
        outside = np.linalg.norm(flat / SEMI_AXES_MM, axis=1) > 1.1
        if apart.min() > APART_MM and np.diff(np.sort(apart)).min() > 2.0 and outside.all():
            return flat + CENTRE_CT_MM

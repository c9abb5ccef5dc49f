"""Localization strategies on arms identified as by `ronna-arm calibrate`, with the remaining errors.

A trial is arm x position of the phantom x target x strategy x number of spheres, which are as far off their
places in the CT as in a case. Each arm is identified once, at the phantom's first position, and used at all
positions. Identification measures the phantom's own spheres with the simulator's true arm, and uses the
procedure's choice of poses and its fit. All is in this process, without protocols or images. The controller
then uses the identified arm in place of the true one, including the side of its backlash on which each joint
rests.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from procedures.calibration.arm_calibration import ArmFit, identify
from procedures.calibration.arm_model import ArmModel, LookArrays, choose_poses
from procedures.calibration.pose_set import plan_centred_looks
from procedures.registration.rigid_fit import RigidFit, fit_rigid
from procedures.steps.calibration.sphere_looks import CANDIDATES, flanks_of
from ronna_hw.arm.pose import Pose
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.deviations import ArmDeviations, flange_poses
from ronna_hw.calibrated_arm.error_budget import ErrorSizes, IdentifiedArm
from ronna_hw.errors import LimitError
from ronna_hw.frames import Transform
from sim.world.true_arm import TrueArm
from studies.accuracy.phantom import Markers, draw_phantom, phantom_pose
from studies.accuracy.postures import ARM, TOOL, TOOL_MM, Postures
from studies.accuracy.random_arms import RandomArms, draw_numbered_arm, solve_joints
from studies.accuracy.scene import AXES, FINE_CT_MM, Sizes, StudiedScene
from studies.campaign import bounds
from studies.campaign.plots import boxes
from studies.campaign.study import Study, Sums, Table, Unit, blocks
from studies.strategies.study import DEPTHS_MM, PLACES, TARGETS

LOOKS = 90  # the default of `ronna-arm calibrate`
STEREO_MM = 0.005  # of a measurement, per axis
LOOKS_KEY = 9  # of the random numbers
STRATEGIES = ("nos", "ocs", "jdms", "improved")
BLOCK_ARMS = 10
CELL, OF_ARM, PREDICTED = "arms", "arm", "predicted"
# Assumed when choosing poses: tool frame and arm known to about a tenth.
EXPECTED = ErrorSizes(tool_mm=0.1, links=0.1, joints=0.1, backlash=0.1)
GOAL_MM = 0.13
HIGHEST = 99.0  # per cent


@dataclass(frozen=True)
class IdentifiedStudy(Study):
    """Study of `arms` random arms of set S, each identified first and then used at all positions."""

    arms: int = 100
    seed: int = 0
    name: str = "strategies-identified"

    constants: ClassVar = {"places": PLACES, "targets": TARGETS, "looks": LOOKS, "ct_mm": FINE_CT_MM}

    def units(self) -> Sequence[Unit]:
        return blocks(CELL, self.arms, BLOCK_ARMS)

    def run(self, unit: Unit) -> Sums:
        """Return errors in mm, keyed `strategy|spheres|arm|place|target`, and per arm, `arm|number|what`.

        Predicted, as sums: predicted|strategy|spheres|inside, rms2.
        """
        drawn = draw_phantom(Markers.FREE, DEPTHS_MM, TARGETS)
        scenes = [StudiedScene.of(self.seed, drawn, Markers.FREE, number) for number in range(1, PLACES + 1)]
        planned = {
            (scene.number, strategy): scene.planned(strategy, EXPECTED)
            for scene in scenes
            for strategy in STRATEGIES
        }
        spheres = phantom_pose(1).apply(drawn.spheres_mm)
        first = unit.block * BLOCK_ARMS
        found: Sums = defaultdict(float)
        for number in range(first, first + unit.runs):
            fit = identify_arm(self.seed, number, spheres)
            apart_rad = fit.deviations.backlash_rad - np.array(
                draw_numbered_arm(self.seed, number)[0].backlash_rad
            )
            found[f"{OF_ARM}|{number}|backlash2"] = float(np.mean(np.degrees(apart_rad) ** 2))
            found[f"{OF_ARM}|{number}|scatter"] = fit.scatter_mm
            believed = BelievedArm(fit.deviations, fit.flange_from_tool)
            arm = RandomArms.draw(self.seed, [number])
            known = IdentifiedArm(fit.remaining, fit.deviations.backlash_rad, fit.scatter_mm)
            remaining = ErrorSizes(identified=known)
            for scene in scenes:
                for strategy in STRATEGIES:
                    poses = planned[scene.number, strategy]
                    case = IdentifiedCase(arm, believed, poses, scene, [number])
                    errors = case.errors_mm(Sizes(FINE_CT_MM))
                    predictions = scene.predictions(poses, remaining, FINE_CT_MM)
                    for (target, count), length in np.ndenumerate(np.linalg.norm(errors, axis=-1)):
                        series = f"{strategy}|{scene.counts[count]}"
                        found[f"{series}|{number}|{scene.number}|{target + 1}"] = float(length)
                        one = predictions[count][target]
                        found[f"{PREDICTED}|{series}|inside"] += float(
                            one.mark_contained(errors[target, count])
                        )
                        found[f"{PREDICTED}|{series}|rms2"] += one.rms_mm**2
        return dict(found)


def tables(sums: Mapping[str, Sums]) -> list[Table]:
    """Tabulate the target errors, and the arm errors remaining after identification."""
    errors = _collect_errors(sums)
    arms, predictions = defaultdict(list), defaultdict[str, float](float)
    for content in sums.values():
        for key, value in content.items():
            if key.startswith(f"{OF_ARM}|"):
                arms[key.split("|")[2]].append(value)
            elif key.startswith(f"{PREDICTED}|"):
                predictions[key] += value
    return [
        Table.of(
            "Arms as they are identified",
            [
                {
                    "strategy": strategy,
                    "spheres": count,
                    "trials": each.size,
                    "mean mm": float(np.mean(each)),
                    bounds.column("mean"): bounds.mean_length(each.mean(axis=1)).text,
                    f"{HIGHEST:.0f} % below": float(np.percentile(each, HIGHEST)),
                    "largest mm": float(np.max(each)),
                    "goal mm": GOAL_MM,
                }
                for (strategy, count), each in errors.items()
            ],
            f"Set S, free spheres, {FINE_CT_MM} mm 3-D rms off their places, seating included. Each arm "
            f"identified from {LOOKS} measurements of the phantom's spheres. {bounds.CAPTION}: of the mean, "
            "from the scatter of the arms (Student).",
        ),
        Table.of(
            "Predicted and actual error",
            [
                {
                    "strategy": strategy,
                    "spheres": count,
                    "trials": each.size,
                    "inside 95 % region %": (
                        100.0 * predictions[f"{PREDICTED}|{strategy}|{count}|inside"] / each.size
                    ),
                    "predicted rms mm": float(
                        np.sqrt(predictions[f"{PREDICTED}|{strategy}|{count}|rms2"] / each.size)
                    ),
                    "actual rms mm": float(np.sqrt(np.mean(each**2))),
                }
                for (strategy, count), each in errors.items()
            ],
            "The prediction knows the covariance that the identification of each arm has left.",
        ),
        Table.of(
            "What the identification leaves",
            [
                {
                    "arms": len(arms["scatter"]),
                    "backlash deg rms": float(np.sqrt(np.mean(arms["backlash2"]))),
                    "random error mm per axis": float(np.mean(arms["scatter"])),
                }
            ],
            "Backlash of set S is 0.02 deg. The random error is estimated from the measurements themselves.",
        ),
    ]


def plots(sums: Mapping[str, Sums]) -> dict[str, bytes]:
    groups = {
        f"{strategy} {count}": each.ravel() for (strategy, count), each in _collect_errors(sums).items()
    }
    return {"strategies-identified.png": boxes("Error at the target, identified arms", "mm", groups)}


def _collect_errors(sums: Mapping[str, Sums]) -> dict[tuple[str, int], NDArray[np.float64]]:
    """Collect the errors of each strategy and sphere count, (arms, trials) in mm."""
    found: dict[tuple[str, int], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for content in sums.values():
        for key, error_mm in content.items():
            strategy, count, arm, *_ = key.split("|")
            if strategy in STRATEGIES:
                found[strategy, int(count)][arm].append(error_mm)
    ordered = sorted(found.items(), key=lambda one: (STRATEGIES.index(one[0][0]), one[0][1]))
    return {series: np.array(list(arms.values())) for series, arms in ordered}


def identify_arm(seed: int, number: int, spheres_mm: Array) -> ArmFit:
    """Identify arm `number` from simulated measurements of spheres (n, 3), mm in the robot frame.

    Raises CAL-002 to CAL-004.
    """
    model = ArmModel(ARM, TOOL)
    looks, _ = plan_arm_looks(model, spheres_mm)
    arm = TrueArm(draw_numbered_arm(seed, number)[0], number)
    return identify(model, measure_looks(looks, seed, number, spheres_mm, arm.at_rest))


def plan_arm_looks(
    model: ArmModel, spheres_mm: Array, validation: int = 0
) -> tuple[LookArrays, NDArray[np.bool_]]:
    """Choose measurements for the fit, and `validation` further ones spread evenly over the other poses.

    Returns them without their points, and which ones are held out.
    """
    candidates = _list_candidates(spheres_mm)
    chosen = np.zeros(len(candidates.joints_rad), dtype=bool)
    chosen[choose_poses(model, candidates, LOOKS)] = True
    held_out = np.zeros_like(chosen)
    rest = np.flatnonzero(~chosen)
    held_out[rest[np.linspace(0, len(rest) - 1, validation).round().astype(int)]] = True
    return candidates.only(chosen | held_out), held_out[chosen | held_out]


def measure_looks(
    looks: LookArrays,
    seed: int,
    number: int,
    spheres_mm: Array,
    at_rest: Callable[[Sequence[float], Sequence[float], int], Array],
) -> LookArrays:
    """Measure the planned looks with arm `number`.

    `at_rest` returns its flange (4, 4) by joints, sides and row.
    """
    _, tool_error_mm = draw_numbered_arm(seed, number)
    generator = np.random.default_rng([seed, LOOKS_KEY, number])
    points_mm = np.empty_like(looks.points_mm)
    for row, (joints, flanks) in enumerate(
        zip(looks.joints_rad.tolist(), looks.flanks.tolist(), strict=True)
    ):
        flange = at_rest(joints, flanks, row)
        away = spheres_mm[looks.sphere[row]] - flange[:3, 3]
        points_mm[row] = flange[:3, :3].T @ away - TOOL_MM - tool_error_mm
    return replace(looks, points_mm=points_mm + generator.normal(0.0, STEREO_MM, points_mm.shape))


def _list_candidates(spheres_mm: Array) -> LookArrays:
    """Return the candidate measurement poses that the nominal arm can reach."""
    reference, branch = ARM.flange_pose(ARM.home_rad).rigid.rotation, ARM.branch_of(ARM.home_rad)
    found = []
    for number, sphere in enumerate(spheres_mm):
        for order, look in enumerate(plan_centred_looks(reference, sphere, CANDIDATES)):
            try:
                joints = ARM.solve_branch(
                    Pose.from_transform(look.pose @ TOOL.inverse()), branch, ARM.home_rad
                )
            except LimitError:
                continue
            found.append((number, joints, flanks_of(order, len(joints))))
    return LookArrays(
        joints_rad=np.array([joints for _, joints, _ in found]),
        flanks=np.array([flanks for _, _, flanks in found], dtype=float),
        points_mm=np.zeros((len(found), AXES)),
        covariances_mm2=np.tile(STEREO_MM**2 * np.eye(AXES), (len(found), 1, 1)),
        sphere=np.array([number for number, _, _ in found], dtype=np.intp),
    )


@dataclass(frozen=True)
class BelievedArm:
    """Arm model used by the controller."""

    deviations: ArmDeviations
    flange_from_tool: Transform

    def tool(self, joints_rad: Array, flanks: Array) -> tuple[Array, Array]:
        """Return the tool positions (p, 3) in mm and orientations (p, 3, 3) at joints (p, 6), robot frame."""
        poses = flange_poses(ARM.chain, self.deviations, joints_rad, flanks)
        turned = poses[:, :3, :3]
        places = turned @ self.flange_from_tool.translation_mm + poses[:, :3, 3]
        return places, turned @ self.flange_from_tool.rotation_matrix


@dataclass(frozen=True)
class IdentifiedCase:
    """Localizations and targets of one arm by a controller that believes in its identified model."""

    arm: RandomArms
    believed: BelievedArm
    planned: Postures
    scene: StudiedScene
    numbers: Sequence[int]  # of the arm, for its random numbers

    def errors_mm(self, sizes: Sizes) -> Array:
        """Return the error vectors (t, c, 3) in mm, like `StudiedScene.errors_mm` for many arms."""
        image, recorded = self.record_spheres_mm(sizes)
        fits = [fit_rigid(image[None, :count], recorded[:, :count]) for count in self.scene.counts]
        return np.stack([self.reach_targets_mm(fit) for fit in fits], axis=1)

    def record_spheres_mm(self, sizes: Sizes) -> tuple[Array, Array]:
        """Return the spheres as imaged (n, 3) and as recorded in each set (s, n, 3), mm."""
        planned, scene = self.planned, self.scene
        chance, sets = scene.chance(self.numbers), planned.sets
        spheres = scene.robot_from_ct.apply(scene.phantom.spheres_mm)
        _, seen = solve_joints(
            planned.localizations,
            lambda joints: self.believed.tool(joints, planned.arrival),
            lambda joints, _: (
                np.tile(spheres, (sets, 1)) - self.arm.tool_points_mm(joints[None], planned.arrival[None])[0]
            ),
            planned.localizations.joints_rad.shape,
        )
        recorded = seen.reshape(sets, len(spheres), AXES)
        recorded = recorded + sizes.servo_mm / np.sqrt(AXES) * chance.servo[0, :sets]
        recorded = recorded + self.arm.repeatability_mm * chance.rest[0, :sets]
        return scene.phantom.spheres_mm + sizes.ct_mm / np.sqrt(AXES) * chance.ct[0], recorded

    def reach_targets_mm(self, fit: RigidFit) -> Array:
        """Return the error vectors (t, 3) in mm at the targets, by the registration of each set."""
        planned, scene = self.planned, self.scene
        targets_ct = np.array([one.target_mm for one in scene.phantom.trajectories])
        serving = [planned.set_of(target) for target in range(len(targets_ct))]
        places = np.einsum("tij,tj->ti", fit.rotation[serving], targets_ct) + fit.translation_mm[serving]
        joints, _ = solve_joints(
            planned.targets,
            lambda joints: self.believed.tool(joints, planned.target_arrival),
            lambda _, at: places - at,
            planned.targets.joints_rad.shape,
        )
        tips = self.arm.tool_points_mm(joints[None], planned.target_arrival[None])[0]
        tips = tips + self.arm.repeatability_mm * scene.chance(self.numbers).target_rest[0]
        return np.asarray(tips - scene.robot_from_ct.apply(targets_ct))

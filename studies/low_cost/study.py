"""PAPER 2's experiment on simulated arms: arm alone, calibration, positioning with and without feedback.

F. Šuligoj's thesis describes it in words and prints no figure of it, and the paper was not found: only
relations between the figures, and a peer study, can be judged.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.universal_robots import universal_robot
from ronna_hw.frames import Frame, Transform
from sim.world.rigid import matrix_of
from sim.world.scene.model import ArmTruth, Scene
from sim.world.world import World
from studies.campaign.study import Study, Sums, Table, Unit
from studies.low_cost import tables
from studies.low_cost.arms import InstantArm, PositionedArm, drive_arm, factory_kinematics
from studies.low_cost.calibration import FrameCalibration, calibrate, take_looks
from studies.low_cost.devices import open_room, require_look
from studies.low_cost.figures import (
    NOMINAL_ERROR_KEY,
    REPEATABILITY_KEY,
    CalibrationMethod,
    DimensionSource,
    Extent,
    Fit,
    Place,
    Quantity,
    absolute_key,
    fit_key,
)
from studies.low_cost.judge import Judge, measure_accuracy_mm, measure_repeatability_mm, named_pose
from studies.low_cost.positioning import BelievedPositioning, TipModel, TipPositioner
from studies.low_cost.preparation import Preparation
from studies.low_cost.room import MODEL, PHANTOM_MM, TIP_IN_FLANGE_MM, draw_room, draw_ur5, nominal_error_mm
from studies.low_cost.targets import ORIENTATIONS_RAD, REFERENCE, StudiedTarget, draw_targets, oriented

# Workspace that arm and tracker share, about a point above the phantom: the five poses of ISO 9283's cube,
# which the looks of the calibration are taken about too, and more for the absolute error.
CUBE_MM = ((0, 0, 0), (120, 120, 80), (120, -120, -40), (-120, -120, 80), (-120, 120, -40))
ABOVE_MM = (0.0, 0.0, 60.0)
ACCURACY_POSES = 100
ACCURACY_HALF_MM = (150.0, 150.0, 100.0)
ACCURACY_KEY = 9283  # of the random numbers


@dataclass(frozen=True)
class LowCostStudy(Study):
    """Study of `arms` UR5 in one room, each at `targets` points in three orientations."""

    arms: int
    targets: int
    seed: int
    frames: int  # averaged for one look
    preparation: Preparation
    over_the_wire: bool = False  # the arm too: behind its driver and a simulated controller

    @property
    def name(self) -> str:
        return study_name(over_the_wire=self.over_the_wire)

    def settings(self) -> dict[str, object]:
        return {
            "arms": self.arms,
            "targets": self.targets,
            "orientations": len(ORIENTATIONS_RAD),
            "seed": self.seed,
            "frames": self.frames,
            "scans": len(self.preparation.scans_mm),
            "over_the_wire": self.over_the_wire,
            "preparation_sha256": hashlib.sha256(self.preparation.model_dump_json().encode()).hexdigest(),
        }

    def units(self) -> Sequence[Unit]:
        return [Unit(f"arm {number}", 0, 1) for number in range(self.arms)]

    def run(self, unit: Unit) -> Sums:
        """Return an arm's figures, named as in `figures`."""
        number = int(unit.condition.split()[1])
        truth = draw_ur5(self.seed, number, self.arms)
        scene = draw_room(self.seed).model_copy(update={"arm": truth})
        sums: Sums = {NOMINAL_ERROR_KEY: nominal_error_mm(truth)}
        with open_room(scene) as (world, tracker), self._open_arm(world, truth, number) as (arm, factory):
            models, judge = (
                {DimensionSource.NOMINAL: universal_robot(MODEL), DimensionSource.FACTORY: factory},
                Judge(scene, world),
            )
            drawn = TipModel(models[DimensionSource.NOMINAL], _drawn_tip())
            sums |= _measure_alone(arm, judge, drawn, models, self.seed)
            points = [np.add(PHANTOM_MM, ABOVE_MM) + place for place in CUBE_MM]
            looks = take_looks(arm, tracker, drawn, points, self.frames)
            known = {}
            for name, kinematics in models.items():
                found = calibrate(looks, kinematics)
                known[name] = BelievedPositioning.of(kinematics, found.fit, self.preparation.tip_from_marker)
                sums |= _collect_calibration(name, found)
            positioner = TipPositioner(arm, tracker, self.preparation.tip_from_marker, self.frames)
            for target in plan_targets(scene, self.seed, self.targets):
                wanted = self.preparation.registration @ target.ct_from_tool
                phantom = require_look(tracker, self.frames).phantom
                # Method 2 continues from where the nominal arm took itself, so that comes last.
                for name in (DimensionSource.FACTORY, DimensionSource.NOMINAL):
                    commanded = positioner.aim(known[name], phantom, wanted)
                    opened = Place(CalibrationMethod.OPEN, name, target.orientation, target.number)
                    sums |= judge.error(target).sums(opened)
                reached = positioner.iterate(known[DimensionSource.NOMINAL], commanded, wanted)
                closed = opened._replace(method=CalibrationMethod.CLOSED)
                sums |= judge.error(target).sums(closed)
                sums[closed.key(Quantity.ROUNDS)] = float(reached.rounds)
                sums[closed.key(Quantity.SETTLED)] = float(reached.residual.is_settled)
        return sums

    def tables(self, sums: Mapping[str, Sums]) -> list[Table]:
        return tables.tables(self.preparation, sums)

    def plots(self, sums: Mapping[str, Sums]) -> dict[str, bytes]:
        return tables.plots(sums)

    @contextmanager
    def _open_arm(
        self, world: World, truth: ArmTruth, number: int
    ) -> Iterator[tuple[PositionedArm, Kinematics]]:
        """Open an arm, with the kinematics that its factory states."""
        if self.over_the_wire:
            with drive_arm(world) as driven:
                yield driven, driven.kinematics
        else:
            noise_seed = self.seed * self.arms + number
            yield InstantArm(truth, world, noise_seed), factory_kinematics(truth, noise_seed)


def study_name(*, over_the_wire: bool) -> str:
    return "low-cost-over-the-wire" if over_the_wire else "low-cost"


def plan_targets(scene: Scene, seed: int, count: int) -> tuple[StudiedTarget, ...]:
    """Draw the targets of a room, in orientations that suit how the phantom lies on the table."""
    turned = Rotation.from_matrix(matrix_of(scene.head.robot_from_ct)[:3, :3])
    head = scene.head
    return draw_targets(seed, count, np.array(head.centre_ct_mm), np.array(head.semi_axes_mm), turned.inv())


def _drawn_tip() -> Transform:
    return Transform.of(
        Frame.FLANGE, Frame.TOOL, translation_mm=TIP_IN_FLANGE_MM, quaternion_wxyz=(1.0, 0.0, 0.0, 0.0)
    )


def _measure_alone(
    arm: PositionedArm, judge: Judge, drawn: TipModel, models: Mapping[DimensionSource, Kinematics], seed: int
) -> Sums:
    """Measure repeatability and absolute error of the arm, over the same poses for every arm."""
    centre = np.add(PHANTOM_MM, ABOVE_MM)
    cube = [named_pose(centre + place, REFERENCE) for place in CUBE_MM]
    sums: Sums = {REPEATABILITY_KEY: measure_repeatability_mm(arm, judge, drawn, cube)}
    random = np.random.default_rng([seed, ACCURACY_KEY])
    poses = [
        named_pose(
            centre + random.uniform(-1.0, 1.0, 3) * ACCURACY_HALF_MM, oriented(number % len(ORIENTATIONS_RAD))
        )
        for number in range(ACCURACY_POSES)
    ]
    for name, errors in measure_accuracy_mm(arm, judge, drawn, poses, models).items():
        sums |= {
            absolute_key(name, Extent.MEAN): float(errors.mean()),
            absolute_key(name, Extent.LARGEST): float(errors.max()),
        }
    return sums


def _collect_calibration(dimensions: DimensionSource, found: FrameCalibration) -> Sums:
    figures = {
        Fit.SCATTER_MM: found.fit.scatter_mm,
        Fit.SCATTER_DEG: float(np.degrees(found.fit.scatter_rad)),
        Fit.LOOKS: float(len(found.fit.used)),
        Fit.HELD_OUT_MM: found.held_out_mm,
        Fit.HELD_OUT_DEG: float(np.degrees(found.held_out_rad)),
    }
    return {fit_key(dimensions, fit): figure for fit, figure in figures.items()}

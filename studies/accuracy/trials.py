"""Localize, register, go to the target: many arms at one position of the phantom.

Every random number belongs to the seed, the markers, the arm and the position, so an error does not
depend on which arms are run together. The CT of an arm's phantom is scanned once and used in all
positions, as in the thesis; the orientation at the target is the planned one, since the finer transform
turns it by less than a degree.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from procedures.calibration.arm_sources import SERVO_MM
from procedures.registration.rigid_fit import fit_rigid
from ronna_hw.frames import Transform
from studies.accuracy.phantom import Markers, Phantom
from studies.accuracy.postures import Postures
from studies.accuracy.random_arms import RandomArms, Source, centre_on_spheres, reach_positions

Array = NDArray[np.float64]

CT_FLE_MM = 0.38  # parameter set S: 3-D rms of a sphere in the CT, including reseating
AXES = 3
CT_KEY, LOOKS_KEY = 7, 8  # of the random numbers


@dataclass(frozen=True)
class Chance:
    """Random draws for `a` arms besides the arms themselves; unit standard deviation per axis."""

    ct: Array  # (a, n, 3)
    servo: Array  # (a, s, n, 3) of every localization
    rest: Array  # (a, s, n, 3) the same, for the arm at rest
    sides: Array  # (a, s, n, 6) -1 or 1: side on which the servo's last step may leave each joint
    target_rest: Array  # (a, t, 3) for the arm at rest at the target

    @classmethod
    def draw(
        cls,
        seed: int,
        markers: Markers,
        arms: Sequence[int],
        place: int,
        shape: tuple[int, int],
        *,
        scan_again: bool = False,
    ) -> Self:
        """Draw for arms with these numbers at a position; `shape` is targets, spheres.

        Strategies share the draws, so they are compared on equal terms. `scan_again` scans the
        CT at every position.
        """
        kind = zlib.crc32(markers.encode())
        targets, spheres = shape
        rows = []
        for number in arms:
            scan = [CT_KEY, number, place] if scan_again else [CT_KEY, number]
            ct = np.random.default_rng(np.random.SeedSequence([seed, kind, *scan]))
            looks = np.random.default_rng(np.random.SeedSequence([seed, kind, LOOKS_KEY, number, place]))
            rows.append(
                (
                    ct.normal(size=(spheres, AXES)),
                    looks.normal(size=(targets, spheres, AXES)),
                    looks.normal(size=(targets, spheres, AXES)),
                    looks.choice((-1.0, 1.0), size=(targets, spheres, 6)),
                    looks.normal(size=(targets, AXES)),
                )
            )
        return cls(*(np.array(column) for column in zip(*rows, strict=True)))


@dataclass(frozen=True)
class Sizes:
    """Errors outside the arm, 3-D rms in mm."""

    ct_mm: float = CT_FLE_MM
    servo_mm: float = SERVO_MM

    def only(self, source: Source) -> Sizes:
        """Keep one source only."""
        return Sizes(
            self.ct_mm if source is Source.CT else 0.0, self.servo_mm if source is Source.REST else 0.0
        )


def target_errors(
    arms: RandomArms,
    planned: Postures,
    phantom: Phantom,
    robot_from_ct: Transform,
    chance: Chance,
    counts: Sequence[int],
    sizes: Sizes,
    *,
    any_side: bool = False,
) -> Array:
    """Error vectors (a, t, c, 3) mm, robot frame: tip minus target, for each number of spheres in `counts`.

    With `any_side`, the servo's last step leaves each joint on either side of its backlash at the spheres;
    without it, the line of approach to a sphere decides, or a strategy that controls the approach.
    """
    spheres = robot_from_ct.apply(phantom.spheres_mm)
    targets_ct = np.array([one.target_mm for one in phantom.trajectories])
    recorded = _localized(arms, planned, spheres, chance, sizes, any_side)
    image = phantom.spheres_mm + sizes.ct_mm / np.sqrt(AXES) * chance.ct
    serving = [planned.set_of(target) for target in range(len(targets_ct))]
    flanks = np.broadcast_to(planned.target_arrival, (len(arms), *planned.target_arrival.shape))
    true_targets = robot_from_ct.apply(targets_ct)
    found = []
    for count in counts:
        fit = fit_rigid(image[:, None, :count], recorded[:, :, :count])
        places = np.einsum("atij,tj->ati", fit.rotation[:, serving], targets_ct)
        joints = reach_positions(arms, planned.targets, places + fit.translation_mm[:, serving])
        tips = arms.tool_points_mm(joints, flanks) + arms.repeatability_mm * chance.target_rest
        found.append(tips - true_targets)
    return np.stack(found, axis=2)


def _localized(
    arms: RandomArms, planned: Postures, spheres_mm: Array, chance: Chance, sizes: Sizes, any_side: bool
) -> Array:
    """Believed positions of the spheres, (a, s, n, 3) mm."""
    count, sets = len(spheres_mm), planned.sets
    sides = np.broadcast_to(planned.arrival, (len(arms), *planned.arrival.shape))
    if any_side:
        sides = chance.sides[:, :sets].reshape(sides.shape)
    _, believed = centre_on_spheres(arms, planned.localizations, np.tile(spheres_mm, (sets, 1)), sides)
    noise = sizes.servo_mm / np.sqrt(AXES) * chance.servo + arms.repeatability_mm * chance.rest
    return np.asarray(believed.reshape(len(arms), sets, count, AXES) + noise[:, :sets])

"""Equations and printed tables of the thesis, evaluated beside solutions that share nothing with them.

Chapter 2 on random angles and head markers: each formula beside another way to the same value. Tables 2 to 4:
the figure printed below the rows beside what the rows give.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from procedures.registration.error_theory import (
    fle_of_one_space_mm,
    pose_covariance,
    target_covariance_mm2,
    tre_principal_axes_mm,
)
from procedures.registration.point_registration import register
from procedures.registration.rigid_fit import fit_rigid
from ronna_hw.arrays import Array
from studies.campaign.study import Cell, Table
from studies.heads import PATIENTS, draw_pose, sites_mm
from studies.thesis_tables import (
    AVERAGE_OPERATOR,
    FIDUCIALS_OF_TABLE_3,
    HUMAN_OPERATORS,
    SPHERE_FIT,
    TABLE_2,
    TABLE_3,
    TABLE_4,
    ThesisColumn,
)

DRAWS = 200  # of angles, and of heads
LARGEST_ANGLE_RAD = 1.5  # below the right angle, at which alpha and gamma turn about one axis
NOISE_MM = 0.3  # of the markers, per axis
TARGET_MM = np.array([0.0, 0.0, -60.0])  # from the middle of the markers, deep in the head
SHOWN_ANGLES_RAD = (0.3, 0.4, 0.5)  # those of the page on chapter 2
MIRROR = np.array([1.0, 1.0, -1.0])


@dataclass(frozen=True)
class Check:
    """An equation, what it gives, its witness, and the largest difference between the two over all draws."""

    equation: str
    gives: str
    against: str
    largest_difference: float
    unit: str


def evaluate_equations(seed: int = 0) -> list[Check]:
    """Evaluate the equations of chapter 2 on draws of this seed."""
    random = np.random.default_rng(seed)
    checks = [*_check_angles(random), *_check_fits(random)]
    return sorted(checks, key=lambda one: int(one.equation.split(",")[0].split()[0]))


def euler_matrix(alpha: Array, beta: Array, gamma: Array) -> Array:
    """Write out the matrices (n, 3, 3) of eq. 16; first row and last column hold the angles."""
    (sa, sb, sg), (ca, cb, cg) = np.sin([alpha, beta, gamma]), np.cos([alpha, beta, gamma])
    rows = (
        (cb * cg, cb * sg, sb),
        (-ca * sg - sa * sb * cg, ca * cg - sa * sb * sg, sa * cb),
        (sa * sg - ca * sb * cg, -sa * cg - ca * sb * sg, ca * cb),
    )
    return np.moveaxis(np.array(rows), -1, 0)


def _check_angles(random: np.random.Generator) -> Iterator[Check]:
    alpha, beta, gamma = np.vstack(
        [SHOWN_ANGLES_RAD, random.uniform(-LARGEST_ANGLE_RAD, LARGEST_ANGLE_RAD, (DRAWS, 3))]
    ).T
    matrix = euler_matrix(alpha, beta, gamma)
    x, y, z = (
        Rotation.from_euler(axis, angle[:, None]).as_matrix()
        for axis, angle in (("x", alpha), ("y", beta), ("z", gamma))
    )
    product = x.swapaxes(-1, -2) @ y @ z.swapaxes(-1, -2)
    usual = Rotation.from_euler("XYZ", np.array([-alpha, beta, -gamma]).T).as_matrix()
    yield Check("15", "product, transposed about x and z", "matrix of eq. 16", _largest(product - matrix), "")
    yield Check("16", "matrix of three angles", "SciPy's Rotation", _largest(matrix - usual), "")
    r12, r13, r23, r33 = matrix[:, 0, 1], matrix[:, 0, 2], matrix[:, 1, 2], matrix[:, 2, 2]
    cosine = np.sqrt(1.0 - r13**2)
    of_r11 = matrix[:, 0, 0] / cosine
    read = {
        ("17 and 18", "alpha, beta"): np.array([np.arctan2(r23, r33) - alpha, np.arcsin(r13) - beta]),
        ("19, with r12", "gamma"): np.arctan2(r12 / cosine, of_r11) - gamma,
        ("19, as printed with r13", "gamma of (0.3, 0.4, 0.5)"): (np.arctan2(r13 / cosine, of_r11) - gamma)[
            :1
        ],
    }
    for (equation, gives), off_rad in read.items():
        yield Check(equation, gives, "angles put in", _largest(off_rad), "rad")


def _check_fits(random: np.random.Generator) -> Iterator[Check]:
    off: dict[tuple[str, str, str, str], list[float]] = {}
    for number in range(DRAWS):
        image = sites_mm(PATIENTS[number % len(PATIENTS)])
        motion = draw_pose(random)
        measured = motion.apply(image) + random.normal(size=image.shape) * NOISE_MM
        for check, difference in _compare_fit(image, np.asarray(motion.apply(image)), measured).items():
            off.setdefault(check, []).append(difference)
    for (equation, gives, against, unit), differences in off.items():
        yield Check(equation, gives, against, max(differences), unit)


def _compare_fit(image: Array, exact: Array, measured: Array) -> dict[tuple[str, str, str, str], float]:
    """Return the differences on one head, keyed by equation, what it gives, its witness and the unit."""
    recovered, fit = fit_rigid(image, exact), fit_rigid(image, measured)
    moved = image @ recovered.rotation.T + recovered.translation_mm
    centred = image - image.mean(axis=0), measured - measured.mean(axis=0)
    least_squares, _ = Rotation.align_vectors(centred[1], centred[0])
    residuals = measured - image @ fit.rotation.T - fit.translation_mm
    torque = np.cross(image @ fit.rotation.T, residuals).sum(axis=0)  # half the gradient, rotation
    fre_mm = float(np.sqrt(np.square(residuals).sum() / len(image)))
    fle_mm = NOISE_MM * np.sqrt(3.0)
    target = np.array([measured.mean(axis=0) + TARGET_MM])
    equal = np.tile(np.eye(3) * fle_mm**2 / 3.0, (len(image), 1, 1))
    by_covariance = target_covariance_mm2(target, measured, pose_covariance(measured, equal, weighted=False))
    tre_mm = float(tre_principal_axes_mm(target, measured, fle_mm)[0])
    mirrored = np.linalg.det(fit_rigid(image * MIRROR, measured).rotation)
    svd = "rotation by SVD"
    without_rotation = image + recovered.translation_mm
    return {
        ("1 to 3", "points moved by a fit to exact data", "points", "mm"): _largest(moved - exact),
        ("3, last form as printed, without R", "points moved by the same fit", "points", "mm"): _largest(
            without_rotation - exact
        ),
        ("21 to 31", svd, "SciPy's align_vectors", "rad"): _angle(fit.rotation, least_squares),
        ("21 to 31", svd, "Horn's unit quaternion", "rad"): _angle(fit.rotation, _fit_quaternion(*centred)),
        ("21 to 31", "slope of the sum of squares at the fit", "0", "mm2"): _largest(torque),
        ("21 to 31", "determinant for a mirrored set", "1", ""): abs(float(mirrored) - 1.0),
        ("35", "FRE of a registration", "rms residual", "mm"): abs(register(image, measured).fre_mm - fre_mm),
        ("39", "TRE by principal axes", "covariance of the fitted pose", "mm"): abs(
            tre_mm - float(np.sqrt(np.trace(by_covariance[0])))
        ),
    }


def _fit_quaternion(image: Array, measured: Array) -> Rotation:
    """Fit centred points by the largest eigenvector of Horn's matrix (1987), without any SVD."""
    s = image.T @ measured
    skew = np.array([s[1, 2] - s[2, 1], s[2, 0] - s[0, 2], s[0, 1] - s[1, 0]])
    matrix = np.block(
        [[np.array([[np.trace(s)]]), skew[None]], [skew[:, None], s + s.T - np.eye(3) * np.trace(s)]]
    )
    return Rotation.from_quat(np.linalg.eigh(matrix)[1][:, -1], scalar_first=True)


def _angle(rotation: Array, other: Rotation) -> float:
    """Return the angle between two rotations, rad, also where it is far below the rounding of a cosine."""
    return float((Rotation.from_matrix(rotation) * other.inv()).magnitude())


def _largest(differences: Array) -> float:
    return float(np.abs(differences).max())


def printed_figures() -> list[dict[str, Cell]]:
    """Return each figure printed below the rows of tables 2 to 4 beside what the rows give."""
    between = "eq. 37 and 38 of the FRE"
    rows = [
        *(
            _row("2", name, "mean of the FLE", one, float(np.mean(one.rows_mm)))
            for name, one in TABLE_2.items()
        ),
        *(
            _row("3", name, between, one, fle_of_one_space_mm(one.rows_mm, FIDUCIALS_OF_TABLE_3))
            for name, one in TABLE_3.items()
        ),
    ]
    for (strategy, count), of_strategy in TABLE_4.items():
        column = ThesisColumn(of_strategy.trajectories_mm, of_strategy.mean_mm)
        mean_mm = float(np.mean(column.rows_mm))
        rows.append(_row("4", f"{strategy}, {count} spheres", "mean of the trajectories", column, mean_mm))
    return rows


def _row(table: str, column: str, by: str, printed: ThesisColumn, from_rows_mm: float) -> dict[str, Cell]:
    return {
        "table": table,
        "column": column,
        "by": by,
        "printed mm": printed.printed_mm,
        "from the rows mm": from_rows_mm,
        "differs by mm": printed.printed_mm - from_rows_mm,
    }


def tables(seed: int = 0) -> list[Table]:
    """Tabulate the equations, the figures below the tables' rows, and the gains of 5.1."""
    checks: list[dict[str, Cell]] = [
        {
            "equation": one.equation,
            "gives": one.gives,
            "against": one.against,
            "largest difference": one.largest_difference,
            "unit": one.unit,
        }
        for one in evaluate_equations(seed)
    ]
    gains: list[dict[str, Cell]] = [
        {
            "table": name,
            "gain of SphereFit over people %": 100.0 * (1.0 - ours.printed_mm / people.printed_mm),
        }
        for name, ours, people in (
            ("2", TABLE_2[SPHERE_FIT], TABLE_2[HUMAN_OPERATORS]),
            ("3", TABLE_3[SPHERE_FIT], TABLE_3[AVERAGE_OPERATOR]),
        )
    ]
    return [
        Table.of(
            "Equations of chapter 2",
            checks,
            f"{DRAWS} draws of angles, and of heads with eight markers, {NOISE_MM} mm of noise per axis.",
        ),
        Table.of("Figures printed below the rows", printed_figures()),
        Table.of("Gains from the printed figures", gains),
    ]

"""Test of the error formulas for rigid registration: FRE against FLE, TRE against eq. 39, gate, weighting.

Head markers, a target 10 mm below their centre, and an FLE of 0.3 mm as in the reference
experiment. Isotropic errors are split evenly between both spaces; the others are in the physical space.
Eq. 37 and 38 are applied as in table 3: pairs of scans of one kind, each with errors of its own, are
registered to each other, and the estimate is compared with the errors in the scans.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration.error_theory import fle_of_one_space_mm, fre_gate, tre_principal_axes_mm
from procedures.registration.point_registration import register
from ronna_hw.arrays import Array
from studies.campaign import bounds
from studies.campaign.plots import Point, curves, scatters
from studies.campaign.study import Cell, Study, Sums, Table, Unit, as_sums, blocks, generator
from studies.heads import PATIENTS, draw_pose, sites_mm
from studies.plugins.answers import PluginRegistration
from studies.plugins.method import PluginMethod

BLOCK_RUNS = 500
FLE_MM = 0.3  # 3-D rms, both spaces together
TARGET_BELOW_MM = 10.0
FIDUCIALS = (3, 4, 5, 6, 8)
GATE_CONFIDENCE = 0.95
DEPTH_RATIO = 3.0  # ratio of depth noise to lateral noise of a camera
NOISY_RATIO = 5.0  # ratio of one bad fiducial to the others
ISOTROPIC, DEPTH, NOISY = "equal", "1:1:3", "one 5x"
# Older campaigns lack these sums, which the bounds and the correlation need, and the runs that are drawn.
SUMS = "squares and fourth powers, FRE with TRE, pairs of scans"
SHOWN_RUNS, SHOWN = 60, f"{ISOTROPIC}|5"  # of a unit, and of which condition
PAIR = "pair"
# Errors at the target: ours without and with covariances, user methods.
PLAIN, WEIGHTED, OWN = "tre", "weighted", "own "


@dataclass(frozen=True)
class RegistrationStudy(Study):
    """Registration study with `runs` per number of fiducials and kind of error."""

    runs: int
    seed: int = 0
    fiducials: tuple[int, ...] = FIDUCIALS
    name: str = "registration"
    own: tuple[PluginMethod, ...] = ()

    constants: ClassVar = {"sums": SUMS}

    def units(self) -> Sequence[Unit]:
        conditions = [f"{ISOTROPIC}|{count}" for count in self.fiducials] + [f"{DEPTH}|5", f"{NOISY}|5"]
        return [unit for condition in conditions for unit in blocks(condition, self.runs, BLOCK_RUNS)]

    def run(self, unit: Unit) -> Sums:
        """Return sums of squares (mm2), fourth powers (mm4) and counts over the runs."""
        kind, count = unit.condition.split("|")
        random = generator(self.seed, unit)
        sums: Counter[str] = Counter()
        own = tuple(PluginRegistration.of(one) for one in self.own)
        of_scans = random.spawn(1)[0]
        residuals_mm: list[float] = []
        errors_mm: list[float] = []
        between_scans_mm: list[float] = []
        for run in range(unit.runs):
            sites = sites_mm(PATIENTS[run % len(PATIENTS)])
            points = sites[random.choice(len(sites), int(count), replace=False)]
            one = _register_once(points, kind, random, own)
            residuals_mm.append(one.pop("fre"))
            errors_mm.append(np.sqrt(one[f"{PLAIN}2"]))
            sums.update(one)
            if kind == ISOTROPIC:
                fre_mm, in_scans2 = _register_two_scans(points, of_scans)
                between_scans_mm.append(fre_mm)
                sums.update({"in scans2": in_scans2})
        pairs = np.array([residuals_mm, errors_mm])
        sums.update({"fre": pairs[0].sum(), "tre": pairs[1].sum()})
        sums.update({"fre2": np.square(pairs[0]).sum(), "fre tre": pairs.prod(axis=0).sum()})
        if unit.condition == SHOWN:
            for run, (fre_mm, error_mm) in enumerate(pairs.T[:SHOWN_RUNS]):
                sums |= {f"{PAIR}|{unit.block}|{run}|fre": fre_mm, f"{PAIR}|{unit.block}|{run}|tre": error_mm}
        if between_scans_mm:
            estimated2 = unit.runs * fle_of_one_space_mm(between_scans_mm, int(count)) ** 2
            return as_sums(sums) | {"one_space2": estimated2}
        return as_sums(sums)


def _register_two_scans(points: Array, random: np.random.Generator) -> tuple[float, float]:
    """Return the FRE between two scans of a head that lay differently, mm, and the mean square error, mm2."""
    errors_mm = random.normal(size=(2, *points.shape)) * FLE_MM / np.sqrt(6.0)  # half of the variance each
    again = draw_pose(random).apply(points)
    fre_mm = register(points + errors_mm[0], again + errors_mm[1]).fre_mm
    return fre_mm, float(np.square(errors_mm).sum(axis=-1).mean())


def _register_once(
    points: Array, kind: str, random: np.random.Generator, own: Sequence[PluginRegistration]
) -> dict[str, float]:
    truth = draw_pose(random)
    covariance = _draw_covariances(len(points), kind, random)
    in_image = 0.5 if kind == ISOTROPIC else 0.0  # fraction of the variance
    image = points + _draw_noise(covariance * in_image, random)
    measured = truth.apply(points) + _draw_noise(covariance * (1.0 - in_image), random)
    target = points.mean(axis=0) - np.array([0.0, 0.0, TARGET_BELOW_MM])
    right = truth.apply(target)
    plain = register(image, measured)
    sums = {"runs": 1.0, "fre": plain.fre_mm, "fle2": plain.fle_mm**2} | _sum_target_error(
        PLAIN, plain.transform, target, right
    )
    for method in own:
        fitted = method(image, measured, covariance_mm2=covariance)
        sums |= _sum_target_error(f"{OWN}{method.name}", fitted, target, right)
    if kind == ISOTROPIC:
        predicted = tre_principal_axes_mm(np.array([right]), truth.apply(points), FLE_MM)[0]
        gate = fre_gate(plain.fre_mm, FLE_MM, len(points), GATE_CONFIDENCE)
        return sums | {"predicted2": float(predicted**2), "alarms": float(not gate.passed)}
    weighted = register(image, measured, covariance_mm2=covariance)
    predicted = weighted.predict_tre_mm(target)[0]
    sums |= _sum_target_error(WEIGHTED, weighted.transform, target, right)
    return sums | {"predicted2": float(predicted**2)}


def _sum_target_error(who: str, fitted: RigidTransform, target: Array, right: Array) -> dict[str, float]:
    """Return the target error squared (mm2) and to the fourth power (mm4), keyed for summing."""
    square = float(np.sum((fitted.apply(target) - right) ** 2))
    return {f"{who}2": square, f"{who}4": square**2}


def _draw_noise(covariance_mm2: Array, random: np.random.Generator) -> Array:
    """Draw noise (n, 3) from the covariances (n, 3, 3), which may all be zero."""
    if not covariance_mm2.any():
        return np.zeros(covariance_mm2.shape[:2])
    normal = random.normal(size=covariance_mm2.shape[:2])
    return np.asarray(np.einsum("nij,nj->ni", np.linalg.cholesky(covariance_mm2), normal))


def _draw_covariances(count: int, kind: str, random: np.random.Generator) -> Array:
    """Draw covariances (n, 3, 3) in the physical frame, mm2. FLE is the 3-D rms of a normal fiducial.

    Each sphere is viewed from a different side, so the direction of the noisy depth differs too.
    """
    if kind == DEPTH:
        ratios = np.array([1.0, 1.0, DEPTH_RATIO**2])
        turns = Rotation.random(count, rng=random).as_matrix()
        return np.asarray((turns * (ratios * FLE_MM**2 / ratios.sum())) @ turns.swapaxes(1, 2))
    covariance = np.tile(np.eye(3) * FLE_MM**2 / 3.0, (count, 1, 1))
    if kind == NOISY:
        covariance[0] *= NOISY_RATIO**2
    return covariance


def tables(sums: Mapping[str, Sums]) -> list[Table]:
    """Tabulate the formulas against simulation, and the gain from weighting."""
    formulas: list[dict[str, Cell]] = []
    gains: list[dict[str, Cell]] = []
    for condition, total in sums.items():
        kind, count = condition.split("|")
        runs = total["runs"]
        tre = _rms_mm(total, PLAIN)
        predicted_mm = float(np.sqrt(total["predicted2"] / runs))
        if kind == ISOTROPIC:
            formulas.append(
                {
                    "fiducials": int(count),
                    "runs": int(runs),
                    "FLE by eq. 36 / true": float(np.sqrt(total["fle2"] / runs)) / FLE_MM,
                    "one space by eq. 37, 38 / true": float(
                        np.sqrt(total["one_space2"] / total["in scans2"])
                    ),
                    **bounds.cells("TRE mm", tre),
                    "eq. 39 mm": predicted_mm,
                    "TRE / eq. 39": tre.value / predicted_mm,
                    **bounds.cells("gate alarms %", bounds.percent(total.get("alarms", 0.0), runs)),
                    "FRE2 / ((1 - 2/n) FLE2)": total["fre2"] / runs / (1.0 - 2.0 / int(count)) / FLE_MM**2,
                    **bounds.cells("r of FRE and TRE", _correlate(total), of="r of FRE and TRE"),
                }
            )
        else:
            weighted = _rms_mm(total, WEIGHTED)
            gains.append(
                {
                    "errors": kind,
                    "runs": int(runs),
                    **bounds.cells("TRE mm, equal weights", tre, of="equal weights"),
                    **bounds.cells("TRE mm, weighted", weighted, of="weighted"),
                    "gain %": 100.0 * (1.0 - weighted.value / tre.value),
                    "TRE / predicted": weighted.value / predicted_mm,
                }
            )
    return [
        Table.of(
            "Formulas of the rigid fit",
            formulas,
            f"FLE {FLE_MM} mm, half of its variance in each space, target {TARGET_BELOW_MM:g} mm below "
            f"the markers' centre. The gate is set to {100 * (1 - GATE_CONFIDENCE):.0f} % false alarms. "
            "FRE is a residual, not an accuracy: its mean square is (1 - 2/n) FLE2 wherever the target is. "
            f"r: Pearson's correlation with the TRE over the runs. {bounds.NOTE} Those of the TRE: Student, "
            "from the spread of its squares; of r: Fisher.",
        ),
        Table.of("What weighting by covariances gains", gains, "Five fiducials."),
        *([_tabulate_own(sums)] if any(map(_list_own, sums.values())) else ()),
    ]


def _tabulate_own(sums: Mapping[str, Sums]) -> Table:
    rows: list[Sequence[Cell]] = []
    for condition, total in sums.items():
        kind, count = condition.split("|")
        methods = {PLAIN: "ours, equal weights", WEIGHTED: "ours, weighted"}
        for who, name in (methods | _list_own(total)).items():
            if f"{who}2" in total:
                error = _rms_mm(total, who)
                rows.append((kind, int(count), name, int(total["runs"]), error.value, error.text))
    return Table(
        "Own registrations beside ours",
        ("errors", "fiducials", "method", "runs", "TRE mm", bounds.column("TRE")),
        rows,
        "The same points and covariances for all.",
    )


def _list_own(total: Sums) -> dict[str, str]:
    """Return the names of the user methods by the start of their keys."""
    return {key[:-1]: key[len(OWN) : -1] for key in total if key.startswith(OWN) and key.endswith("2")}


def _correlate(total: Sums) -> bounds.Bounded:
    """Return the correlation of FRE and TRE over the runs."""
    return bounds.correlation_of_sums(
        total["runs"], total["fre"], total["tre"], total["fre2"], total[f"{PLAIN}2"], total["fre tre"]
    )


def _rms_mm(total: Sums, who: str) -> bounds.Bounded:
    return bounds.root_mean_square(total[f"{who}2"], total[f"{who}4"], total["runs"])


def plots(sums: Mapping[str, Sums]) -> dict[str, bytes]:
    """Plot the simulated target error next to the prediction of eq. 39, by number of fiducials."""
    lines: dict[str, list[Point]] = {"simulated": [], "eq. 39": []}
    for condition, total in sums.items():
        kind, count = condition.split("|")
        if kind != ISOTROPIC:
            continue
        lines["simulated"].append((int(count), _rms_mm(total, PLAIN)))
        lines["eq. 39"].append((int(count), float(np.sqrt(total["predicted2"] / total["runs"]))))
        for who, name in _list_own(total).items():
            lines.setdefault(name, []).append((int(count), _rms_mm(total, who)))
    title = f"Target error, FLE {FLE_MM} mm"
    pictures = {"target-error.png": curves(title, "fiducials", "rms error at the target, mm", lines)}
    if SHOWN in sums:
        fre_mm, tre_mm = (
            [value for key, value in sums[SHOWN].items() if key.startswith(f"{PAIR}|") and key.endswith(what)]
            for what in ("|fre", "|tre")
        )
        label = f"r = {_correlate(sums[SHOWN]).value:.3f}"
        pictures["fre-and-tre.png"] = scatters(
            "FRE and TRE, five fiducials", "FRE, mm", "TRE, mm", {label: (fre_mm, tre_mm)}
        )
    return pictures

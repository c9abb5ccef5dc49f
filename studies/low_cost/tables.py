"""Tables, relations and plots of the experiment of PAPER 2.

The thesis prints no figures of that paper. What can be judged: that feedback helps, that it does not depend
on the arm, and how large the error remains beside the closed loop of a peer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ronna_hw.arrays import Array
from studies.campaign.plots import bars, boxes, curves
from studies.campaign.study import Cell, Sums, Table, yes_or_no
from studies.low_cost.figures import (
    NOMINAL_ERROR_KEY,
    REPEATABILITY_KEY,
    CalibrationMethod,
    DimensionSource,
    Extent,
    Fit,
    Quantity,
    absolute_key,
    find_place,
    fit_key,
)
from studies.low_cost.judge import distance_errors_mm
from studies.low_cost.positioning import MOST_ROUNDS, SETTLED_MM
from studies.low_cost.preparation import Preparation
from studies.low_cost.room import REPEATABILITY_MM, draw_room
from studies.low_cost.targets import ORIENTATIONS_RAD

MOST_CLOSED_MM = 0.5  # goal for the mean error with feedback
MOST_DEPENDENT = 0.1  # of it: how far an arm's mean may be from that of all
LEAST_ARMS = 5  # that show whether errors depend on the arm
# Tovar-Arriaga et al., Sensors 12 (2012): a light-weight arm (LWR3) guided by an optical tracker.
PEER = "Tovar-Arriaga et al., Sensors 12 (2012), another arm and tracker"
PEER_CALIBRATION_MM, PEER_OPEN_MM, PEER_CLOSED_RMS_MM = (0.81, 0.41), (1.2, 0.4), 0.35
METHODS = {
    f"1, {DimensionSource.NOMINAL} DH": (CalibrationMethod.OPEN, DimensionSource.NOMINAL),
    f"1, {DimensionSource.FACTORY} DH": (CalibrationMethod.OPEN, DimensionSource.FACTORY),
    f"2, {DimensionSource.NOMINAL} DH": (CalibrationMethod.CLOSED, DimensionSource.NOMINAL),
}
NOT_JUDGED = "not judged"
NOT_FOUND = (
    "F. Šuligoj's thesis (Zagreb 2018) prints no figure of PAPER 2 (IROS 2015, pp. 3785-3790), and the "
    "paper was not found: there is nothing of it to compare with."
)


@dataclass(frozen=True)
class Arm:
    """One arm's figures."""

    number: int
    sums: Sums

    def at_targets(self, method: CalibrationMethod, model: DimensionSource, quantity: Quantity) -> Array:
        """Return a quantity at all targets, (orientations, targets)."""
        found: dict[int, list[float]] = {}
        for key, value in self.sums.items():
            if (place := find_place(key, quantity)) and (place.method, place.dimensions) == (method, model):
                found.setdefault(place.orientation, []).append(value)
        return np.array([found[orientation] for orientation in sorted(found)])

    def __getitem__(self, name: str) -> float:
        return self.sums[name]


def collect_arms(sums: Mapping[str, Sums]) -> list[Arm]:
    return [Arm(int(condition.split()[1]), content) for condition, content in sums.items()]


def tables(preparation: Preparation, sums: Mapping[str, Sums]) -> list[Table]:
    """Return all tables, the judged relations first."""
    arms = collect_arms(sums)
    return [
        tabulate_relations(arms),
        _tabulate_positioning(arms),
        _tabulate_arms(arms),
        _tabulate_calibrations(arms, preparation),
        _tabulate_scans(preparation),
        _tabulate_peer(arms),
    ]


def tabulate_relations(arms: list[Arm]) -> Table:
    """Judge the relations that have to hold whatever the figures are."""
    opened, closed = (_errors_mm(arms, method, DimensionSource.NOMINAL) for method in CalibrationMethod)
    better = closed.mean(axis=(1, 2)) < opened.mean(axis=(1, 2))
    better_sets = closed.mean(axis=2) < opened.mean(axis=2)
    means = closed.mean(axis=(1, 2))
    mean_mm, apart = float(means.mean()), float(np.abs(means / means.mean() - 1.0).max())
    rise = _fit_rise_mm(np.array([arm[NOMINAL_ERROR_KEY] for arm in arms]), means) / mean_mm
    rms_mm = float(np.sqrt(np.mean(closed**2)))
    several = len(arms) >= LEAST_ARMS
    rows: list[tuple[str, Cell, Cell, Cell]] = [
        (
            "arms with a smaller mean error by method 2 than by method 1",
            f"{int(better.sum())} of {better.size}",
            "all",
            yes_or_no(bool(better.all())),
        ),
        (
            "the same, each orientation of the tool alone",
            f"{int(better_sets.sum())} of {better_sets.size}",
            None,
            None,
        ),
        (
            "mean error by method 2, mm",
            mean_mm,
            f"at most {MOST_CLOSED_MM:g}",
            yes_or_no(mean_mm <= MOST_CLOSED_MM),
        ),
        (
            "farthest mean of an arm by method 2 from that of all, %",
            100.0 * apart if several else None,
            f"at most {100.0 * MOST_DEPENDENT:g}",
            yes_or_no(apart <= MOST_DEPENDENT) if several else None,
        ),
        (
            "rise of that mean from the arm with the least DH error to that with the largest, %",
            100.0 * rise if several else None,
            f"at most ±{100.0 * MOST_DEPENDENT:g}",
            yes_or_no(abs(rise) <= MOST_DEPENDENT) if several else None,
        ),
        (
            "rms error by method 2, mm, beside the peer's closed loop",
            rms_mm,
            f"at most {PEER_CLOSED_RMS_MM:g}",
            yes_or_no(rms_mm <= PEER_CLOSED_RMS_MM),
        ),
    ]
    return Table(
        "Requirements",
        ("requirement", "value", "limit", "held"),
        [(*row[:3], row[3] or NOT_JUDGED) for row in rows],
        f"{NOT_FOUND} Both methods with nominal DH. Row 2 is not judged: tip, registration and tracker err "
        "alike in both methods, and one orientation may suit an arm by chance. "
        f"Fewer than {LEAST_ARMS} arms "
        "say nothing about dependence on the arm: their few targets differ as much.",
        _describe_verdict(rows),
    )


def _describe_verdict(rows: Sequence[tuple[Cell, Cell, Cell, Cell]]) -> str:
    """Say how many of the judged requirements are held, and which are not."""
    missed = [str(row[0]) for row in rows if row[3] == yes_or_no(False)]
    judged = sum(row[3] is not None for row in rows)
    held = f"{judged - len(missed)} of {judged} requirements are held"
    return f"**NOT HELD: {'; '.join(missed)}.** {held}." if missed else f"**HELD: {held}.**"


def _fit_rise_mm(errors_mm: Array, means_mm: Array) -> float:
    """Return how much a line through means (n,) rises over the range of the arms' own errors (n,)."""
    away = errors_mm - errors_mm.mean()
    square = float(away @ away)
    return float(np.ptp(errors_mm) * (away @ means_mm) / square) if square > 0.0 else 0.0


def list_missed_relations(sums: Mapping[str, Sums]) -> list[str]:
    return [str(row[0]) for row in tabulate_relations(collect_arms(sums)).rows if row[3] == yes_or_no(False)]


def _tabulate_positioning(arms: list[Arm]) -> Table:
    rows: list[dict[str, Cell]] = []
    for title, chosen in [*((f"{arm.number}", [arm]) for arm in arms), ("all", arms)]:
        for name, (method, model) in METHODS.items():
            errors = _errors_mm(chosen, method, model)
            angles = np.array([arm.at_targets(method, model, Quantity.ANGLE_DEG) for arm in chosen])
            row: dict[str, Cell] = {
                "arm": title,
                "method": name,
                "targets": errors.size,
                "mean mm": float(errors.mean()),
                "sd mm": float(errors.std(ddof=1)),
                "rms mm": float(np.sqrt(np.mean(errors**2))),
                "largest mm": float(errors.max()),
                "mean deg": float(angles.mean()),
                "rounds": None,
                "settled %": None,
            }
            if method is CalibrationMethod.CLOSED:
                rounds, settled = (
                    np.array([arm.at_targets(method, model, what) for arm in chosen])
                    for what in (Quantity.ROUNDS, Quantity.SETTLED)
                )
                row |= {"rounds": float(rounds.mean()), "settled %": 100.0 * float(settled.mean())}
            rows.append(row)
    return Table.of(
        "Tool positioning",
        rows,
        "True error of the tip. Method 1: one command through the calibration. Method 2: from there the "
        f"mean of some frames, and a move by the residual, until less than {SETTLED_MM:g} mm and 0.1 deg "
        f"remain or after {MOST_ROUNDS} rounds. Both are our reading of one sentence of the thesis.",
    )


def _tabulate_arms(arms: list[Arm]) -> Table:
    return Table.of(
        "Arm alone",
        [
            {
                "arm": arm.number,
                "over the workspace, nominal DH, rms mm": arm[NOMINAL_ERROR_KEY],
                "repeatability mm": arm[REPEATABILITY_KEY],
                **{
                    f"{model} DH, {what} mm": arm[absolute_key(model, what)]
                    for model in DimensionSource
                    for what in Extent
                },
            }
            for arm in arms
        ],
        f"Repeatability by ISO 9283, the worst of five poses; the data sheet has ±{REPEATABILITY_MM:g} mm. "
        "Absolute error of the tip in the workspace of the phantom after a rigid fit of the base. Factory: "
        "DH parameters as the controller states them, identified on the arm with what they can describe.",
    )


def _tabulate_calibrations(arms: list[Arm], preparation: Preparation) -> Table:
    return Table.of(
        "Calibration of base and flange frame",
        [
            {
                "arm": arm.number,
                "DH": model,
                "looks": arm[fit_key(model, Fit.LOOKS)],
                "residual mm per axis": arm[fit_key(model, Fit.SCATTER_MM)],
                "residual deg per axis": arm[fit_key(model, Fit.SCATTER_DEG)],
                "held out mm": arm[fit_key(model, Fit.HELD_OUT_MM)],
                "held out deg": arm[fit_key(model, Fit.HELD_OUT_DEG)],
            }
            for arm in arms
            for model in DimensionSource
        ],
        "Joint solution of base to tracker and flange to tool frame (A X = Z B). Held out: 3-D rms at looks "
        f"that were not fitted. Tip by pivoting: {preparation.pivot_rms_mm:.3f} mm rms. Registration of the "
        f"CT to the phantom's frame: FRE {preparation.fre_mm:.3f} mm.",
    )


def _tabulate_scans(preparation: Preparation) -> Table:
    true_mm = np.array([one.centre_ct_mm for one in draw_room(preparation.seed).head.fiducials])
    rows: list[dict[str, Cell]] = []
    for number, found in enumerate(preparation.scans_mm):
        errors = distance_errors_mm(np.array(found), true_mm)
        rows.append(
            {
                "scan": number,
                "spheres": len(found),
                "distances": len(errors),
                "mean of absolute errors mm": float(np.abs(errors).mean()),
                "rms mm": float(np.sqrt(np.mean(errors**2))),
                "largest mm": float(np.abs(errors).max()),
            }
        )
    return Table.of(
        "CT alone",
        rows,
        "Distances between the spheres' centres. Every scan has a table feed that is wrong by up to 0.2 %. "
        "The first scan is registered.",
    )


def _tabulate_peer(arms: list[Arm]) -> Table:
    held_out = np.array([arm[fit_key(DimensionSource.NOMINAL, Fit.HELD_OUT_MM)] for arm in arms])
    opened, closed = (_errors_mm(arms, method, DimensionSource.NOMINAL) for method in CalibrationMethod)
    return Table(
        "Beside a peer",
        ("what", "peer mm", "here mm"),
        [
            ("calibration", "{:g} ± {:g}".format(*PEER_CALIBRATION_MM), float(held_out.mean())),
            ("open loop, mean", "{:g} ± {:g}".format(*PEER_OPEN_MM), float(opened.mean())),
            ("closed loop, rms", f"{PEER_CLOSED_RMS_MM:g}", float(np.sqrt(np.mean(closed**2)))),
        ],
        f"{PEER}: the order of size, not the figures, is comparable.",
    )


def plots(sums: Mapping[str, Sums]) -> dict[str, bytes]:
    """Plot the errors of both methods, their dependence on the arm's own, and the rounds."""
    own_error = absolute_key(DimensionSource.NOMINAL, Extent.MEAN)
    arms = sorted(collect_arms(sums), key=lambda arm: arm[own_error])
    lines = {
        f"method {name}": [
            (
                arm[own_error],
                float(arm.at_targets(method, model, Quantity.ERROR_MM).mean()),
            )
            for arm in arms
        ]
        for name, (method, model) in METHODS.items()
    }
    rounds, ended = (
        np.array(
            [arm.at_targets(CalibrationMethod.CLOSED, DimensionSource.NOMINAL, one) for arm in arms]
        ).ravel()
        for one in (Quantity.ROUNDS, Quantity.SETTLED)
    )
    settled = ended > 0.0
    return {
        "errors.png": boxes(
            "Error of the tip at the target",
            "true error of the tip, mm",
            {
                f"method {name}, orientation {orientation}": _errors_mm(arms, method, model)[
                    :, orientation
                ].ravel()
                for name, (method, model) in METHODS.items()
                for orientation in range(len(ORIENTATIONS_RAD))
            },
            x_label="method, source of the DH parameters, orientation of the tool",
        ),
        "dependence-on-the-arm.png": curves(
            "Error at the target against that of the arm",
            f"absolute error of the arm, {DimensionSource.NOMINAL} DH, mean, mm",
            "mean error at the target, mm",
            lines,
        ),
        "rounds.png": bars(
            "Rounds of method 2",
            "% of the targets",
            {
                f"{n}": {
                    "settled": 100.0 * float(np.mean(settled & (rounds == n))),
                    "not settled": 100.0 * float(np.mean(~settled & (rounds == n))),
                }
                for n in range(MOST_ROUNDS + 1)
            },
            x_label="rounds of looking and moving",
        ),
    }


def _errors_mm(arms: list[Arm], method: CalibrationMethod, model: DimensionSource) -> Array:
    """Return the errors (arms, orientations, targets) in mm."""
    return np.array([arm.at_targets(method, model, Quantity.ERROR_MM) for arm in arms])

"""Tables of the correspondence study next to the thesis' figures."""

from __future__ import annotations

from collections.abc import Mapping

from procedures.studies.correspondence import FALSE, SUCCESS, UNSUCCESSFUL, cell_of
from procedures.studies.heads import NoiseReading
from procedures.studies.plots import bars, curves
from procedures.studies.table import Cell, Table
from procedures.studies.unit import Sums

# Unsuccessful and false, per cent, over patients and 0 to 4 outliers: F. Suligoj, thesis, Zagreb 2018, 5.3.2.
THESIS_UNSUCCESSFUL = {3: "7.98-15.53", 4: "3.86-5.03"} | dict.fromkeys(range(5, 9), "0-0.81")
THESIS_FALSE = {3: "0.05-0.89", 4: "0.01-0.06"} | dict.fromkeys(range(5, 9), "0-0.026")

POOLED = range(5, 9)  # numbers of fiducials pooled by the thesis and by the goal
GOAL_UNSUCCESSFUL, GOAL_FALSE = 0.05, 0.01  # per cent, of our methods

Share = tuple[float, float, int]  # unsuccessful, false, runs


def shares(sums: Mapping[str, Sums]) -> dict[tuple[NoiseReading, str, str, int], Share]:
    """(noise model, method, e, fiducials) -> shares over patients and outliers."""
    counted: dict[tuple[NoiseReading, str, str, int], dict[str, float]] = {}
    for cell, content in sums.items():
        reading, _, fiducials, _ = cell_of(cell)
        for key, number in content.items():
            method, tolerance, outcome = key.split("|")
            into = counted.setdefault((reading, method, tolerance, fiducials), {})
            into[outcome] = into.get(outcome, 0.0) + number
    found = {}
    for where, outcomes in counted.items():
        runs = sum(outcomes.get(one, 0.0) for one in (SUCCESS, UNSUCCESSFUL, FALSE))
        found[where] = (outcomes.get(UNSUCCESSFUL, 0.0) / runs, outcomes.get(FALSE, 0.0) / runs, int(runs))
    return found


def tables(sums: Mapping[str, Sums]) -> list[Table]:
    """One table per noise model."""
    found = shares(sums)
    made = []
    for reading in dict.fromkeys(key[0] for key in found):
        rows: list[list[Cell]] = []
        for (_, method, tolerance, fiducials), (lost, false, runs) in sorted(
            ((k, v) for k, v in found.items() if k[0] is reading), key=lambda item: item[0][1:]
        ):
            rows.append(
                [
                    method,
                    float(tolerance) if tolerance else None,
                    fiducials,
                    runs,
                    100.0 * lost,
                    THESIS_UNSUCCESSFUL[fiducials],
                    100.0 * false,
                    THESIS_FALSE[fiducials],
                ]
            )
        made.append(
            Table(
                f"Correspondence, noise {reading.value}",
                ("method", "e mm", "fiducials", "runs", "unsuccessful %", "thesis %", "false %", "thesis %"),
                rows,
                "Pooled over 3 heads and 0 to 4 outliers; the thesis gives the range over these. Its heads"
                " are not published, and it does not state its noise model.",
            )
        )
    return [*made, _pooled(found)]


def _pooled(found: Mapping[tuple[NoiseReading, str, str, int], Share]) -> Table:
    """Counts over 5 to 8 fiducials: single cells are too small for a verdict."""
    rows: list[list[Cell]] = []
    for reading, method, tolerance in dict.fromkeys(key[:3] for key in sorted(found)):
        cells = [found[key] for key in found if key[:3] == (reading, method, tolerance) and key[3] in POOLED]
        if not (runs := sum(one[2] for one in cells)):
            continue
        lost, false = (round(sum(one[part] * one[2] for one in cells)) for part in (0, 1))
        shares_percent = [100.0 * lost / runs, 100.0 * false / runs]
        e_mm = float(tolerance) if tolerance else None
        rows.append([reading.value, method, e_mm, runs, lost, shares_percent[0], false, shares_percent[1]])
    return Table(
        "Five to eight fiducials together",
        ("noise", "method", "e mm", "runs", "unsuccessful", "unsuccessful %", "false", "false %"),
        rows,
        f"Goal for ours: at most {GOAL_UNSUCCESSFUL} % and {GOAL_FALSE} %, none false with the planned count."
        " The thesis gives"
        f" {THESIS_UNSUCCESSFUL[5]} % and {THESIS_FALSE[5]} % for its single cells.",
    )


def success_against_tolerance(
    sums: Mapping[str, Sums],
) -> dict[tuple[NoiseReading, int], list[tuple[float, float]]]:
    """(noise model, fiducials) -> (e in mm, success rate) of the thesis' method, for a plot."""
    curves: dict[tuple[NoiseReading, int], list[tuple[float, float]]] = {}
    for (reading, _, tolerance, fiducials), (lost, false, _) in shares(sums).items():
        if tolerance:
            curves.setdefault((reading, fiducials), []).append((float(tolerance), 1.0 - lost - false))
    return {key: sorted(points) for key, points in curves.items()}


def plots(sums: Mapping[str, Sums]) -> dict[str, bytes]:
    """Success of the thesis' method against its parameter e, one plot per noise model."""
    found = success_against_tolerance(sums)
    pictures = {}
    for reading in dict.fromkeys(key[0] for key in found):
        lines = {
            f"{fiducials} fiducials": [(e, 100.0 * share) for e, share in points]
            for (noise, fiducials), points in found.items()
            if noise is reading
        }
        name = f"success-against-e-{reading.value.replace(' ', '-')}.png"
        pictures[name] = curves(
            f"Thesis' method, noise {reading.value}, 0 to 4 outliers", "e, mm", "success, %", lines
        )
    return pictures


def bars_beside_thesis(sums: Mapping[str, Sums]) -> dict[str, bytes]:
    """Unsuccessful runs by fiducials and method, one plot per noise model."""
    found = shares(sums)
    pictures = {}
    for reading in dict.fromkeys(key[0] for key in found):
        groups: dict[str, dict[str, float]] = {}
        for (noise, method, _, fiducials), (lost, false, _) in found.items():
            if noise is reading:
                groups.setdefault(str(fiducials), {})[method] = 100.0 * (lost + false)
        for number, group in groups.items():
            group["the thesis reports, at most"] = float(THESIS_UNSUCCESSFUL[int(number)].split("-")[1])
        ordered = dict(sorted(groups.items()))
        name = f"unsuccessful-{reading.value.replace(' ', '-')}.png"
        pictures[name] = bars(
            f"By number of fiducials, noise {reading.value}",
            "unsuccessful or false, %",
            ordered,
            logarithmic=True,
        )
    return pictures

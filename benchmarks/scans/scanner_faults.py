"""Effect of real scanner faults: each fault option of `ronna-sim phantom`, on the same markers.

Errors are those of the centres directly, and after a rigid fit to the truth, as in a
registration; a refused scan has none. Scans without motion and with the slices where the headers
state, `--quiet` of each family and protocol, give the largest harmless values. `--write` stores
the figures for the reference page.

    python -m benchmarks.scans.scanner_faults --volumes 4 --seed 9000 --quiet 2 --write
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import tomli_w

from benchmarks.scans.look_alikes import SAME_SPHERE_MM, WHOLE_SLICES_MM, Painted, paint
from procedures.imaging import Localization, localize, read_series
from procedures.imaging.errors import MarkerCountWrong, ScanDeformed
from procedures.imaging.scan_deformation import require_undeformed
from procedures.imaging.scan_faults import check_motion, estimate_jumps
from procedures.registration.point_registration import register
from ronna_hw.arrays import Array
from ronna_hw.errors import RonnaError
from sim.phantom.case import write_case
from sim.phantom.families.catalogue import FAMILIES, PROTOCOLS
from sim.phantom.families.family_scan import family_scan
from sim.phantom.scan import Scan, plain_scan
from sim.phantom.scanner.faults import KERNELS, NO_FAULTS, ScannerFaults
from sim.world.scene.named_scenes import draw_scene

FAMILY, PROTOCOL = "plain", "good"
DATA = Path(__file__).parents[2] / "docs" / "reference" / "scanner-faults.toml"


@dataclass(frozen=True)
class Case:
    """A fault: its description and options. `slice_mm` overrides the protocol's slice spacing."""

    words: str
    faults: ScannerFaults = NO_FAULTS
    slice_mm: float | None = None
    noise_hu: float | None = None


CASES = (
    Case("none: 0.5 x 0.5 x 1.0 mm, 20 HU"),
    Case("table feeds 0.1 % more than stated", ScannerFaults(table_scale=0.001)),
    Case("table feeds 0.5 % more", ScannerFaults(table_scale=0.005)),
    Case("table feeds 1 % more", ScannerFaults(table_scale=0.01)),
    Case("table feeds 2 % more", ScannerFaults(table_scale=0.02)),
    Case("table feeds 2 % less", ScannerFaults(table_scale=-0.02)),
    *(
        Case(
            f"the image is longer by {percent:g} % along (1, -2, 2)",
            ScannerFaults(stretch=percent / 100.0, stretch_along=(1.0, -2.0, 2.0)),
        )
        for percent in (0.2, 0.5, 1.5)
    ),
    Case("overlap: slices of 2 mm every 1 mm", ScannerFaults(thickness_mm=2.0)),
    Case("overlap: slices of 3 mm every 1 mm", ScannerFaults(thickness_mm=3.0)),
    Case("thick: slices of 2 mm every 2 mm", slice_mm=2.0),
    Case("thick: slices of 3 mm every 3 mm", slice_mm=3.0),
    Case("thick: slices of 5 mm every 5 mm", slice_mm=5.0),
    Case("beam hardening, usual", ScannerFaults(beam_hardening=1.0)),
    Case("beam hardening, three times as much", ScannerFaults(beam_hardening=3.0)),
    Case("the patient moves by 0.3 mm", ScannerFaults(motion_mm=0.3)),
    Case("the patient moves by 0.5 mm", ScannerFaults(motion_mm=0.5)),
    Case("the patient moves by 1 mm", ScannerFaults(motion_mm=1.0)),
    Case("the patient moves by 2 mm", ScannerFaults(motion_mm=2.0)),
    Case("the patient moves by 3 mm", ScannerFaults(motion_mm=3.0)),
    Case("the patient slides back by 0.3 mm", ScannerFaults(slide_mm=0.3)),
    Case("the patient slides back by 1 mm", ScannerFaults(slide_mm=1.0)),
    Case("the patient slides back by 3 mm: slices repeat", ScannerFaults(slide_mm=3.0)),
    Case("the patient slides on by 3 mm: slices are missing", ScannerFaults(slide_mm=-3.0)),
    Case("smooth kernel", ScannerFaults(kernel="smooth")),
    Case("sharp kernel", ScannerFaults(kernel="sharp")),
    Case("sharp kernel, 60 HU", ScannerFaults(kernel="sharp"), noise_hu=60.0),
    Case("metal stored beyond 3071 HU", ScannerFaults(extended_range=True)),
)
HIDDEN = tuple(
    Case(f"gantry tilt of {tilt:g}° that the headers hide", ScannerFaults(tilt_deg=tilt, tilt_hidden=True))
    for tilt in (0.5, 1.0, 2.0)
)
TILTS = tuple(Case(f"gantry tilt of {tilt:g}°", ScannerFaults(tilt_deg=tilt)) for tilt in (0.5, 5.0, 20.0))


@dataclass
class Cost:
    volumes: int = 0
    refused: int = 0
    markers: int = 0
    missed: int = 0
    false: int = 0
    squares_mm2: list[float] = field(default_factory=list)
    fitted_mm2: list[float] = field(default_factory=list)  # after a rigid fit
    chi2: list[float] = field(default_factory=list)
    said: list[str] = field(default_factory=list)  # refusals and warnings

    def add(self, painted: Painted) -> None:
        """Localize the markers of a scan, without an expected count, and add the results."""
        self.volumes += 1
        try:
            said = check_motion(painted.volume.voxels, painted.volume.geometry)
            found = localize(painted.volume)
        except RonnaError as error:
            self.said.append(_format_refusal(error))
            if isinstance(error, MarkerCountWrong):
                self.markers += len(painted.centres_mm)
                self.missed += len(painted.centres_mm)
            else:
                self.refused += 1
            return
        self.markers += len(painted.centres_mm)
        self.said += said
        try:
            require_undeformed(found.deformation)
        except ScanDeformed as error:
            self.refused += 1
            self.said.append(_format_refusal(error))
        self._compare(found, painted.centres_mm)

    def _compare(self, found: Localization, centres_mm: Array) -> None:
        distance = np.linalg.norm(centres_mm[:, None] - found.centres_mm[None], axis=2)
        near = distance < SAME_SPHERE_MM
        self.missed += int((~near.any(axis=1)).sum())
        self.false += int((~near.any(axis=0)).sum())
        pairs = [(number, int(distance[number].argmin())) for number in np.flatnonzero(near.any(axis=1))]
        errors = [found.markers[k].centre_mm - centres_mm[number] for number, k in pairs]
        self.squares_mm2 += [float(error @ error) for error in errors]
        self.chi2 += [
            float(error @ np.linalg.solve(found.markers[k].covariance_mm2, error)) / 3.0
            for error, (_, k) in zip(errors, pairs, strict=True)
        ]
        if len(pairs) > 3:
            there = centres_mm[[number for number, _ in pairs]]
            fit = register(found.centres_mm[[k for _, k in pairs]], there)
            self.fitted_mm2 += [fit.fre_mm**2] * len(pairs)

    def row(self, case: Case) -> dict[str, object]:
        said = sorted(set(self.said))
        if not self.squares_mm2:
            return {
                "fault": case.words,
                "options": _format_options(case),
                "told": " / ".join(said) or "refused",
            }
        return {
            "fault": case.words,
            "options": _format_options(case),
            "volumes": self.volumes,
            "refused": self.refused,
            "markers": self.markers,
            "missed": self.missed,
            "false": self.false,
            "error_um": round(1e3 * float(np.sqrt(np.mean(self.squares_mm2))), 1),
            "largest_um": round(1e3 * float(np.sqrt(np.max(self.squares_mm2))), 1),
            "fitted_um": round(1e3 * float(np.sqrt(np.mean(self.fitted_mm2))), 1),
            "chi2": round(float(np.mean(self.chi2)), 2),
            "told": " / ".join(said),
        }


def _format_options(case: Case) -> str:
    words = [
        " ".join([f"--{name.replace('_', '-')}", *_format_values(value)])
        for name, value in case.faults.active().items()
    ]
    return " ".join(words)


def _format_values(value: object) -> list[str]:
    if isinstance(value, tuple):
        return [f"{one:g}" for one in value]
    if value is True:
        return []
    return [f"{value:g}" if isinstance(value, float) else str(value)]


def _format_refusal(error: RonnaError) -> str:
    return f"{error.code}: {error.summary.partition(';')[0].partition('. ')[0]}"


def _make_scan(case: Case, seed: int) -> Scan:
    scan = replace(family_scan(FAMILY, PROTOCOL, seed=seed), faults=case.faults)
    if case.slice_mm is not None:
        slices = int(scan.grid.slices * scan.grid.slice_mm / case.slice_mm)
        scan = replace(scan, grid=replace(scan.grid, slice_mm=case.slice_mm, slices=slices))
    return scan if case.noise_hu is None else with_noise(scan, case.noise_hu)


def with_noise(scan: Scan, noise_hu: float) -> Scan:
    protocol = scan.scene.ct.model_copy(update={"noise_HU": noise_hu})
    return replace(scan, scene=scan.scene.model_copy(update={"ct": protocol}))


def measure(case: Case, volumes: int, seed: int) -> dict[str, object]:
    cost = Cost()
    slow = case.faults.beam_hardening > 0.0  # to paint: one volume
    for number in range(1 if slow else volumes):
        cost.add(paint(_make_scan(case, seed + number), WHOLE_SLICES_MM))
    return cost.row(case)


@dataclass
class Quiet:
    """Largest values measured in scans without motion or displaced slices."""

    volumes: int = 0
    measured: int = 0  # volumes with markers whose shape tells
    across_mm: float = 0.0
    share: float = 0.0
    backwards: float = 0.0
    strain_percent: float = 0.0
    chi_square: float = 0.0
    told: list[str] = field(default_factory=list)

    def add(self, painted: Painted) -> None:
        """Measure a scan and update the largest values."""
        volume = painted.volume
        self.volumes += 1
        found_jumps = estimate_jumps(volume.voxels, volume.geometry)
        self.across_mm = max(self.across_mm, float(found_jumps.across_mm.max()))
        self.share = max(self.share, float(found_jumps.shares.max()))
        self.backwards = max(self.backwards, -float(found_jumps.runs.min()))
        try:
            self.told += check_motion(volume.voxels, volume.geometry)
            found = localize(volume)
            require_undeformed(found.deformation)
        except RonnaError as error:
            if not isinstance(error, MarkerCountWrong):
                self.told.append(_format_refusal(error))
            return
        if found.deformation is None:
            return
        self.measured += 1
        strain, chi_square = np.array(found.deformation.strain), found.deformation.chi_square
        self.strain_percent = max(self.strain_percent, 1e2 * float(np.ptp(np.linalg.eigvalsh(strain))))
        self.chi_square = max(self.chi_square, chi_square)

    def figures(self) -> dict[str, object]:
        return {
            "volumes": self.volumes,
            "measured": self.measured,
            "across_mm": round(self.across_mm, 2),
            "share": round(self.share, 2),
            "backwards": round(self.backwards, 2),
            "strain_percent": round(self.strain_percent, 2),
            "chi_square": round(self.chi_square, 1),
            "told": " / ".join(sorted(set(self.told))),
        }


def quiet(volumes: int, seed: int) -> Quiet:
    """Measure volumes of every family and protocol, cycling through the kernels and slice overlaps."""
    found = Quiet()
    kernels = list(KERNELS)
    for family in FAMILIES:
        for protocol in PROTOCOLS:
            for number in range(volumes):
                turn = found.volumes
                faults = ScannerFaults(kernel=kernels[turn % len(kernels)])
                scan = family_scan(family, protocol, seed=seed + number)
                if turn % 2:
                    faults = replace(faults, thickness_mm=1.5 * scan.grid.slice_mm)
                found.add(paint(replace(scan, faults=faults), WHOLE_SLICES_MM))
    return found


def refused(case: Case, seed: int) -> dict[str, object]:
    scan = replace(plain_scan(draw_scene("mini", seed=seed)), faults=case.faults)
    with tempfile.TemporaryDirectory() as folder:
        try:
            read_series(write_case(scan.scene, Path(folder), scan=scan).series)
            said = "read without a warning"
        except RonnaError as error:
            said = f"{error.code}: {error.summary}"
    return {"fault": case.words, "options": _format_options(case), "told": said}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--volumes", type=int, default=4, help="of each fault")
    parser.add_argument("--seed", type=int, default=9000)
    parser.add_argument("--quiet", type=int, default=1, help="volumes of each family and protocol")
    parser.add_argument("--write", action="store_true", help="into docs/reference/scanner-faults.toml")
    arguments = parser.parse_args()
    rows = []
    for case in (*CASES, *HIDDEN):
        rows.append(measure(case, arguments.volumes, arguments.seed))
        print(rows[-1], flush=True)
    for case in TILTS:
        rows.append(refused(case, arguments.seed))
        print(rows[-1], flush=True)
    without = quiet(arguments.quiet, arguments.seed).figures()
    print(without)
    if arguments.write:
        DATA.write_text(tomli_w.dumps({"quiet": without, "fault": rows}), encoding="utf-8")


if __name__ == "__main__":
    main()

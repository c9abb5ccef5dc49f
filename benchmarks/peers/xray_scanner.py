"""Head slabs with marker spheres, scanned by XCIST and reconstructed by RTK, for `foreign_spheres`.

    python xray_scanner.py FOLDER [--family FAMILY ...] [--scans 2] [--seed 7601]

Runs in an environment of its own with `gecatsim` and `itk-rtk` (versions of the extra `xray`; no dependency
of this project). The build script of gecatsim 1.6.9 has line ends of Windows: unpack its source, run
`sed -i 's/\\r$//' gecatsim/clib_build/BuildLinux64 gecatsim/clib_build/Makefile*`, then `pip install .`.
XCIST projects analytic bodies: tungsten spectrum at 120 kV, cells with an area, quanta, electronic noise, and
a correction for water. RTK reconstructs by Feldkamp, Davis and Kress. Only what is scanned is described here.
Writes one file per scan, and skips those that exist: voxels in HU, their spacing, and the true centres.

Coordinates: x and y across, z along the table, mm from the isocentre; voxels are indexed (z, y, x).
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gecatsim  # type: ignore[import-not-found]  # only in the environment that scans
import itk  # type: ignore[import-not-found]  # likewise
import numpy as np
from itk import RTK as rtk  # noqa: N811 - as its own examples name it

SOURCE_MM, DETECTOR_MM = 540.0, 950.0  # from the source to the isocentre, to the detector
COLUMNS, ROWS, CELL_MM = 520, 68, (0.9, 1.2)
VIEWS, ENERGIES, TUBE_MA = 360, 6, 30.0
WATER_PER_MM = 0.02  # to which the correction for water scales
FIELD_MM = (246.0, 37.0, 212.0)  # x, z, y
BALL_MM, FILM_MM, FILM_DENSITY = 5.75, 0.1, 1.5
INTO_BALL_MM, FLANGE_BELOW_MM, FLANGE_MM = 1.5, 10.5, (3.5, 1.0)  # flange: radius, half the thickness
SPHERES, OTHERS = 30, 4
STANDOFF_MM = (15.0, 20.0)  # from the skin to the middle of a ball
SPHERE_Z_MM = (6.0, 8.0)  # above and below the middle in turn
LEANING_DEG = 25.0  # of a post, off the normal of the skin
MATERIALS = (
    "ncat_skin",
    "ncat_skull",
    "ncat_brain",
    "PMMA",
    "polystyrene",
    "Ti",
    "Fe",
    "Ag",
    "ncat_water",
    "air",
)
POLYMERS = ("PMMA", "polystyrene")


@dataclass(frozen=True)
class Family:
    """Contents and protocol of a scan: post and its radii, fillings, the filter's Hann cut, voxels."""

    name: str
    post: str
    post_mm: tuple[float, float]
    hann_cut: float  # of the Nyquist frequency; 0 is the bare ramp
    pixel_mm: float
    slice_mm: float
    fillings: int = 0


FAMILIES = {
    one.name: one
    for one in (
        Family("polymer", "PMMA", (1.4, 2.2), 0.8, 0.65, 1.0),
        Family("coarse", "PMMA", (1.4, 2.2), 0.6, 0.7, 1.5),
        Family("titanium", "Ti", (1.4, 2.0), 0.8, 0.65, 1.0),
        Family("steel", "Fe", (1.0, 1.4), 0.8, 0.65, 1.0),
        Family("fillings", "Ti", (1.4, 2.0), 1.0, 0.6, 0.8, fillings=3),
    )
}


@dataclass
class Bodies:
    """Bodies in XCIST's language; a later one replaces those that it overlaps."""

    text: list[str] = field(default_factory=list)

    def add(
        self,
        centre: np.ndarray,
        half_axes: tuple[float, float, float],
        material: str,
        *,
        along: np.ndarray | None = None,
        density: float = 1.0,
        above: float | None = None,
    ) -> None:
        """Add an ellipsoid, or a cylinder `along` an axis; `above` cuts it there, by distance along z."""
        number = len(self.text) + 1
        tilt = np.degrees(np.arccos(along[2])) if along is not None else 0.0
        turn = np.degrees(np.arctan2(along[0], -along[1])) if along is not None else 0.0
        kind = 1 if along is None else 2
        clip = "" if above is None else f"0 0 -1 {-above}"
        self.text.append(
            f"object.center({number},:) = [{centre[0]:.6f} {centre[1]:.6f} {centre[2]:.6f}];\n"
            f"object.half_axes({number},:) = [{half_axes[0]:.6f} {half_axes[1]:.6f} {half_axes[2]:.6f}];\n"
            f"object.euler_angs({number},:) = [0.0 {tilt:.6f} {turn:.6f}];\n"
            f"object.density({number}) = {density:.6f};\n"
            f"object.type({number}) = {kind};\n"
            f"object.material({number}) = {MATERIALS.index(material) + 1};\n"
            f"object.axial_lims({number},:) = [0 0];\n"
            f"object.shape({number}) = 0;\n"
            f"object.clip{{{number}}} = [{clip}];\n"
        )

    def write(self, path: Path) -> None:
        names = " ".join(f"'{name}'" for name in MATERIALS)
        path.write_text(f"materialList = {{{names}}};\n\n" + "\n".join(self.text))


def add_head(bodies: Bodies, random: np.random.Generator, fillings: int) -> np.ndarray:
    """Add skin, skull, brain, ventricles and fillings. Return the half-axes of the skin."""
    skin = np.array([random.uniform(86.0, 94.0), random.uniform(68.0, 76.0), 110.0])
    middle = np.array([0.0, 0.0, random.uniform(-15.0, 15.0)])
    scalp, bone = random.uniform(4.0, 6.0), random.uniform(5.0, 8.0)
    for inwards, material in ((0.0, "ncat_skin"), (scalp, "ncat_skull"), (scalp + bone, "ncat_brain")):
        bodies.add(middle, tuple(skin - inwards), material)
    for side in (-1.0, 1.0):
        turned = np.array([0.3 * side, 1.0, 0.2])
        bodies.add(
            np.array([18.0, 10.0 * side, 0.0]),
            (5.0, 4.0, 22.0),
            "ncat_water",
            along=turned / np.linalg.norm(turned),
        )
    bodies.add(np.array([skin[0] - 16.0, random.uniform(-8.0, 8.0), 0.0]), (4.0, 9.0, 7.0), "air")
    for _ in range(fillings):
        place = np.array([*random.uniform(-45.0, 45.0, 2), random.uniform(-8.0, 8.0)])
        bodies.add(place, (2.0, 2.0, random.uniform(1.0, 2.0)), "Ag", along=np.array([0.0, 0.0, 1.0]))
    return skin


def place_outside(
    skin: np.ndarray, turn: float, standoff_mm: float, z: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return a place outside the skin, and the direction inwards, at an angle around the head."""
    at = np.array([skin[0] * np.cos(turn), skin[1] * np.sin(turn), z])
    normal = at / skin**2 * [1.0, 1.0, 0.0]
    normal /= np.linalg.norm(normal)
    return at + standoff_mm * normal, -normal


def lean(inwards: np.ndarray, random: np.random.Generator) -> np.ndarray:
    aside = np.cross(inwards, random.standard_normal(3))
    angle = np.radians(random.uniform(0.0, LEANING_DEG))
    return np.asarray(np.cos(angle) * inwards + np.sin(angle) * aside / np.linalg.norm(aside))


def add_marker(
    bodies: Bodies, family: Family, ball: np.ndarray, inwards: np.ndarray, random: np.random.Generator
) -> None:
    """Add a ball with its film on a post with a flange, down into the skull."""
    core = str(random.choice(POLYMERS))
    bodies.add(ball, (BALL_MM, BALL_MM, BALL_MM), core, density=FILM_DENSITY)
    inner = BALL_MM - FILM_MM
    bodies.add(ball, (inner, inner, inner), core, density=random.uniform(1.0, 1.1))
    down = lean(inwards, random)
    start, end = BALL_MM - INTO_BALL_MM, random.uniform(26.0, 30.0)
    radius = random.uniform(*family.post_mm)
    bodies.add(
        ball + 0.5 * (start + end) * down, (radius, radius, 0.5 * (end - start)), family.post, along=down
    )
    bodies.add(
        ball + FLANGE_BELOW_MM * down, (FLANGE_MM[0], FLANGE_MM[0], FLANGE_MM[1]), family.post, along=down
    )


def add_other(bodies: Bodies, kind: int, place: np.ndarray, inwards: np.ndarray) -> None:
    """Add something that is no marker: a cylinder, a larger or smaller ball, or a rod with round ends."""
    if kind == 0:
        bodies.add(place, (6.0, 6.0, 6.0), "PMMA", along=inwards)
    elif kind == 1:
        bodies.add(place, (8.0, 8.0, 8.0), "PMMA")
    elif kind == 2:
        bodies.add(place, (4.75, 4.75, 4.75), "PMMA")
    else:
        across = np.cross(inwards, [0.0, 0.0, 1.0])
        bodies.add(place, (BALL_MM, BALL_MM, 3.0), "PMMA", along=across / np.linalg.norm(across))
        for sign in (-3.0, 3.0):
            bodies.add(place + sign * across / np.linalg.norm(across), (BALL_MM, BALL_MM, BALL_MM), "PMMA")


def draw_scene(family: Family, random: np.random.Generator) -> tuple[Bodies, np.ndarray]:
    """Draw a slab of a head with markers and other objects. Return it and the centres of the markers."""
    bodies = Bodies()
    skin = add_head(bodies, random, family.fillings)
    count = SPHERES + OTHERS
    turns = 2.0 * np.pi * (np.arange(count) + random.uniform(-0.1, 0.1, count)) / count
    others = random.choice(count, OTHERS, replace=False)
    centres = []
    for number, turn in enumerate(turns):
        z = (-1.0) ** number * random.uniform(*SPHERE_Z_MM)
        place, inwards = place_outside(skin, float(turn), random.uniform(*STANDOFF_MM), z)
        if number in others:
            add_other(bodies, int(random.integers(4)), place, inwards)
        else:
            add_marker(bodies, family, place, inwards, random)
            centres.append(place)
    return bodies, np.array(centres)


def project(bodies: Bodies, scratch: Path, seed: int) -> np.ndarray:
    """Return the corrected line integrals (views, rows, columns) by XCIST."""
    bodies.write(scratch / "bodies.ppm")
    scan = gecatsim.CatSim()
    scan.resultsName = str(scratch / "scan")
    scan.phantom.callback, scan.phantom.projectorCallback = "Phantom_Analytic", "C_Projector_Analytic"
    scan.phantom.filename, scan.phantom.projectorNumThreads = str(scratch / "bodies.ppm"), 2
    scan.protocol.viewsPerRotation = scan.protocol.viewCount = VIEWS
    scan.protocol.stopViewId = VIEWS - 1
    scan.protocol.mA, scan.protocol.bowtie = TUBE_MA, []
    scan.scanner.sid, scan.scanner.sdd = SOURCE_MM, DETECTOR_MM
    scan.scanner.detectorColCount = scan.scanner.detectorColsPerMod = COLUMNS  # one module: flat
    scan.scanner.detectorRowCount = scan.scanner.detectorRowsPerMod = ROWS
    scan.scanner.detectorColSize, scan.scanner.detectorRowSize = CELL_MM
    scan.scanner.detectorColOffset = 0.0
    scan.physics.energyCount = ENERGIES
    scan.physics.colSampleCount = scan.physics.rowSampleCount = 2
    scan.physics.srcXSampleCount = scan.physics.srcYSampleCount = scan.physics.viewSampleCount = 1
    scan.physics.callback_post_log = "Prep_BHC_Accurate"
    scan.physics.EffectiveMu = 10.0 * WATER_PER_MM
    scan.physics.BHC_poly_order, scan.physics.BHC_max_length_mm, scan.physics.BHC_length_step_mm = 5, 220, 10
    scan.physics.BHC_vec_fname = str(scratch.parent / "water.npy")
    np.random.seed(seed)  # its quanta come from the global generator
    scan.run_all()
    prepared = np.fromfile(f"{scan.resultsName}.prep", dtype=np.float32)
    return prepared.reshape(VIEWS, ROWS, COLUMNS)


def reconstruct(lines: np.ndarray, family: Family) -> tuple[np.ndarray, np.ndarray]:
    """Return voxels (z, y, x) in HU by RTK, and their spacing. RTK's axes are ours as x, z, y."""
    views, rows, columns = lines.shape
    geometry = rtk.ThreeDCircularProjectionGeometry.New()
    for view in range(views):
        geometry.AddProjection(SOURCE_MM, DETECTOR_MM, -360.0 * view / views)
    stack = itk.image_from_array(np.ascontiguousarray(lines, dtype=np.float32))
    stack.SetSpacing([*CELL_MM, 1.0])
    stack.SetOrigin([-0.5 * (columns - 1) * CELL_MM[0], -0.5 * (rows - 1) * CELL_MM[1], 0.0])
    spacing = family.pixel_mm, family.slice_mm, family.pixel_mm
    size = [round(field / each) for field, each in zip(FIELD_MM, spacing, strict=True)]
    kind = itk.Image[itk.F, 3]
    empty = rtk.ConstantImageSource[kind].New()
    empty.SetSize(size)
    empty.SetSpacing(spacing)
    empty.SetOrigin([-0.5 * (count - 1) * each for count, each in zip(size, spacing, strict=True)])
    empty.SetConstant(0.0)
    feldkamp = rtk.FDKConeBeamReconstructionFilter[kind].New()
    feldkamp.SetInput(0, empty.GetOutput())
    feldkamp.SetInput(1, stack)
    feldkamp.SetGeometry(geometry)
    feldkamp.GetRampFilter().SetHannCutFrequency(family.hann_cut)
    feldkamp.Update()
    attenuation = itk.array_from_image(feldkamp.GetOutput()).transpose(1, 0, 2)
    return 1000.0 * (attenuation / WATER_PER_MM - 1.0), np.array([spacing[1], spacing[2], spacing[0]])


def scan_head(family: Family, seed: list[int], folder: Path) -> dict[str, Any]:
    random = np.random.default_rng(seed)
    bodies, centres = draw_scene(family, random)
    lines = project(bodies, folder, int(random.integers(2**31)))
    hu, spacing = reconstruct(lines, family)
    return {
        "hu": np.clip(np.rint(hu), -1024, 3071).astype(np.int16),
        "spacing_mm": spacing,
        "centres_mm": centres,
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--family", nargs="+", default=list(FAMILIES), choices=FAMILIES)
    parser.add_argument("--scans", type=int, default=2)
    parser.add_argument("--seed", type=int, default=7601)
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    for number in range(options.scans):
        for name in options.family:
            family = FAMILIES[name]
            path = options.folder / f"{name}-{number:02d}.npz"
            if path.exists():
                continue
            with tempfile.TemporaryDirectory(dir=options.folder) as scratch:
                scan = scan_head(family, [options.seed, list(FAMILIES).index(name), number], Path(scratch))
            np.savez_compressed(path, **scan)
            used = os.times()
            print(json.dumps({"scan": path.stem, "processor_s": round(used.user + used.system)}), flush=True)


if __name__ == "__main__":
    main()

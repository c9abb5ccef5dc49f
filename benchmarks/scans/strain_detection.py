"""Stretch of a scan that the shapes of its spheres show in 90 % of the scans, by the covariance of one scan.

One undistorted scan of the family `plain` for each protocol; the test of its spheres then has a noncentral
chi-square for a stretch along any direction.

    python -m benchmarks.scans.strain_detection --seed 9000 > strain-detection.json
"""

from __future__ import annotations

import argparse
import json
import sys

import numpy as np
from scipy.special import chndtrinc

from benchmarks.scans.look_alikes import WHOLE_SLICES_MM, paint
from procedures.imaging import localize
from procedures.imaging.markers import ScanDeformation
from procedures.imaging.scan_deformation import SYMMETRIC, TRACELESS
from ronna_hw.arrays import Array
from sim.phantom.families.family_scan import family_scan

FAMILY = "plain"
PROTOCOLS = ("good", "fine", "usual")
FOUND_SHARE = 0.9
DIRECTIONS = 1000
ALONG_TABLE = np.array([0.0, 0.0, 1.0])


def found_percent(measured: ScanDeformation, along: Array) -> float:
    """Return the stretch in % along a unit vector (3,) that is found in `FOUND_SHARE` of the scans."""
    shape = np.outer(along, along) - np.eye(3) / 3.0
    terms = shape[SYMMETRIC][TRACELESS]
    needed = float(chndtrinc(measured.limit, len(terms), 1.0 - FOUND_SHARE))
    return 100.0 * float(np.sqrt(needed / (terms @ np.linalg.solve(np.array(measured.covariance), terms))))


def main() -> None:
    """Print median, smallest and largest over all directions, and that along the table, in JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=9000)
    seed = parser.parse_args().seed
    directions = np.random.default_rng(seed).normal(size=(DIRECTIONS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found: dict[str, dict[str, float]] = {}
    for protocol in PROTOCOLS:
        measured = localize(
            paint(family_scan(FAMILY, protocol, seed=seed), WHOLE_SLICES_MM).volume
        ).deformation
        if measured is None:
            continue
        percent = [found_percent(measured, one) for one in directions]
        found[protocol] = {
            "spheres": measured.spheres,
            "median_percent": float(np.median(percent)),
            "smallest_percent": min(percent),
            "largest_percent": max(percent),
            "along_table_percent": found_percent(measured, ALONG_TABLE),
        }
    sys.stdout.write(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()

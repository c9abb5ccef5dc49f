"""Two localizer versions on the same volumes: this one, and that of another checkout.

Volumes are painted by this version; the other one reads them from disk, in a process of its own. One table
counts the objects of each kind that are listed among the markers, the other compares what became of markers.

    git worktree add ../before 48efb7f2
    python -m benchmarks.scans.before_and_after ../before rounded caps --volumes 12 --seed 231500
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import numpy as np

from benchmarks.scans.look_alikes import (
    CHI2_99,
    MARGINS_MM,
    SAME_SPHERE_MM,
    WHOLE_MM,
    Count,
    Painted,
    paint,
    scans,
)
from procedures.imaging import Localization, Marker, Volume, localize
from procedures.imaging.errors import MarkerCountWrong
from ronna_hw.arrays import Array
from sim.phantom.families.catalogue import FAMILIES, PROTOCOLS

OTHER = """
import json, sys
import numpy as np
from procedures.imaging import Volume, VoxelGeometry, localize
from procedures.imaging.errors import MarkerCountWrong

for line in sys.stdin:
    with np.load(line.strip()) as stored:
        voxels, origin, axes, spacing = (stored[name] for name in ("voxels", "origin", "axes", "spacing"))
    geometry = VoxelGeometry(voxels.shape, origin, axes, spacing)
    try:
        markers = localize(Volume(voxels, geometry, "1.2.3", "1.2.4")).markers
    except MarkerCountWrong:
        markers = ()
    found = [(np.array(m.centre_mm).tolist(), np.array(m.covariance_mm2).tolist()) for m in markers]
    print(json.dumps(found), flush=True)
"""


@dataclass
class Outcome:
    """Results of one localizer version: markers by family and protocol, and false markers by kind."""

    counts: dict[str, Count] = field(default_factory=dict)
    errors_mm: dict[str, list[float]] = field(default_factory=dict)  # of each marker; infinite if missed
    taken: Counter[str] = field(default_factory=Counter)

    def add(self, condition: str, found: Localization | None, painted: Painted) -> None:
        self.counts.setdefault(condition, Count()).add(found, (), painted)
        centres_mm = np.empty((0, 3)) if found is None else found.centres_mm
        self.errors_mm.setdefault(condition, []).extend(
            _least_distance_mm(one, centres_mm) for one in painted.centres_mm
        )
        of_markers = np.concatenate([painted.centres_mm, painted.cut_mm])
        nearest = {
            int(np.argmin([_least_distance_mm(one, places) for _, places in painted.objects]))
            for one in centres_mm
            if painted.objects and _least_distance_mm(one, of_markers) >= SAME_SPHERE_MM
        }
        self.taken.update(painted.objects[number][0] for number in nearest)


class OtherLocalizer:
    def __init__(self, questions: IO[str], answers: IO[str], folder: Path) -> None:
        self._questions, self._answers = questions, answers
        self._path = folder / "volume.npz"

    def __call__(self, volume: Volume) -> Localization | None:
        held = volume.geometry
        np.savez(
            self._path, voxels=volume.voxels, origin=held.origin_mm, axes=held.axes, spacing=held.spacing_mm
        )
        print(self._path, file=self._questions, flush=True)
        answer = json.loads(self._answers.readline())
        markers = tuple(
            Marker(
                centre_mm=centre,
                covariance_mm2=spread,
                radius_mm=0.0,
                quality=0.0,
                agreement_mm=0.0,
                flags=(),
                odds=1.0,
            )
            for centre, spread in answer
        )
        return Localization(markers, (), "", "", 0.0) if markers else None


@contextmanager
def other_localizer(checkout: Path) -> Iterator[OtherLocalizer]:
    """Start the localizer of another checkout in a child process with this interpreter."""
    with (
        tempfile.TemporaryDirectory() as folder,
        subprocess.Popen(
            [sys.executable, "-c", OTHER],
            cwd=checkout,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        ) as child,
    ):
        assert child.stdin is not None
        assert child.stdout is not None
        with child.stdin:  # the other process ends with its questions
            yield OtherLocalizer(child.stdin, child.stdout, Path(folder))


def _least_distance_mm(centre_mm: Array, places: Array) -> float:
    return float(np.linalg.norm(places - centre_mm, axis=1).min(initial=np.inf))


def _localize_today(volume: Volume) -> Localization | None:
    try:
        return localize(volume)
    except MarkerCountWrong:
        return None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("before", type=Path, help="checkout of the other version")
    parser.add_argument("families", nargs="+")
    parser.add_argument("--volumes", type=int, default=12, help="of each family, protocols in turn")
    parser.add_argument("--seed", type=int, default=7000)
    arguments = parser.parse_args()
    before, today, objects = Outcome(), Outcome(), Counter[str]()
    with other_localizer(arguments.before) as other:
        for family in arguments.families:
            for protocol in PROTOCOLS:
                for scan in scans(family, protocol, arguments.volumes, arguments.seed):
                    painted = paint(scan, MARGINS_MM if FAMILIES[family].look_alikes else WHOLE_MM)
                    objects.update(kind for kind, _ in painted.objects)
                    before.add(f"{family} | {protocol}", other(painted.volume), painted)
                    today.add(f"{family} | {protocol}", _localize_today(painted.volume), painted)
    print("| kind | objects | markers before | today |\n|---|---|---|---|")
    for kind, number in objects.items():
        print(f"| {kind} | {number} | {before.taken[kind]} | {today.taken[kind]} |")
    print("\nBefore and today; rms and largest error in µm, `both` of the markers that both found.\n")
    print("| family | protocol | markers | missed | false | rms | both | largest | chi² / 3n | beyond 99 % |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for condition, count in before.counts.items():
        rows = zip(_figures(before, today, condition), _figures(today, before, condition), strict=True)
        print(f"| {condition} | {count.markers} | {' | '.join(', '.join(pair) for pair in rows)} |")


def _figures(outcome: Outcome, other: Outcome, condition: str) -> tuple[str, ...]:
    count = outcome.counts[condition]
    errors_mm, others_mm = np.array(outcome.errors_mm[condition]), np.array(other.errors_mm[condition])
    both_mm = errors_mm[(errors_mm < SAME_SPHERE_MM) & (others_mm < SAME_SPHERE_MM)]
    return (
        f"{count.missed}",
        f"{count.false}",
        f"{count.rms_um:.1f}",
        f"{1e3 * np.sqrt((both_mm**2).sum() / max(len(both_mm), 1)):.1f}",
        f"{1e3 * count.largest_mm:.1f}",
        f"{sum(count.chi2) / (3.0 * max(len(count.chi2), 1)):.2f}",
        f"{sum(one > CHI2_99 for one in count.chi2)}",
    )


if __name__ == "__main__":
    main()

"""The thesis' clinical pairing protocol (5.3.2): 17 localized scans of the x-shaped frame, 1,415 readings.

The scans are those of the localization study, each with a scale error. The readings come from the simulated
tracker over its protocol, with the frame alone in the room. The thesis' method pairs the output of our copy
of its localizer, our method that of ours. There are no strays.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy.spatial.transform import Rotation

from procedures.imaging.localizers import LOCALIZERS, Localizer
from procedures.registration.similarity_matrix import Counting, match_many_by_similarity
from procedures.registration.thesis_matching import validate_many
from procedures.registration.thesis_settings import THESIS_TOLERANCES_MM
from ronna_hw.arrays import Array
from ronna_hw.bounded_input import MOST_VALUES, parse_json, parse_toml, read_json_bytes
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.control_port import ControlPortClient
from ronna_hw.devices.readings import Validity
from ronna_hw.devices.sensors import OpticalTracker, new_frames
from ronna_hw.host.child_process import ChildProcess, command, run_command
from ronna_hw.records import write_atomically
from ronna_hw.registry import make_device
from studies.campaign import bounds
from studies.campaign.plots import curves
from studies.campaign.study import Cell, Study, Sums, Table, Unit, as_sums, generator
from studies.correspondence.outcomes import LOST, SUCCESS, Pairs, outcome_key, outcome_of
from studies.correspondence.study import StudiedMatching, pair_points
from studies.errors import LEDGER_UNREADABLE, OTHER_STUDY, TRACKER_NOT_SIMULATED
from studies.heads import NoiseReading, variance_from_thesis_mm2
from studies.localization.phantom_scans import phantom_scan
from studies.localization.study import SEED_BOUND
from studies.localization.thesis_protocol import (
    FRAME,
    FRAME_MM,
    PATIENT,
    PHANTOM,
    PROTOCOL,
    THESIS_SCANS,
    ThesisScan,
    draw_scale,
    localize_scan,
)

PHANTOM_SCANS = 5
SCANS: tuple[ThesisScan, ...] = tuple(
    scan for scan in THESIS_SCANS if scan.kind == PATIENT or scan.number <= PHANTOM_SCANS
)
# Values of e, mm, at which the thesis matches every reading: figures 14 and 15, as stated in the text.
THESIS_RANGES_MM = {PHANTOM: (1.8, 4.5), PATIENT: (2.5, 4.0)}
THESIS_READINGS = 1415
# Readings of what a cell counts, each validated, by name of the series.
ANY_COUNTERPART = f"{StudiedMatching.VALIDATED}, any counterpart"
COUNTINGS = {StudiedMatching.VALIDATED.value: Counting.ONE_TO_ONE, ANY_COUNTERPART: Counting.ANY}
NOISE = NoiseReading.NORM  # the interpretation that reproduces the thesis' other figures
READINGS_FILE = "frame-readings.json"
ORIENTATIONS = 28
SPHERES = len(FRAME_MM)
# The Spectra's pyramid reaches from 0.95 to 2.4 m and is at least half as wide as the distance: the whole
# frame stays inside it. NDI's brochure.
DEPTH_MM = (1050.0, 2300.0)
HALF_WIDTH, MARGIN_MM = 0.24, 60.0  # share of the distance; the frame's half width
LARGEST_TILT_RAD = radians(60.0)  # of the frame from facing the tracker
ATTEMPTS = 20
LIMIT_S = 60.0  # host time, as a safeguard


@dataclass(frozen=True, eq=False)
class ClinicalStudy(Study):
    """Pairing of all readings (n, 4, 3), mm, with every scan, one unit per scan."""

    readings_mm: Array
    seed: int = 0
    name: str = "correspondence-xframe"

    def settings(self) -> dict[str, object]:
        return {
            "seed": self.seed,
            "readings": len(self.readings_mm),
            "readings_sha256": hashlib.sha256(self.readings_mm.tobytes()).hexdigest(),
            "scans": len(SCANS),
            "tolerances_mm": list(THESIS_TOLERANCES_MM),
        }

    def units(self) -> Sequence[Unit]:
        return [Unit(scan.condition, 0, len(self.readings_mm)) for scan in SCANS]

    def run(self, unit: Unit) -> Sums:
        """Count the outcomes of our method, and of the thesis' method for each e."""
        (drawn,) = (scan for scan in SCANS if scan.condition == unit.condition)
        random = generator(self.seed, unit)
        seed = int(random.integers(SEED_BOUND))
        with phantom_scan(drawn.family, PROTOCOL, seed, FRAME, drawn.spheres) as scan:
            found = localize_scan(scan)
        (scale,) = draw_scale(random, 1)
        image = {method: one.frame_mm(scale) for method, one in found.items()}
        sums = self._count_our_outcomes(
            image[LOCALIZERS[Localizer.OURS].method], random
        ) + self._count_thesis_outcomes(image[LOCALIZERS[Localizer.THESIS_SPHERE].method], random)
        return as_sums(sums)

    def _count_our_outcomes(self, image_mm: Array | None, random: np.random.Generator) -> Counter[str]:
        if image_mm is None:
            return Counter({outcome_key(StudiedMatching.COUNT, None, LOST): len(self.readings_mm)})
        physical_mm, rights = self._shuffle_readings(random)
        sums: Counter[str] = Counter()
        for seen_mm, right in zip(physical_mm, rights, strict=True):
            one = pair_points(image_mm, seen_mm, NOISE, expected=len(image_mm))
            sums[outcome_key(StudiedMatching.COUNT, None, outcome_of(one, right))] += 1
        return sums

    def _count_thesis_outcomes(self, image_mm: Array | None, random: np.random.Generator) -> Counter[str]:
        sums: Counter[str] = Counter()
        many = len(self.readings_mm)
        for tolerance_mm in THESIS_TOLERANCES_MM:
            if image_mm is None:
                for method in COUNTINGS:
                    sums[outcome_key(method, tolerance_mm, LOST)] += many
                continue
            physical_mm, rights = self._shuffle_readings(random)
            image = np.broadcast_to(image_mm, physical_mm.shape)
            for method, counting in COUNTINGS.items():
                found = match_many_by_similarity(
                    image, physical_mm, np.full(many, tolerance_mm), SPHERES, counting
                )
                valid = validate_many(image, physical_mm, found, variance_from_thesis_mm2(NOISE))
                for right, one in zip(rights, valid, strict=True):
                    sums[outcome_key(method, tolerance_mm, outcome_of(one, right))] += 1
        return sums

    def _shuffle_readings(self, random: np.random.Generator) -> tuple[Array, list[Pairs]]:
        many, spheres = self.readings_mm.shape[:2]
        order = random.permuted(np.tile(np.arange(spheres), (many, 1)), axis=1)
        seen = np.take_along_axis(self.readings_mm, order[:, :, None], axis=1)
        return seen, [frozenset((int(i), j) for j, i in enumerate(one)) for one in order]


def tables(sums: Mapping[str, Sums]) -> list[Table]:
    """Tabulate the values of e with which the thesis' method pairs every reading, and our success."""
    rows: list[dict[str, Cell]] = []
    for kind, (low, high) in THESIS_RANGES_MM.items():
        against = success_against_tolerance(sums, kind)
        if not against:
            continue
        runs, ours = _success_share(sums, kind, StudiedMatching.COUNT.value, "")
        perfect = [e for e, share in against if share == 1.0]
        any_perfect = [
            e for e, share in success_against_tolerance(sums, kind, ANY_COUNTERPART) if share == 1.0
        ]
        within = [share for e, share in against if low <= e <= high]
        rows.append(
            {
                "scans of": kind,
                "readings": runs,
                "ours, success %": 100.0 * ours,
                bounds.column("ours"): bounds.percent(ours * runs, runs).text,
                "thesis, validated: best %": 100.0 * max(share for _, share in against),
                "100 % from e mm": min(perfect, default=None),
                "100 % to e mm": max(perfect, default=None),
                "any counterpart: 100 % in": (
                    f"{min(any_perfect):g}-{max(any_perfect):g}" if any_perfect else "none"
                ),
                "thesis: 100 % in": f"{low:g}-{high:g}",
                "least % there, here": 100.0 * min(within),
            }
        )
    apart_mm = np.diff(
        np.sort(np.linalg.norm(FRAME_MM[:, None] - FRAME_MM[None], axis=2)[np.triu_indices(4, 1)])
    )
    return [
        Table.of(
            "The x-shaped frame in scans and readings",
            rows,
            f"{len(SCANS)} scans; the thesis reports 24,055 of 24,055. The distances of this "
            f"frame differ by at least {apart_mm.min():.2f} mm, those of the thesis' frame by "
            f"more than 4.5. {bounds.NOTE}",
        )
    ]


def plots(sums: Mapping[str, Sums]) -> dict[str, bytes]:
    """Plot success against e for both countings: figure 14 for the phantom, 15 for the patients."""
    pictures = {}
    for figure, (kind, ends) in zip((14, 15), THESIS_RANGES_MM.items(), strict=True):
        lines = {
            f"counted {counting.value}": [
                (e, 100.0 * share) for e, share in success_against_tolerance(sums, kind, method)
            ]
            for method, counting in COUNTINGS.items()
        }
        pictures[f"figure-{figure}-{kind}.png"] = curves(
            f"x-shaped frame, scans of {kind}s, the thesis' method",
            "e, mm",
            "success, %",
            lines,
            bands={"thesis: all matched": ends},
        )
    return pictures


def success_against_tolerance(
    sums: Mapping[str, Sums], kind: str, method: str = StudiedMatching.VALIDATED.value
) -> list[tuple[float, float]]:
    """Return the validated thesis method's success rate by e (mm), for one kind of scan and one counting."""
    found = [(e, *_success_share(sums, kind, method, f"{e}")) for e in THESIS_TOLERANCES_MM]
    return [(e, share) for e, runs, share in found if runs]


def _success_share(sums: Mapping[str, Sums], kind: str, method: str, tolerance: str) -> tuple[int, float]:
    runs, success = 0.0, 0.0
    for condition, content in sums.items():
        for key, number in content.items():
            if condition.startswith(kind) and key.startswith(f"{method}|{tolerance}|"):
                runs += number
                success += number if key.endswith(f"|{SUCCESS}") else 0.0
    return int(runs), success / runs if runs else 0.0


def load_or_take_readings(
    folder: Path, count: int, seed: int, progress: Callable[[float], None] = lambda share: None
) -> Array:
    """Return the readings stored in the study's folder, taking them first if necessary.

    Raises STU-001, STU-002, STU-008.
    """
    path = folder / READINGS_FILE
    if not path.exists():
        new_readings_mm = take_readings(count, seed, progress)
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(path, json.dumps({"seed": seed, "readings_mm": new_readings_mm.tolist()}).encode())
        return new_readings_mm
    try:
        content = parse_json(read_json_bytes(path, most_values=MOST_VALUES))
        readings = np.atleast_1d(np.array(content["readings_mm"], dtype=float))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise LEDGER_UNREADABLE(f"{path} is damaged: {error}") from error
    if readings.shape != (count, SPHERES, 3) or content.get("seed") != seed:
        raise OTHER_STUDY(f"{folder} has {len(readings)} readings, drawn with another count or seed")
    return readings


def take_readings(count: int, seed: int, progress: Callable[[float], None] = lambda share: None) -> Array:
    """Take `count` readings (n, 4, 3) in the tracker frame, mm, spheres in frame order. Raises STU-008."""
    random = np.random.default_rng([seed, count])
    readings: list[Array] = []
    shares = np.diff(np.linspace(0, count, min(ORIENTATIONS, count) + 1).astype(int))
    for share in shares.tolist():
        orientation = _draw_orientation(random)
        with _open_room(orientation, int(random.integers(SEED_BOUND))) as read_frame_at:
            for _ in range(share):
                readings.append(_take_whole_reading(read_frame_at, orientation.apply(FRAME_MM), random))
                progress(len(readings) / count)
    return np.array(readings)


def _take_whole_reading(
    read_frame_at: Callable[[Array], Array], frame_mm: Array, random: np.random.Generator
) -> Array:
    """Take a reading of all four spheres, trying random positions until all are visible."""
    for _ in range(ATTEMPTS):
        place_mm = _draw_place(random)
        seen_mm = read_frame_at(place_mm)
        if len(seen_mm) == SPHERES:
            # Pairing must find the order; here it is known from the frame's position.
            away_mm = np.linalg.norm(seen_mm[:, None] - (frame_mm + place_mm)[None], axis=2)
            return np.asarray(seen_mm[away_mm.argmin(axis=0)])
    raise TRACKER_NOT_SIMULATED(f"the tracker did not see {SPHERES} spheres at {ATTEMPTS} positions")


def _draw_place(random: np.random.Generator) -> Array:
    """Draw a position uniformly distributed over the pyramidal measurement volume."""
    near, far = DEPTH_MM
    depth = random.uniform(near**3, far**3) ** (1.0 / 3.0)
    across = random.uniform(-1.0, 1.0, 2) * (HALF_WIDTH * depth - MARGIN_MM)
    return np.array([*across, -depth])


def _draw_orientation(random: np.random.Generator) -> Rotation:
    """Draw an orientation facing the tracker, rotated about the frame's normal and tilted."""
    turn = Rotation.from_rotvec([0.0, 0.0, random.uniform(0.0, 2.0 * np.pi)])
    about = random.uniform(0.0, 2.0 * np.pi)
    tilt = random.uniform(0.0, LARGEST_TILT_RAD) * np.array([np.cos(about), np.sin(about), 0.0])
    return Rotation.from_rotvec(tilt) * turn


@contextmanager
def _open_room(orientation: Rotation, seed: int) -> Iterator[Callable[[Array], Array]]:
    """Start a tracker unit and its driver. Yield a function that reads the frame at a position (3,)."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        scene = Path(folder) / "frame.json"
        scene.write_text(json.dumps(_bench_scene(orientation, seed)), encoding="utf-8")
        arguments = command("sim.cli", "polaris", "--endpoint", "tcp://127.0.0.1:0", "--scene", str(scene))
        unit = stack.enter_context(ChildProcess("ronna-sim polaris", arguments))
        control = stack.enter_context(ControlPortClient(unit.ready["control"]))
        config = DeviceConfig(driver="ndi_polaris", endpoint=unit.ready["endpoint"], options={})
        tracker = cast("OpticalTracker", make_device("tracker", config, HostClock()))
        stack.callback(tracker.close)
        stack.enter_context(tracker.active(LIMIT_S))

        def read_frame_at(place_mm: Array) -> Array:
            control.ask("clear_faults")
            x, y, z = (f"{value:.4f}" for value in place_mm)
            control.ask("fault", line=f"now: room shift head {x} {y} {z} mm")
            _, frame = new_frames(tracker, 2)  # the first may predate the frame's placement
            if frame.validity is not Validity.OK:
                return np.empty((0, 3))
            return np.array([stray.position_mm for stray in frame.strays]).reshape(-1, 3)

        yield read_frame_at


def _bench_scene(orientation: Rotation, seed: int) -> dict[str, Any]:
    """Return a bench scene containing only the frame, with coincident robot and tracker frames."""
    words = command("sim.cli", "scene", "--scene", "bench", "--seed", str(seed))
    done = run_command("ronna-sim scene", words, LIMIT_S)
    if done.returncode != 0:
        raise TRACKER_NOT_SIMULATED("ronna-sim scene", got=" ".join(done.stderr.split()))
    scene = parse_toml(done.stdout)
    here = {"translation_mm": [0.0, 0.0, 0.0], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}
    turned = orientation.as_quat(scalar_first=True).tolist()
    scene["head"] |= {
        "robot_from_ct": here | {"quaternion_wxyz": turned},
        "seating_error_mm": 0.0,  # a rigid one-piece frame
        "centre_ct_mm": [0.0, 0.0, 1e5],  # no head: it is behind the tracker
        "fiducials": [
            {"number": number, "centre_ct_mm": centre, "post_ct": [0.0, 0.0, 1.0]}
            for number, centre in enumerate(FRAME_MM.tolist(), start=1)
        ],
    }
    scene["tracker"] |= {
        "robot_from_tracker": here,
        "places": [],
        "strays_mm": [],
        "fiducials_visible": True,
        "reflections": 0,
    }
    return scene

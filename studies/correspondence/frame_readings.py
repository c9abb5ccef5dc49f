"""Readings of the x-shaped frame by the simulated tracker over its protocol, the frame alone in the room.

The thesis constantly moved its frame until all of the working volume was covered (5.3.2). It states its
tracker's error, 0.56 mm, but neither its direction nor how fast the frame moved. A Polaris images passive
spheres at once, so that a motion does not deform the frame; a tracker that exposes one sphere after the other
would. Each condition is one answer to these questions.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy.spatial.transform import Rotation

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
from ronna_hw.wire.polaris import FRAME_RATE_HZ
from studies.errors import LEDGER_UNREADABLE, OTHER_STUDY, TRACKER_NOT_SIMULATED
from studies.heads import PHYSICAL_SIGMA_MM
from studies.localization.study import SEED_BOUND
from studies.localization.thesis_protocol import FRAME_MM

READINGS_FILE = "frame-readings.json"
SPHERES = len(FRAME_MM)
# The Spectra's pyramid reaches from 0.95 to 2.4 m and is at least half as wide as the distance: the whole
# frame stays inside it. NDI's brochure.
DEPTH_MM = (1050.0, 2300.0)
MIDDLE_MM = 1675.0  # of the pyramid, where a scene states the noise, which grows with the squared distance
MIDDLE_PLACE_MM: Array = np.array([0.0, 0.0, -MIDDLE_MM])  # of the frame before it is moved
HALF_WIDTH, MARGIN_MM = 0.24, 60.0  # share of the distance; the frame's half width
LARGEST_TILT_RAD = np.radians(60.0)  # of the frame from facing the tracker
BIAS_MM = 0.25  # rms length, of the simulated Spectra as its data sheet states it
DEPTH_RATIO = 3.5  # noise along the line of sight to that across, of the simulated Spectra
HAND_MM_S, HAND_DEG_S = 100.0, 30.0  # assumed: the volume is crossed in ten seconds
MOTION_S = 2.0  # longer than a reading takes
INTERVAL_MS = 1e3 / FRAME_RATE_HZ / SPHERES  # assumed: the spheres share the period of a frame
ATTEMPTS = 20
LIMIT_S = 60.0  # host time, as a safeguard


@dataclass(frozen=True)
class ReadingConditions:
    """Tracker and motion during readings; noise is one standard deviation at mid volume, per axis.

    None is the noise of the simulated Spectra.
    """

    name: str
    noise_mm: tuple[float, float, float] | None = None
    is_moving: bool = False
    sphere_interval_ms: float = 0.0


def _noise_mm(depth_ratio: float) -> tuple[float, float, float]:
    """Return the noise at mid volume with which the error has the thesis' rms length over the volume.

    The bias is a part of that error.
    """
    near, far = DEPTH_MM
    # Mean of the fourth power of a depth whose cube is uniform, as places are drawn.
    growth = 3.0 / 7.0 * (far**7 - near**7) / (far**3 - near**3) / MIDDLE_MM**4
    length_mm = np.sqrt((PHYSICAL_SIGMA_MM**2 - BIAS_MM**2) / growth)
    across_mm = float(length_mm / np.sqrt(2.0 + depth_ratio**2))
    return across_mm, across_mm, depth_ratio * across_mm


SPECTRA_STILL = ReadingConditions("Spectra, still")
CONDITIONS = (
    SPECTRA_STILL,
    ReadingConditions("0.56 mm, moving", _noise_mm(1.0), is_moving=True),
    ReadingConditions("0.56 mm, mostly in depth, moving", _noise_mm(DEPTH_RATIO), is_moving=True),
    ReadingConditions(
        "0.56 mm, moving, one sphere after the other", _noise_mm(1.0), True, sphere_interval_ms=INTERVAL_MS
    ),
)
Progress = Callable[[float], None]


def load_or_take_readings(
    folder: Path, count: int, seed: int, progress: Progress = lambda share: None
) -> dict[str, Array]:
    """Return the readings of all conditions stored in the study's folder, taking them first if necessary.

    Raises STU-001, STU-002, STU-008.
    """
    path = folder / READINGS_FILE
    if not path.exists():
        new_mm = {
            conditions.name: take_readings(conditions, count, seed, _part_of(progress, place))
            for place, conditions in enumerate(CONDITIONS)
        }
        folder.mkdir(parents=True, exist_ok=True)
        readings = {name: one.tolist() for name, one in new_mm.items()}
        write_atomically(path, json.dumps({"seed": seed, "readings_mm": readings}).encode())
        return new_mm
    try:
        content = parse_json(read_json_bytes(path, most_values=MOST_VALUES))
        found = {name: np.array(one, dtype=float) for name, one in content["readings_mm"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise LEDGER_UNREADABLE(f"{path} is damaged: {error}") from error
    expected = {one.name: (count, SPHERES, 3) for one in CONDITIONS}
    if {name: one.shape for name, one in found.items()} != expected or content.get("seed") != seed:
        raise OTHER_STUDY(f"{folder} has readings drawn with another count, seed or conditions")
    return found


def _part_of(progress: Progress, place: int) -> Progress:
    """Return the progress of one of the conditions as a part of the whole."""
    return lambda share: progress((place + share) / len(CONDITIONS))


def take_readings(
    conditions: ReadingConditions, count: int, seed: int, progress: Progress = lambda share: None
) -> Array:
    """Take `count` readings (n, 4, 3) in the tracker frame, mm, spheres in frame order. Raises STU-008."""
    random = np.random.default_rng([seed, count])
    readings: list[Array] = []
    with _open_room(conditions, int(random.integers(SEED_BOUND))) as read_strays:
        for _ in range(count):
            readings.append(_take_whole_reading(read_strays, conditions.is_moving, random))
            progress(len(readings) / count)
    return np.array(readings)


def _take_whole_reading(
    read_strays: Callable[[tuple[str, ...]], Array], is_moving: bool, random: np.random.Generator
) -> Array:
    """Take a reading of all four spheres, trying random poses of the frame until all are visible."""
    for _ in range(ATTEMPTS):
        orientation = _draw_orientation(random)
        turn_deg = np.degrees(orientation.as_rotvec())
        faults: tuple[str, ...] = (
            f"room shift head {_words(_draw_place(random) - MIDDLE_PLACE_MM)} mm",
            f"room turn head {_words(turn_deg)} deg",
        )
        if is_moving:
            way_mm = HAND_MM_S * MOTION_S * _draw_direction(random)
            turn_deg = HAND_DEG_S * MOTION_S * _draw_direction(random)
            faults += (
                f"room shift head {_words(way_mm)} mm over {MOTION_S:g} s",
                f"room turn head {_words(turn_deg)} deg over {MOTION_S:g} s",
            )
        seen_mm = read_strays(faults)
        if len(seen_mm) == SPHERES:
            # Pairing must find the order; here it is known from the frame's orientation, which a motion
            # changes by a few degrees until the reading.
            frame_mm = orientation.apply(FRAME_MM - FRAME_MM.mean(axis=0))
            within_mm = seen_mm - seen_mm.mean(axis=0)
            away_mm = np.linalg.norm(within_mm[:, None] - frame_mm[None], axis=2)
            return np.asarray(seen_mm[away_mm.argmin(axis=0)])
    raise TRACKER_NOT_SIMULATED(f"the tracker did not see {SPHERES} spheres in {ATTEMPTS} poses")


def _words(vector: Array) -> str:
    return " ".join(f"{value:.4f}" for value in vector)


def _draw_place(random: np.random.Generator) -> Array:
    """Draw a position uniformly distributed over the pyramidal measurement volume."""
    near, far = DEPTH_MM
    depth = random.uniform(near**3, far**3) ** (1.0 / 3.0)
    across = random.uniform(-1.0, 1.0, 2) * (HALF_WIDTH * depth - MARGIN_MM)
    return np.array([*across, -depth])


def _draw_direction(random: np.random.Generator) -> Array:
    direction = random.normal(size=3)
    return np.asarray(direction / np.linalg.norm(direction))


def _draw_orientation(random: np.random.Generator) -> Rotation:
    """Draw an orientation facing the tracker, rotated about the frame's normal and tilted."""
    turn = Rotation.from_rotvec([0.0, 0.0, random.uniform(0.0, 2.0 * np.pi)])
    about = random.uniform(0.0, 2.0 * np.pi)
    tilt = random.uniform(0.0, LARGEST_TILT_RAD) * np.array([np.cos(about), np.sin(about), 0.0])
    return Rotation.from_rotvec(tilt) * turn


@contextmanager
def _open_room(conditions: ReadingConditions, seed: int) -> Iterator[Callable[[tuple[str, ...]], Array]]:
    """Start a tracker unit and its driver. Yield a function that reads all strays under some faults."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        scene = Path(folder) / "frame.json"
        scene.write_text(json.dumps(_bench_scene(conditions, seed)), encoding="utf-8")
        arguments = command("sim.cli", "polaris", "--endpoint", "tcp://127.0.0.1:0", "--scene", str(scene))
        unit = stack.enter_context(ChildProcess("ronna-sim polaris", arguments))
        control = stack.enter_context(ControlPortClient(unit.ready["control"]))
        config = DeviceConfig(driver="ndi_polaris", endpoint=unit.ready["endpoint"], options={})
        tracker = cast("OpticalTracker", make_device("tracker", config, HostClock()))
        stack.callback(tracker.close)
        stack.enter_context(tracker.active(LIMIT_S))

        def read_strays(faults: tuple[str, ...]) -> Array:
            control.ask("clear_faults")
            for fault in faults:
                control.ask("fault", line=f"now: {fault}")
            _, frame = new_frames(tracker, 2)  # the first may predate the frame's placement
            if frame.validity is not Validity.OK:
                return np.empty((0, 3))
            return np.array([stray.position_mm for stray in frame.strays]).reshape(-1, 3)

        yield read_strays


def _bench_scene(conditions: ReadingConditions, seed: int) -> dict[str, Any]:
    """Return a bench scene containing only the frame, with coincident robot and tracker frames."""
    words = command("sim.cli", "scene", "--scene", "bench", "--seed", str(seed))
    done = run_command("ronna-sim scene", words, LIMIT_S)
    if done.returncode != 0:
        raise TRACKER_NOT_SIMULATED("ronna-sim scene", got=" ".join(done.stderr.split()))
    scene = parse_toml(done.stdout)
    here = {"translation_mm": [0.0, 0.0, 0.0], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}
    scene["head"] |= {
        "robot_from_ct": here | {"translation_mm": MIDDLE_PLACE_MM.tolist()},
        "seating_error_mm": 0.0,  # a rigid one-piece frame
        # No head: a grain at the frame's origin, about which it turns, hides nothing.
        "centre_ct_mm": [0.0, 0.0, 0.0],
        "semi_axes_mm": [1.0, 1.0, 1.0],
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
        "bias_mm": BIAS_MM,
        "sphere_interval_ms": conditions.sphere_interval_ms,
    }
    if conditions.noise_mm is not None:
        x_mm, _, z_mm = conditions.noise_mm
        scene["tracker"] |= {"noise_xy_mm": x_mm, "noise_z_mm": z_mm}
    return scene

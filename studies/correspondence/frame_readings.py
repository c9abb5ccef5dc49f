"""Readings of the close x-shaped frame from the simulated tracker, over its protocol.

The frame is alone in the room, as four stray spheres. The unit is restarted for every orientation; in
between, the frame is moved to positions all over the measuring volume, and each is read once by the driver.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from math import radians
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ronna_hw.bounded_input import MOST_VALUES, parse_json, parse_toml, read_json_bytes
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.readings import Validity
from ronna_hw.devices.sensors import OpticalTracker, new_frames
from ronna_hw.host.child_process import ChildProcess, command, finished_command
from ronna_hw.host.control_port import ControlPortClient
from ronna_hw.records import write_whole
from ronna_hw.registry import make_device
from studies.errors import LedgerUnreadable, OtherStudy, TrackerNotSimulated
from studies.localization.study import SEED_BOUND
from studies.localization.thesis_scans import FRAME_MM

Array = NDArray[np.float64]

FILE = "frame-readings.json"
ORIENTATIONS = 28
SPHERES = len(FRAME_MM)
# The Spectra's pyramid reaches from 0.95 to 2.4 m and is at least half as wide as the distance: the whole
# frame stays inside it. NDI's brochure.
DEPTH_MM = (1050.0, 2300.0)
HALF_WIDTH, MARGIN_MM = 0.24, 60.0  # share of the distance; the frame's half width
LARGEST_TILT_RAD = radians(60.0)  # of the frame from facing the tracker
ATTEMPTS = 20
LIMIT_S = 60.0  # host time, as a safeguard


def recorded_readings(
    folder: Path, count: int, seed: int, progress: Callable[[float], None] = lambda share: None
) -> Array:
    """The readings stored in a study's folder, taken now if there are none.

    Raises STU-001, STU-002, STU-008.
    """
    path = folder / FILE
    if not path.exists():
        taken = read_frames(count, seed, progress)
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps({"seed": seed, "readings_mm": taken.tolist()}).encode())
        return taken
    try:
        content = parse_json(read_json_bytes(path, most_values=MOST_VALUES))
        readings = np.atleast_1d(np.array(content["readings_mm"], dtype=float))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise LedgerUnreadable(f"{path} is damaged: {error}") from error
    if readings.shape != (count, SPHERES, 3) or content.get("seed") != seed:
        raise OtherStudy(f"{folder} has {len(readings)} readings, drawn with another count or seed")
    return readings


def read_frames(count: int, seed: int, progress: Callable[[float], None] = lambda share: None) -> Array:
    """`count` readings (n, 4, 3) in the tracker's frame, mm, spheres in the frame's order. Raises STU-008."""
    random = np.random.default_rng([seed, count])
    readings: list[Array] = []
    shares = np.diff(np.linspace(0, count, min(ORIENTATIONS, count) + 1).astype(int))
    for share in shares.tolist():
        orientation = _orientation(random)
        with _room(orientation, int(random.integers(SEED_BOUND))) as read_at:
            for _ in range(share):
                readings.append(_whole_reading(read_at, orientation.apply(FRAME_MM), random))
                progress(len(readings) / count)
    return np.array(readings)


def _whole_reading(read_at: Callable[[Array], Array], frame_mm: Array, random: np.random.Generator) -> Array:
    """A reading with all four spheres; positions that do not show them are skipped, as a person would."""
    for _ in range(ATTEMPTS):
        place_mm = _place(random)
        seen_mm = read_at(place_mm)
        if len(seen_mm) == SPHERES:
            # The order is what pairing must find; here it is known from the frame's position.
            away_mm = np.linalg.norm(seen_mm[:, None] - (frame_mm + place_mm)[None], axis=2)
            return np.asarray(seen_mm[away_mm.argmin(axis=0)])
    raise TrackerNotSimulated(f"the tracker did not see {SPHERES} spheres at {ATTEMPTS} positions")


def _place(random: np.random.Generator) -> Array:
    """Uniform in the volume: its cross-section grows with the square of the distance."""
    near, far = DEPTH_MM
    depth = random.uniform(near**3, far**3) ** (1.0 / 3.0)
    across = random.uniform(-1.0, 1.0, 2) * (HALF_WIDTH * depth - MARGIN_MM)
    return np.array([*across, -depth])


def _orientation(random: np.random.Generator) -> Rotation:
    """Orientation facing the tracker, turned about the frame's normal and tilted."""
    turn = Rotation.from_rotvec([0.0, 0.0, random.uniform(0.0, 2.0 * np.pi)])
    about = random.uniform(0.0, 2.0 * np.pi)
    tilt = random.uniform(0.0, LARGEST_TILT_RAD) * np.array([np.cos(about), np.sin(about), 0.0])
    return Rotation.from_rotvec(tilt) * turn


@contextmanager
def _room(orientation: Rotation, seed: int) -> Iterator[Callable[[Array], Array]]:
    """A unit and its driver; yields a function that reads the spheres with the frame at a position (3,)."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        scene = Path(folder) / "frame.json"
        scene.write_text(json.dumps(_scene(orientation, seed)), encoding="utf-8")
        arguments = command("sim.cli", "polaris", "--endpoint", "tcp://127.0.0.1:0", "--scene", str(scene))
        unit = stack.enter_context(ChildProcess("ronna-sim polaris", arguments))
        control = stack.enter_context(ControlPortClient(unit.ready["control"]))
        config = DeviceConfig(driver="ndi_polaris", endpoint=unit.ready["endpoint"], options={})
        tracker = cast("OpticalTracker", make_device("tracker", config, HostClock()))
        stack.callback(tracker.close)
        stack.enter_context(tracker.active(LIMIT_S))

        def read_at(place_mm: Array) -> Array:
            control.ask("clear_faults")
            x, y, z = (f"{value:.4f}" for value in place_mm)
            control.ask("fault", line=f"now: room shift head {x} {y} {z} mm")
            _, frame = new_frames(tracker, 2)  # the first may predate the frame's placement
            if frame.validity is not Validity.OK:
                return np.empty((0, 3))
            return np.array([stray.position_mm for stray in frame.strays]).reshape(-1, 3)

        yield read_at


def _scene(orientation: Rotation, seed: int) -> dict[str, Any]:
    """The bench with only the frame in it, at the origin; robot and tracker frame coincide."""
    words = command("sim.cli", "scene", "--scene", "bench", "--seed", str(seed))
    done = finished_command("ronna-sim scene", words, LIMIT_S)
    if done.returncode != 0:
        raise TrackerNotSimulated("ronna-sim scene", got=" ".join(done.stderr.split()))
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

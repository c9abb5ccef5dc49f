"""True pose of the mounted guide, and truth samples of the instrument tip.

The guide is pushed, badly seated or bent by faults. Only the verifier reads the samples.
"""

from __future__ import annotations

import math
from math import radians
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from ronna_hw.bounded_input import read_json_lines
from ronna_hw.calibration import Numbers3, Strict
from ronna_hw.mistakes import describe_mistakes
from sim.errors import BAD_TRUTH, STAND_NOT_READY
from sim.world.displacements import STILL, ShiftedRoom, rigid_move, yielding_flange
from sim.world.faults import FaultBoard
from sim.world.faults import room as room_faults
from sim.world.noise import noise
from sim.world.rigid import Matrix, Vector, as_point, inverse, matrix_from, matrix_of, rotation_from_vector
from sim.world.world import World

SLIDES_MM = 2.0  # way of the assistant's clamp along the instrument, against a friction
BINDS_MM = 1.0  # beside the axis of the bore at one of its ends: beyond it a held instrument bends
SEAT, PLAY = "changer", "bore"  # noise keys

TRUTH_FILE = "truth.jsonl"
SCENE_FILE = "scene.json"
THEATRE_FOLDER = "theatre"
LARGEST_TRUTH_BYTES = 1_000_000  # four thousand samples
MOST_MISTAKES = 5  # listed in one error


class TipSample(Strict):
    """True instrument tip position at one moment, in the robot frame."""

    target: str
    theatre_time_s: float
    mounted_tool: int
    arm_at_rest: bool
    tip_mm: Numbers3
    axis: Numbers3  # direction of the guide's bore, unit vector
    # Displacement of the head from its place in the scene, robot frame: turn about the origin, then shift.
    head_shift_mm: Numbers3 = STILL
    head_turn_rad: Numbers3 = STILL
    # Of an instrument that an assistant holds: its axis beside that of the bore, at the farther end of it.
    held_off_mm: float | None = None
    held_off_rad: float | None = None

    @property
    def head_moved(self) -> Matrix:
        """Head displacement as a transform (4, 4)."""
        return rigid_move(self.head_turn_rad, self.head_shift_mm)


def sample_instrument(world: World, guide: TrueGuide, target: str, stop_mm: float, draw: int) -> TipSample:
    """Sample the true tip of an instrument inserted up to its depth stop.

    `target` is a name of the caller's; `draw` distinguishes insertions there, each elsewhere within the
    bore's play.
    """
    return _sample_tip(world, guide, target, guide.instrument_tip_mm(stop_mm, target, draw))


def _sample_tip(world: World, guide: TrueGuide, target: str, tip_mm: Vector) -> TipSample:
    room = ShiftedRoom(world).now()
    return TipSample(
        target=target,
        theatre_time_s=world.clock.now_s(),
        mounted_tool=world.mounted_tool(),
        arm_at_rest=world.arm().at_rest,
        tip_mm=as_point(tip_mm),
        axis=as_point(guide.tip_frame()[:3, 2]),
        head_shift_mm=room.head_mm,
        head_turn_rad=room.head_rad,
    )


def sample_seated_instrument(
    world: World, guide: TrueGuide, target: str, stop_mm: float
) -> tuple[TipSample, float]:
    """Sample the true tip of an instrument that the assistant has led into the guide, and the gap in mm.

    The bore decides where it is, within its play on the side to which the assistant holds it. Its clamp
    slides once the depth stop rests on the guide. Raises SIM-015 where it would bind or not slide.
    """
    room, bore = ShiftedRoom(world), world.scene.mount.guide
    now = room.now()
    clamps = [
        room.robot_from_base(role, now) @ world.arm(role).robot_from_flange @ matrix_of(one.flange_from_clamp)
        for role, one in world.scene.holders.items()
        if world.has_arm(role)
    ]
    if not clamps:
        raise STAND_NOT_READY("there is no assistant that holds an instrument")
    (clamp,) = clamps
    in_guide = inverse(guide.tip_frame()) @ clamp @ _loosened(world)
    upper_z, lower_z = -bore.bore_mm - bore.reach_mm, -bore.reach_mm
    gap_mm = float(upper_z - in_guide[2, 3])
    if gap_mm < -SLIDES_MM:
        raise STAND_NOT_READY(
            "the clamp has slid to its end", limit=f"{SLIDES_MM:g} mm", got=f"{-gap_mm:.2f} mm"
        )
    gap_mm = max(0.0, gap_mm)
    ends = [_beside_mm(in_guide, z) for z in (upper_z, lower_z)]
    off_mm = max(float(np.linalg.norm(end)) for end in ends)
    if off_mm > BINDS_MM:
        raise STAND_NOT_READY(
            "the instrument binds in the guide",
            action="Leave the instrument where it is, and find out which arm, cart or head was moved.",
            limit=f"{BINDS_MM:g} mm beside its axis",
            got=f"{off_mm:.2f} mm",
        )
    upper, lower = (
        end * min(1.0, bore.play_mm / 2.0 / max(float(np.linalg.norm(end)), 1e-9)) for end in ends
    )
    sample = _sample_tip(world, guide, target, guide.tip_between_mm(stop_mm - gap_mm, upper, lower))
    held_off = {"held_off_mm": off_mm, "held_off_rad": math.acos(min(1.0, float(in_guide[2, 2])))}
    return sample.model_copy(update=held_off), gap_mm


def _loosened(world: World) -> Matrix:
    """Return clamp <- instrument's own clamp frame (4, 4) as a loose clamp leaves it."""
    pose = np.eye(4)
    for fault in FaultBoard(world, room_faults.DEVICE).active(room_faults.LOOSE_INSTRUMENT.name):
        *shift_mm, tilt_deg = map(float, fault.arguments)
        pose = pose @ matrix_from(shift_mm, rotation_from_vector((radians(tilt_deg), 0.0, 0.0)))
    return pose


def _beside_mm(pose: Matrix, z_mm: float) -> Vector:
    """Return where the z axis of a pose passes the plane at a height, (2,)."""
    along = pose[:3, 2] / pose[2, 2]
    return np.asarray(pose[:2, 3] + along[:2] * (z_mm - pose[2, 3]))


def append_sample(sample: TipSample, folder: Path) -> None:
    """Append a sample to the theatre's truth file."""
    with (folder / TRUTH_FILE).open("a", encoding="utf-8") as file:
        file.write(sample.model_dump_json() + "\n")


def read_samples(folder: Path) -> list[TipSample]:
    """Read all samples of a theatre in order, or none if there is no file; raises SIM-007."""
    path = folder / TRUTH_FILE
    return parse_samples(truth_bytes(path)) if path.exists() else []


def truth_bytes(path: Path) -> bytes:
    """Read a truth file; raises INP-001, SIM-007."""
    try:
        return read_json_lines(path, LARGEST_TRUTH_BYTES)
    except OSError as error:
        raise BAD_TRUTH(f"cannot read {path.name}: {error.strerror}") from error


def parse_samples(content: bytes) -> list[TipSample]:
    """Parse the content of a truth file; raises SIM-007 listing the errors by line."""
    try:
        lines = content.decode().splitlines()
    except UnicodeDecodeError as error:
        raise BAD_TRUTH(f"{TRUTH_FILE} is not UTF-8 text: {error.reason}") from error
    samples: list[TipSample] = []
    mistakes: list[str] = []
    for number, line in enumerate(lines, 1):
        try:
            samples.append(TipSample.model_validate_json(line))
        except ValidationError as error:
            mistakes.append(f"line {number}: {', '.join(describe_mistakes(error))}")
            if len(mistakes) >= MOST_MISTAKES:
                break
    if mistakes:
        raise BAD_TRUTH(f"{TRUTH_FILE} has invalid lines: {'; '.join(mistakes)}")
    return samples


class TrueGuide:
    """True poses (4, 4) of the guide's tip frame in the robot frame, given the world and room faults."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._scene = world.scene
        self._board = FaultBoard(world, room_faults.DEVICE)
        self._room = ShiftedRoom(world)
        mount = self._scene.mount
        self._flange_from_marker = matrix_of(mount.flange_from_tool_true) @ matrix_of(
            mount.tool_from_marker_true
        )
        self._tip_at_calibration = tip_at_calibration(world)
        self._seat_offset_mm = (-1, np.zeros(3))  # by the number of mountings

    def tip_frame(self, flange: Matrix | None = None) -> Matrix:
        """Return the pose of the calibrated mandrel's end, including the guide's bend.

        `flange` is its pose without a push, by default the present one.
        """
        return self.bore_frame(flange) @ self._bend()

    def bore_frame(self, flange: Matrix | None = None) -> Matrix:
        """Return the pose without the guide's bend, for the parts above the bore."""
        flange = self._world.arm().robot_from_flange if flange is None else flange
        room = self._room.now()
        pose = yielding_flange(flange, self._flange_from_marker, room).copy()
        pose[2, 3] -= self._scene.arm.sag_mm_kg * sum(
            float(one.argument) for one in self._board.active(room_faults.WRONG_LOAD.name)
        )
        moved = rigid_move(room.seat_rad, room.seat_mm)
        return pose @ self._tip_at_calibration @ moved @ self._seat_pose()

    def mandrel(self) -> Matrix:
        """Return the pose of the end of the mandrel in use."""
        longer_mm = sum(float(one.argument) for one in self._board.active(room_faults.WRONG_MANDREL.name))
        return self.tip_frame() @ matrix_from((0.0, 0.0, longer_mm), np.eye(3))

    def instrument_tip_mm(self, stop_mm: float, target: str, draw: int) -> Vector:
        """Draw the tip (3,) of an instrument inserted to its depth stop, within the play of the bore."""
        guide = self._scene.mount.guide
        upper, lower = _draw_in_disc(noise(self._scene.seed, f"{PLAY} {target}", draw), guide.play_mm / 2.0)
        return self.tip_between_mm(stop_mm, upper, lower)

    def tip_between_mm(self, stop_mm: float, upper: Vector, lower: Vector) -> Vector:
        """Return the tip (3,) of an instrument at these places (2,) in both ends of the bore."""
        guide = self._scene.mount.guide
        longer_mm = sum(float(one.argument) for one in self._board.active(room_faults.WRONG_INSTRUMENT.name))
        beyond_mm = stop_mm + longer_mm - guide.bore_mm
        offset_mm = lower + (lower - upper) * beyond_mm / guide.bore_mm
        for fault in self._board.active(room_faults.BENT_INSTRUMENT.name):
            offset_mm += [float(number) for number in fault.arguments]
        point = np.array([*offset_mm, beyond_mm - guide.reach_mm, 1.0])
        return np.asarray((self.tip_frame() @ point)[:3])

    def _seat_pose(self) -> Matrix:
        again = max(0, self._world.mountings() - 1)
        if self._seat_offset_mm[0] != again:
            drawn_mm = noise(self._scene.seed, SEAT, again).normal(0.0, self._scene.mount.guide.seat_mm, 3)
            self._seat_offset_mm = (again, drawn_mm)
        seat_offset_mm = self._seat_offset_mm[1].copy()
        tilt_rad = 0.0
        for fault in self._board.active(room_faults.BAD_SEAT.name):
            seat_offset_mm[2] -= float(fault.argument)
            tilt_rad += radians(float(fault.arguments[1]))
        return matrix_from(seat_offset_mm, rotation_from_vector((tilt_rad, 0.0, 0.0)))

    def _bend(self) -> Matrix:
        """Return the guide's bend, about the upper end of the bore."""
        guide = self._scene.mount.guide
        away = np.array(guide.bent_mm)
        for fault in self._board.active(room_faults.BENT_TIP.name):
            away += [float(number) for number in fault.arguments]
        height_mm = guide.bore_mm + guide.reach_mm
        tilt = (-away[1] / height_mm, away[0] / height_mm, 0.0)
        whole = rotation_from_vector(np.add(tilt, (*np.radians(guide.tilt_deg), 0.0)))
        pivot, back = (matrix_from((0.0, 0.0, z), np.eye(3)) for z in (-height_mm, height_mm))
        return pivot @ matrix_from((0.0, 0.0, away[2]), whole) @ back


def tip_at_calibration(world: World) -> Matrix:
    """Return FLANGE <- tip (4, 4) at the time of the calibration records."""
    mount = world.scene.mount
    return matrix_of(mount.flange_from_tool_true) @ matrix_of(mount.tool_from_tip_true)


def _draw_in_disc(generator: np.random.Generator, radius_mm: float) -> tuple[Vector, Vector]:
    radii = radius_mm * np.sqrt(generator.uniform(size=2))
    angles = generator.uniform(0.0, 2.0 * np.pi, 2)
    one, other = (
        radius * np.array([np.cos(angle), np.sin(angle)]) for radius, angle in zip(radii, angles, strict=True)
    )
    return one, other

"""Records of a run, a theatre and a study, and compressed slices, with what reads them."""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import io
import json
import math
import os
import struct
from collections import deque
from collections.abc import Callable
from pathlib import Path

import gdcm
import numpy as np
import psutil
from bounded_cost import LIMIT_S
from good_inputs import JOURNAL_OF_A_RUN, PLACE, TEMPLATE, Take, reading
from painted_ct import compress_slice, write_series

from conformance.case import Nonconformity
from conformance.polaris.client import read_body
from drivers.basler_stereo.readings import decode_pixels
from procedures.engine.errors import NotRecorded
from procedures.engine.order import order_of
from procedures.engine.replay.recorded_answers import iterate_readings, read_answers
from procedures.exchange.raw_readings import missing_in_raw
from procedures.imaging.dicom.frame_decoder import FrameDecoder
from procedures.imaging.dicom.slice_headers import read_headers
from procedures.imaging.series import read_pixels
from procedures.planning.proposed_place import ProposedPlace, read_place
from procedures.reporting.calibration_figures import load_figures
from procedures.reporting.ending import ending_of
from procedures.reporting.kept_truth import load_truth
from procedures.reporting.run_events import notable_events, questions
from procedures.reporting.run_reading import read_for_report
from procedures.reporting.run_statistics import link_counters, timeline
from procedures.steps.calibration.recipe import Recipe
from ronna_hw.bounded_input import parse_json
from ronna_hw.devices.lifecycle import Identity, Lifecycle
from ronna_hw.devices.readings import (
    AreaOfInterest,
    ArmReading,
    CameraImage,
    LinkStatistics,
    Stamp,
    StereoReading,
    StrayReading,
    ToolIdentity,
    ToolReading,
    TrackerFrame,
    Validity,
)
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import FIRST
from ronna_hw.frames import Frame, Transform
from ronna_hw.marker_template import read_marker_template
from ronna_hw.recording.reading_coding import ANSWERS, RECORDED_PROPERTIES
from ronna_hw.recording.reading_tape import READINGS_FILE, ReadingTape
from ronna_hw.wire.gige_vision import PixelFormat
from sim.world.control_port import ControlledRoom
from sim.world.saved_world import read_saved_world
from sim.world.scene.named_scenes import draw_scene
from sim.world.truth import read_samples
from sim.world.world import World
from studies.campaign import folder as study_folder
from studies.campaign.study import add_up
from studies.correspondence import frame_readings
from studies.registration import RegistrationStudy

ROOM_REQUESTS = (
    b'{"do":"mount","number":1}',
    b'{"do":"fault","line":"now: tracker bump"}',
    b'{"do":"step","name":"set_up"}',
    b'{"do":"stand","holds":"divot"}',
    b'{"do":"work","task":"insert","trajectory":"T1","numbers":[1.5]}',
    b'{"do":"clear_faults"}',
)
STUDY = RegistrationStudy(2, seed=5, fiducials=(3,))
UNIT = STUDY.units()[0].key
REHASHED = 20  # lines of a ledger
STAMP = Stamp(7, 4242, 1.25)
LEDGER = b"".join(
    json.dumps(line).encode() + b"\n"
    for line in (
        study_folder.head_of(STUDY),
        {"unit": UNIT, "sums": {"runs": 2.0, "squares_mm2": 0.5}},
    )
)
DECODED_SYNTAXES = {
    "DICOM RLE": gdcm.TransferSyntax.RLELossless,
    "DICOM JPEG": gdcm.TransferSyntax.JPEGLosslessProcess14_1,
    "DICOM JPEG-LS": gdcm.TransferSyntax.JPEGLSLossless,
    "DICOM JPEG 2000": gdcm.TransferSyntax.JPEG2000Lossless,
}
OUTLINE = {
    "centre_px": [1024.5, 544.5],
    "axes_px": [260.1, 259.9],
    "quality": 0.9,
    "status": "OK",
    "rim_fraction": 1.0,
    "scatter_px": 0.05,
    "blur_px": 1.2,
}
FIGURES = {
    "position_mm": [0.1, 0.2, 0.3],
    "covariance_mm2": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "ray_gap_mm": 0.001,
    "radius_mm": 5.75,
    "left": OUTLINE,
    "right": OUTLINE,
}
SAMPLE = {
    "target": "T1",
    "theatre_time_s": 1.5,
    "mounted_tool": 2,
    "arm_at_rest": True,
    "tip_mm": [1, 2, 3],
    "axis": [0, 0, 1],
}
LEFT = {
    "theatre_time_ns": 5,
    "mounted_tool": 2,
    "arm": {"joints_rad": [0.0] * 6, "flanks": [0.0] * 6, "motion_number": 3, "moved_s": 1.5},
}


def record_parsers(folder: Path) -> dict[str, tuple[tuple[bytes, ...], Take]]:
    """What each takes when all is well, and what takes it; `folder` is theirs."""
    run = folder / "run"
    for name in ("records", "report", "theatre", "readings", "raw"):
        (run / name).mkdir(parents=True)

    def of(name: str, read: Callable[[Path], object], where: Path = run) -> Take:
        return reading((where if where == folder else run) / name, lambda _path: read(where))

    room = ControlledRoom(World.create(draw_scene("mini"), paced=False), None)
    mono = bytes(range(240)) * 5
    body = struct.pack("<3B8f2IBBH", 1, 2, 1, 1.0, 0, 0, 0, 10.0, -20.0, -1500.0, 0.1, 0x31, 300, 0, 0, 0)
    return {
        "run": ((JOURNAL_OF_A_RUN,), of("journal.jsonl", _read_run)),
        "log": (
            (b'{"event":"opened","part":"log","a":{"b":1}}\n',),
            of("log.jsonl", lambda _run: link_counters(read_for_report(folder).log), folder),
        ),
        "tape": ((_tape(run / "readings"),), of("readings/readings.jsonl", _replayed)),
        "truth": (
            (json.dumps(SAMPLE).encode() + b"\n",),
            of("theatre/truth.jsonl", read_samples, run / "theatre"),
        ),
        "left world": (
            (json.dumps(LEFT).encode(),),
            of("theatre/world.json", read_saved_world, run / "theatre"),
        ),
        "kept truth": ((b'{"ct": null, "targets": []}',), of("report/truth.json", load_truth)),
        "calibration figures": ((json.dumps(FIGURES).encode(),), of("result.json", load_figures)),
        "room": (ROOM_REQUESTS, _asked(room)),
        "raw image": ((mono,), _raw_image),
        "conformance BX": ((body[:46],), _conformance),
        **{name: _compressed(folder / name, syntax) for name, syntax in DECODED_SYNTAXES.items()},
        "proposed place": (
            (PLACE,),
            of("place.json", lambda _run: _placed(read_place(run / "place.json").place)),
        ),
        "marker template": (
            (TEMPLATE,),
            of("template.toml", lambda _run: read_marker_template(run / "template.toml")),
        ),
        "raw extent": (
            (b'{"schema":1,"journal_lines":9,"whole":true}\n',),
            of("raw/extent.json", lambda _run: missing_in_raw(run, ())),
        ),
        "ledger": ((LEDGER,), of(study_folder.FILE, _ledger)),
        "recorded readings": (
            (
                json.dumps(
                    {
                        "seed": 1,
                        "readings_mm": {
                            one.name: [[[1, 2, 3], [1, 2, 4], [1, 5, 3], [7, 2, 3]]]
                            for one in frame_readings.CONDITIONS
                        },
                    }
                ).encode(),
            ),
            of(frame_readings.READINGS_FILE, lambda _run: frame_readings.load_or_take_readings(run, 1, 1)),
        ),
    }


def _read_run(run: Path) -> None:
    """As who may write everything: the chain is made anew over what was changed."""
    journal, previous, lines = run / "journal.jsonl", FIRST, []
    for number, line in enumerate(io.BytesIO(journal.read_bytes() if journal.exists() else b"")):
        if not line.startswith(b"{"):
            continue
        with contextlib.suppress(ValueError):
            content = parse_json(line)
            if isinstance(content, dict):
                text = json.dumps({**content, "sequence": number, "previous": previous}).encode() + b"\n"
                previous = hashlib.sha256(text).hexdigest()
                lines.append(text)
    journal.write_bytes(b"".join(lines))
    reading = read_for_report(run)
    ending_of(reading)
    notable_events(reading.run.journal)
    questions(reading.run.journal)
    timeline(reading.run.journal)
    link_counters(reading.log)


def _tape(folder: Path) -> bytes:
    """Of a calibration; one answer of each kind, with the pixels that it refers to."""
    recipe = {"of": "tool tip", "looks": 8, "more": 4, "ball_mm": [700.0, 20.0, 250.0]}
    opening = {"paced": True, "series": "ct", "began": "2026-11-20T12:00:00+00:00"}
    tape = ReadingTape(folder, lambda: 1.5, {**opening, "calibration": {"recipe": recipe, "records": {}}})
    dark, area = np.zeros((30, 40), np.uint16), AreaOfInterest(0, 0, 40, 30)
    image = CameraImage(STAMP, Validity.OK, "left", dark, area)
    tool = ToolReading("frame", Validity.OK, (1.0, 0.0, 0.0, 0.0), (1.0, 2.0, 3.0), 0.1)
    stray = StrayReading((1.0, 2.0, 3.0), Validity.OK)
    tape.begin(1)
    for call, value in (
        ("connect", Identity("Test", "an arm", "1", "0", (("a", "b"),))),
        ("read_state", ArmReading(STAMP, Validity.OK, (0.1,) * 6, None, moving=False)),
        ("read_frame", TrackerFrame(STAMP, Validity.OK, (tool,), (stray,))),
        ("grab_pair", StereoReading(STAMP, Validity.PARTIAL, image, None)),
        ("read_tool_identity", ToolIdentity(STAMP, 2)),
        ("link_statistics", LinkStatistics(1, 0, 0, 0, 1.0, 2.0, (0.0, 1.0), (1,))),
        ("activate", None),
        ("to_confirm", "the payload"),
    ):
        serials = {"serials": ("L", "R"), "notices": ("old",)} if call == "connect" else {}
        tape.keep("robot", call, Lifecycle.ACTIVE, value, properties=serials)
    tape.keep("robot", "resume", Lifecycle.FAULT, None, NotRecorded("it is held", expected="no hold"))
    tape.close()
    return (folder / READINGS_FILE).read_bytes()


def _replayed(run: Path) -> None:
    """As a replay asks: the steps of its recipe, then call after call, whatever it finds damaged."""
    answers = read_answers(run)
    if answers.opening.calibration is not None:
        with contextlib.suppress(RonnaError):
            order_of(Recipe.read(answers.opening.calibration.recipe).steps, ())
    for section, calls in answers._sections.items():
        answers.begin(section)
        for (device, call), waiting in calls.items():
            for _ in range(len(waiting)):
                with contextlib.suppress(NotRecorded):
                    if call in RECORDED_PROPERTIES:
                        answers.look(device, call)
                    elif call in ANSWERS:
                        answers.next(device, call, ANSWERS[call])
    for one in iterate_readings(run):
        one.load()


def _placed(proposal: ProposedPlace) -> None:
    drift = proposal.drift(Transform.of(Frame.ROBOT, Frame.CT, translation_mm=(500.0, 0.0, 480.0)))
    assert math.isfinite(drift.off_mm)
    proposal.allows(drift)


def _ledger(folder: Path) -> None:
    """As who may write everything: the first units have the hash of what they say."""
    file, lines = folder / study_folder.FILE, []
    *first, rest = file.read_bytes().split(b"\n", REHASHED)
    for line in first:
        with contextlib.suppress(ValueError, KeyError, TypeError):
            content = parse_json(line)
            said = json.dumps([content["unit"], content["sums"]], sort_keys=True).encode()
            line = json.dumps({**content, "sha256": hashlib.sha256(said).hexdigest()}).encode()
        lines.append(line)
    file.write_bytes(b"\n".join([*lines, rest]))
    add_up(study_folder.Ledger(folder, STUDY).results())


def _asked(room: ControlledRoom) -> Take:
    """No answer may be an excuse for a mistake of ours."""

    def take(data: bytes) -> None:
        with contextlib.suppress(ValueError):
            request = parse_json(data)
            if isinstance(request, dict):
                answer = room.answer(request)
                assert not str(answer.get("reason")).startswith("the simulator failed"), answer

    return take


def _raw_image(data: bytes) -> None:
    """As a frame gives it: so many bytes as were announced, whatever is in them."""
    for kind in PixelFormat:
        with contextlib.suppress(ValueError):
            decode_pixels(memoryview(data), AreaOfInterest(0, 0, 40, 30), kind)


def _conformance(data: bytes) -> None:
    with contextlib.suppress(Nonconformity):
        read_body(data, 0x0001)


def _compressed(folder: Path, syntax: int) -> tuple[tuple[bytes, ...], Take]:
    """A slice that is decoded in the decoder's own process."""
    where = write_series(folder, np.arange(3 * 6 * 7, dtype=np.int16).reshape(3, 6, 7) - 1000)
    path = where / "0000.dcm"
    header = next(one for one in read_headers(where, lambda _share: None) if one.path == path)
    compress_slice(path, syntax)
    target, decoder = np.empty((6, 7), np.int16), FrameDecoder()
    atexit.register(decoder.close)

    def take(data: bytes) -> object:
        path.write_bytes(data)
        began_s = _spent_s(decoder)
        try:
            return deque(read_pixels(target, header, decoder), maxlen=0)
        finally:
            spent_s = _spent_s(decoder) - began_s
            assert spent_s < LIMIT_S, f"{spent_s:.1f} s of its decoder"

    return (path.read_bytes(),), take


def _spent_s(decoder: FrameDecoder) -> float:
    """Processor time of the decoder's processes: of those that ended, and of the present one."""
    ended = os.times()
    spent_s = ended.children_user + ended.children_system
    if decoder._process is not None:
        used = psutil.Process(decoder._process.pid).cpu_times()
        spent_s += used.user + used.system
    return spent_s

"""Bad inputs to every command, and the bench on which they are tried: files wrong in one way each."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import tomli_w
import typer
from plan_toml import PLAN, VESSEL
from recording_cell import ENDPOINTS

from ronna_hw.command_line.launch import COMMANDS
from ronna_hw.errors import EXIT_USAGE
from sim.theatre.theatre_file import theatre_content
from sim.world.scene.named_scenes import draw_scene


@dataclass(frozen=True)
class BadInput:
    """One command line, and what its one message holds. `{control}` is the control port of a theatre."""

    command: str
    thing: str
    value: str
    expected: str
    advice: str
    exit_code: int = EXIT_USAGE

    @classmethod
    def read(cls, path: Path) -> list[BadInput]:
        """The rows of a table, one per line: the fields with ` | ` between them."""
        rows = (line.split(" | ") for line in path.read_text().splitlines() if line and line[0] != "#")
        return [cls(*row[:5], *map(int, row[5:])) for row in rows]

    @property
    def words(self) -> tuple[str, ...]:
        return (self.thing, self.value, self.expected, self.advice)

    def arguments(self, names: Mapping[str, str]) -> list[str]:
        """Name of the command and its arguments."""
        return [word.format_map(names) for word in shlex.split(self.command)]


@cache
def app_of(name: str) -> typer.Typer:
    """The application of a console script."""
    app: typer.Typer = import_module(COMMANDS[name]).app
    return app


def write_bench(folder: Path) -> None:
    """Every file that a row names."""
    for name, content in _files().items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    (folder / "empty").mkdir()


THEATRE = 'schema = 1\ntheatre = "lab"\n'
TRACKER = '[tracker]\ndriver = "ndi_polaris"\nendpoint = "tcp://127.0.0.1:1"\n'
ROBOT = (
    '[robot.master]\ndriver = "kuka_rsi"\n'
    'endpoints = { rsi = "udp://127.0.0.1:59152", eki = "tcp://127.0.0.1:1" }\n'
)
STEREO = (
    '[stereo]\ndriver = "basler_stereo"\n'
    'endpoints = { left = "gev://127.77.0.1", right = "gev://127.77.0.2" }\n'
)
STEREO_HEAD = """[calibration.stereo_head]
identifier = "head-1"
created = 2026-01-01T00:00:00Z
expires = 2027-01-01T00:00:00Z
made_by = "bench"
stated_error_mm = 0.05
flange_from_tool = { translation_mm = [0.0, 0.0, 300.0], quaternion_wxyz = [1.0, 0.0, 0.0, 0.0] }
[calibration.stereo_head.left]
serial = "1"
focal_px = [0.0113, 0.0113]
principal_point_px = [1023.5, 543.5]
camera_from_tool = { translation_mm = [0.0, 0.0, 250.0], quaternion_wxyz = [1.0, 0.0, 0.0, 0.0] }
"""
HOLDER = """[calibration.assistant_holder]
identifier = "holder-1"
created = 2026-01-01T00:00:00Z
expires = 2027-01-01T00:00:00Z
made_by = "bench"
stated_error_mm = 0.03
stated_direction_error_rad = 0.0003
flange_from_ball_mm = [0.0, 0.0, 160.0]
flange_from_clamp = { translation_mm = [0.0, 0.0, 110.0], quaternion_wxyz = [0.8, 0.0, 0.6, 0.0] }
flange_from_frame = { translation_mm = [-90.0, 90.0, -20.0], quaternion_wxyz = [0.0, 0.8, 0.0, -0.6] }
frame = "assistant_frame"
"""
ROM = "robot_frame.rom"
LAB = tomli_w.dumps(  # with everything that a case needs
    theatre_content(draw_scene("mini"), ENDPOINTS, "host:", {"robot_frame": ROM}, 1.0)
).replace("127.", "172.")
TOOL = 'part_number = "8700000"\nmarkers_mm = [[0.0, 0.0, 0.0], [50.0, 0.0, 0.0], [0.0, 70.0, 0.0]]\n'


def _with_focal_px(scene: dict[str, Any], focal_px: float) -> dict[str, Any]:
    return {**scene, "left": {**scene["left"], "focal_px": [focal_px, focal_px]}}


def _files() -> dict[str, str | bytes]:
    content = draw_scene("mini").model_dump(mode="json", by_alias=True, exclude_none=True)
    scene = tomli_w.dumps(content)
    return {
        "notes.txt": "hello\n",
        "no.toml": "a = = 3\n",
        "results/one/journal.jsonl": "",
        "latin.toml": 'schema = 1\npatient = "M\u00fcller"\n'.encode("latin-1"),
        "binary.toml": b"\xff\xfe\x00",
        "wide.toml": scene.replace("columns = 256", "columns = 100000"),
        "negative.toml": scene.replace("columns = 256", "columns = -1"),
        "metres.toml": scene.replace("radius_mm = 5.75", "radius_mm = 0.00575", 1),
        "large.toml": scene.replace("radius_mm = 5.75", "radius_mm = 575.0", 1),
        "radius.toml": scene.replace("radius_mm = 5.75", "radius = 5.75", 1),
        "focal.toml": tomli_w.dumps(_with_focal_px(content, 0.0113)),
        "untimed.txt": "robot drop 2 %\n",
        "after.txt": "after 3 s: robot drop 2 %\n",
        "step.txt": "when step == regstration: robot drop 2 %\n",
        "typo.txt": "at 3 s: robot dorp 2 %\n",
        "middle.txt": "at 3 s: camera forget middle\n",
        "latin.txt": b"at 0 s: \xff\n",
        "answer.toml": "[answers]\nregistration = 'perhaps'\n",
        "answers.toml": "answer = 'yes'\n",
        "topic.toml": "[answers]\ncalibrate = 'yes'\n",
        "address.toml": THEATRE
        + '[robot.master]\ndriver = "kuka_rsi"\n'
        + 'endpoints = { rsi = "udp://192.168.10.300:59152", eki = "tcp://192.168.10.2:54602" }\n',
        "camera.toml": THEATRE + STEREO.replace("127.77.0.1", "192.168.3.999"),
        "port.toml": THEATRE + TRACKER.replace(":1", ":99999"),
        "com.toml": THEATRE + TRACKER.replace("tcp://127.0.0.1:1", "COM3"),
        "drver.toml": THEATRE + TRACKER.replace("driver", "drver"),
        "trackr.toml": THEATRE + TRACKER.replace("[tracker]", "[trackr]"),
        "noend.toml": THEATRE + '[tracker]\ndriver = "ndi_polaris"\n',
        "procedure.toml": THEATRE + "[procedure]\naproach_mm = 60.0\n",
        "approach.toml": THEATRE + "[procedure]\napproach_mm = 0.06\n",
        "error_metres.toml": THEATRE + "[procedure]\ntool_error_mm = 0.002\n",
        "schema.toml": 'schema = 2\ntheatre = "lab"\n',
        "nothing.toml": "",
        "focal_record.toml": THEATRE + STEREO_HEAD,
        "metres_record.toml": THEATRE + STEREO_HEAD.replace("300.0", "0.3").replace("250.0", "0.25"),
        "holder_centimetres.toml": THEATRE + HOLDER.replace("160.0", "16.0").replace("110.0", "11.0"),
        "holder_reversed.toml": THEATRE + HOLDER.replace("[0.8, 0.0, 0.6, 0.0]", "[0.0, 0.8, 0.0, -0.6]"),
        "tracker.toml": THEATRE + TRACKER,
        "lab.toml": THEATRE + TRACKER.replace("127.0.0.1", "192.168.1.7"),
        "unknown.toml": THEATRE + TRACKER.replace("ndi_polaris", "ndi_polariss"),
        "silence.toml": THEATRE + ROBOT + "[robot.master.options]\nsilence_limits = 0.25\n",
        "speed.toml": THEATRE + ROBOT + "[robot.master.options]\nspeed_fraction = 2.0\n",
        "robot.toml": THEATRE + ROBOT,
        "lab_driver.toml": LAB.replace('"basler_stereo"', '"basler"'),
        "lab_stereo.toml": LAB.replace("left_serial = ", "left_seriall = "),
        "lab_rom.toml": LAB.replace(f'rom = "{ROM}"', f'rom = "{ROM}", sha256 = "{64 * "0"}"'),
        "lab_arm.toml": LAB.replace('variant = "kr6_r900_sixx"', 'variant = "kr6_r900_2"'),
        "patient/ct/readme.txt": "hello\n",
        "patient/plan.toml": PLAN,
        "semicolon.csv": "x;y;z\n1;2;3\n",
        "two.csv": "1,2\n",
        "words.csv": "left,back,top\n",
        "infinite.csv": "1,2,inf\n",
        "empty.csv": "",
        "pairs.json": "[[1, 2]]",
        "object.json": "{}",
        "lps.mrk.json": json.dumps(
            {"markups": [{"coordinateSystem": "XYZ", "controlPoints": [{"position": [1, 2, 3]}]}]}
        ),
        "series/readme.txt": "hello\n",
        "case/plan.toml": PLAN,
        "plan.toml": PLAN,
        "entry.toml": PLAN.replace("entry_mm", "entri_mm"),
        "same.toml": PLAN.replace("[10.0, -50.0, 60.0]", "[5.0, -20.0, 20.0]"),
        "twice.toml": PLAN + PLAN[PLAN.index("[[") :],
        "pronate.toml": PLAN.replace('"HFS"', '"HFX"'),
        "adhesive.toml": PLAN.replace('fiducials = "free"', 'fiducials = "adhesive"'),
        "count.toml": PLAN.replace("implanted = 4", "implanted = 0"),
        "nolength.toml": PLAN.replace("instrument_length_mm = 250.0\n", ""),
        "comma.toml": PLAN.replace("[10.0, -50.0, 60.0]", "[10,5, -50.0, 60.0]"),
        "mistakes.toml": THEATRE
        + 'colour = "green"\n[clock]\nendpoint = "tcp://127.0.0.1:1"\n'
        + TRACKER.replace('"ndi_polaris"', "5"),
        "date.toml": THEATRE + "expires = 21.12.2026\n",
        "margin_metres.toml": PLAN.replace("margin_mm = 1.5", "margin_mm = 0.002"),
        "structure_metres.toml": PLAN + VESSEL.replace("margin_mm = 3.0", "margin_mm = 0.003"),
        "structure_points.toml": PLAN
        + VESSEL.replace("[9.0, -20.0, 20.0]", "[0.009, -0.02, 0.02], [0.01, -0.03, 0.03]"),
        "structure_within.toml": PLAN + VESSEL.replace("margin_mm", "within_mm = 1e300\nmargin_mm"),
        "structure_negative.toml": PLAN + VESSEL.replace("margin_mm = 3.0", "margin_mm = -3.0"),
        "plan_metres.toml": PLAN.replace("[10.0, -50.0, 60.0]", "[0.01, -0.05, 0.06]").replace(
            "[5.0, -20.0, 20.0]", "[0.005, -0.02, 0.02]"
        ),
        "near.toml": PLAN.replace("[10.0, -50.0, 60.0]", "[5.0, -20.0, 20.1]"),
        "length_cm.toml": PLAN.replace("instrument_length_mm = 250.0", "instrument_length_mm = 25.0"),
        "short.toml": PLAN.replace("[10.0, -50.0, 60.0]", "[10.0, -50.0]"),
        "tool.toml": TOOL,
        "tool_two.toml": TOOL.replace(", [0.0, 70.0, 0.0]]", "]"),
        "tool_key.toml": TOOL.replace("part_number", "part_numbr"),
        "tool_same.toml": TOOL.replace("[0.0, 70.0, 0.0]", "[50.0, 0.0, 0.0]"),
        "x.rom": b"NDI",
        "ethernet.xml": "<ROOT/>",
    }

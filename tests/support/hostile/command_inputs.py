"""What commands, console and processes of a theatre are given, with what takes it."""

from __future__ import annotations

import contextlib
import logging
import os
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
from arm_looks import SPHERES_MM, LookingArm
from console_requests import ORIGIN, Console
from good_inputs import FAULTS, ORDERS, Take, reading
from plan_editors import draw, scan
from scipy.spatial.transform import Rotation

from benchmarks.mount.tool_tip_calibration import TipCell
from benchmarks.mount.tracker_frame_calibration import FrameCell
from benchmarks.stereo_head.head_looks import observation_set, true_head
from console.guard import ORDERS_PER_SECOND, RateLimit
from console.planning.draft import Draft
from console.planning.judging import judge
from console.planning.plan_editor import PlanEditor
from console.planning.structure_panel import import_structure
from procedures.calibration.pose_set import plan_calibration_looks
from procedures.cli.calibrating.calibration import compute_calibration
from procedures.planning.marker_sites import propose_template
from procedures.planning.scene_head import read_scene_head
from procedures.runs.calibrations import KINDS
from procedures.runs.fault_script import check_fault_script, list_unreached_faults
from procedures.runs.orders import read_order
from procedures.runs.request import CalibrationProcedure, RunRequest
from procedures.steps.calibration.recipe import Calibrated
from ronna_hw.clock import open_clock
from ronna_hw.command_line.options import LEVELS_VARIABLE, set_log_levels_from_environment
from ronna_hw.command_line.terminal import _restrict_new_files
from ronna_hw.errors import RonnaError
from ronna_hw.host.files import ACCESS_VARIABLE
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World

BALL_MM = (700.0, 20.0, 250.0)
HEAD = b"[head]\ncentre_ct_mm = [1.0, -5.0, 20.0]\nsemi_axes_mm = [75.0, 95.0, 85.5]\nname = 'h'\n"
CROSSING = (b"10,-40,50\n11,-41,49.5\n12,-42,49\n", b"[[10,-40,50],[11.5,-41,49]]")
VARIABLES = (b"debug", b"tracker=debug,engine=warning", b"group", b"ronna-sim=info,=error")


def command_parsers(folder: Path) -> dict[str, tuple[tuple[bytes, ...], Take]]:
    """What each takes when all is well, and what takes it; `folder` is theirs."""
    folder.mkdir()

    return {
        "order": (ORDERS, _orders()),
        "structure": (CROSSING, _structure()),
        "unsaved plan": _unsaved(folder),
        "fault script of a case": ((FAULTS,), reading(folder / "faults.txt", _script)),
        "looks of a calibration": (_looks(), reading(folder / "looks.json", _calibration)),
        "head of a scene": ((HEAD,), reading(folder / "head.toml", _head)),
        "world": _world(folder),
        "variables": (VARIABLES, _variables),
    }


def _orders() -> Take:
    console = Console()
    cookie = console.operator()
    headers = {"cookie": cookie, "origin": ORIGIN}
    session = console.sessions.find(cookie.partition("=")[2])
    assert session is not None

    def take(data: bytes) -> None:
        session.orders = RateLimit(ORDERS_PER_SECOND, 1.0)
        with contextlib.suppress(ValueError):
            read_order(data)
        assert console.request("POST", "/orders", headers=headers, body=data).status in (200, 400, 409, 413)

    return take


def _structure() -> Take:
    geometry = scan().geometry

    def take(data: bytes) -> None:
        for name in ("points.csv", "points.json"):
            with contextlib.suppress(RonnaError):
                import_structure(Draft("HFS", 3), "S1", data, name, geometry)

    return take


def _unsaved(folder: Path) -> tuple[tuple[bytes, ...], Take]:
    volume, plan = scan(), folder / "drawn.toml"
    editor = PlanEditor(volume, plan, None)
    draw(editor)
    editor.change(import_structure(editor.draft, "S1", CROSSING[0], "points.csv", volume.geometry))
    kept = editor.close()
    assert kept is not None

    def take(data: bytes) -> None:
        for aside in folder.glob(f"{kept.name}-*"):
            aside.unlink()
        kept.write_bytes(data)
        editor = PlanEditor(volume, plan, None)
        judge(editor.draft, volume, None, thorough=False)
        editor.change(replace(editor.draft, tool="other"))
        editor.close()

    return (kept.read_bytes(),), take


def _script(path: Path) -> None:
    list(list_unreached_faults(path, ("relocalization:T1",), 12.0))
    check_fault_script(path, ("set_up", "relocalization"))


def _looks() -> tuple[bytes, ...]:
    head = true_head()
    generator, down = np.random.default_rng(1), Rotation.from_quat((1.0, 0.0, 0.0, 0.0))
    seen = [head.observe(look, BALL_MM, generator) for look in plan_calibration_looks(down, BALL_MM, 2)]
    observed = (
        observation_set(head, seen),
        LookingArm.of(3).looks(2, 1, SPHERES_MM),
        FrameCell.of(3, calibrated=True).looks(2, 1),
        TipCell.of(3, calibrated=True).readings(8, 6),
    )
    return tuple(one.model_dump_json(by_alias=True).encode() for one in observed)


def _calibration(path: Path) -> None:
    """As a file of each kind; of few looks nothing is computed."""
    for of in Calibrated:
        kind = KINDS[of]
        with contextlib.suppress(RonnaError):
            compute_calibration(
                kind, RunRequest(procedure=CalibrationProcedure(recipe={}, days=1)), kind.read_looks(path)
            )


def _head(path: Path) -> None:
    propose_template(read_scene_head(path), 4, 5.0)


def _world(folder: Path) -> tuple[tuple[bytes, ...], Take]:
    made = World.create(draw_scene("mini"), paced=False)
    clock, path = folder / "clock", folder / "world"
    time = Path(made._clock_path).read_bytes()
    content = bytearray(Path(made._path).read_bytes())
    at = content.index(made._clock_path.encode())
    content[at : at + 100] = str(clock).encode().ljust(100, b"\0")

    def take(data: bytes) -> None:
        if data.startswith(b"RONNACLK"):
            clock.write_bytes(data)
            opened = open_clock(f"shm://{clock}")
            opened.now_s()
            opened.close()
            return
        clock.write_bytes(time)
        path.write_bytes(data)
        world = World.open(f"shm://{path}")
        try:
            world.arm()
            world.step()
            world.fault_script()
            world.on_stand()
        finally:
            world.clock.close()
            world._memory.close()

    return (bytes(content), time), take


def _variables(data: bytes) -> None:
    """Both have it; loggers are put back. The environment is a copy: the C library keeps every value set."""
    value = os.fsdecode(data.replace(b"\0", b""))
    known = logging.root.manager.loggerDict
    loggers = dict(known)
    levels = [(one, one.level) for one in known.values() if isinstance(one, logging.Logger)]
    try:
        with patch.dict(vars(os), environ={ACCESS_VARIABLE: value, LEVELS_VARIABLE: value}):
            with contextlib.suppress(RonnaError):
                set_log_levels_from_environment()
            with contextlib.suppress(RonnaError), _restrict_new_files():
                pass
    finally:
        known.clear()
        known.update(loggers)
        for one, level in levels:
            one.setLevel(level)

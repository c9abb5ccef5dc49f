"""Hazard 31: a theatre that mixes simulated and real devices is refused before anything moves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from coded_errors import raises
from recording_cell import ENDPOINTS, RecordingCell, mini_theatre
from user_commands import in_this_process

from procedures.cli.procedure import app as ronna_procedure
from ronna_hw.config import TheatreFile, parse_theatre
from ronna_hw.errors import EXIT_REFUSED
from ronna_hw.theatre_kind import MIXED_THEATRE, require_one_kind
from sim.theatre.theatre_file import theatre_content, write_theatre_file
from sim.world.scene.named_scenes import draw_scene

THEATRE_CLOCK, HOST_CLOCK = "shm:///proc/1/fd/3", "host:"
REAL: dict[str, Any] = {
    "polaris": "serial:///dev/ttyUSB0",
    "kuka": {"rsi": "udp://192.168.44.1:59152", "eki_project": "tcp://192.168.44.10:54602"},
    "basler": {"left": "gev://192.168.3.10", "right": "gev://192.168.3.11"},
}
LISTENING_ANYWHERE = {"kuka": {"rsi": "udp://0.0.0.0:59152", "eki_project": "tcp://192.168.44.10:54602"}}


def content(clock: str, **endpoints: Any) -> dict[str, Any]:
    """A theatre file's content; devices that are not named are simulated."""
    return theatre_content(draw_scene("mini", seed=3), {**ENDPOINTS, **endpoints}, clock, {}, 1.0)


def theatre(clock: str, **endpoints: Any) -> TheatreFile:
    return parse_theatre(content(clock, **endpoints))


@pytest.mark.hazard(31)
@pytest.mark.parametrize("clock", [THEATRE_CLOCK, HOST_CLOCK])
@pytest.mark.parametrize("device", sorted(REAL))
def test_a_real_device_among_simulated_ones_is_refused_and_named(clock: str, device: str) -> None:
    with raises(MIXED_THEATRE, match=r"CFG-004.*real: ") as refused:
        require_one_kind(theatre(clock, **{device: REAL[device]}))
    assert refused.value.exit_code == EXIT_REFUSED


@pytest.mark.hazard(31)
def test_a_simulated_device_behind_a_link_or_a_name_is_still_a_simulated_one(tmp_path: Path) -> None:
    link = tmp_path / "ttyTracker"
    link.symlink_to("/dev/pts/0")
    for hidden in ({"polaris": f"serial://{link}"}, {"polaris": "tcp://localhost.:8765"}):
        with raises(MIXED_THEATRE, match=r"simulated: tracker at .*; real: "):
            require_one_kind(theatre(HOST_CLOCK, **REAL | hidden))


@pytest.mark.hazard(31)
@pytest.mark.parametrize(
    ("mixed", "said"),
    [
        (theatre(THEATRE_CLOCK, **REAL), "the clock at shm:"),
        (theatre(HOST_CLOCK).model_copy(update={"banner": ""}), "no banner"),
    ],
    ids=["real devices on a simulated clock", "simulated ones without a banner"],
)
def test_a_theatre_that_is_simulated_in_part_is_refused(mixed: TheatreFile, said: str) -> None:
    with raises(MIXED_THEATRE, match=said):
        require_one_kind(mixed)


@pytest.mark.parametrize(
    "sound",
    [theatre(THEATRE_CLOCK), theatre(HOST_CLOCK, **REAL), theatre(HOST_CLOCK, **REAL | LISTENING_ANYWHERE)],
    ids=["simulated", "real", "real, listening anywhere"],
)
def test_theatres_of_one_kind_pass(sound: TheatreFile) -> None:
    require_one_kind(sound)


@pytest.mark.hazard(31)
def test_a_mixed_theatre_gets_no_workcell(tmp_path: Path) -> None:
    mixed = mini_theatre().model_copy(update={"tracker": theatre(HOST_CLOCK, **REAL).tracker})
    with raises(MIXED_THEATRE):
        RecordingCell(tmp_path, theatre=mixed)


@pytest.mark.hazard(31)
def test_the_command_refuses_a_mixed_theatre_before_it_creates_a_run(tmp_path: Path) -> None:
    write_theatre_file(content(HOST_CLOCK, polaris=REAL["polaris"]), tmp_path / "theatre.toml")
    words = ("run", "--config", tmp_path / "theatre.toml", "--case", tmp_path, "--out", tmp_path / "runs")
    done = in_this_process(ronna_procedure, *words)
    assert done.returncode == EXIT_REFUSED
    assert "CFG-004" in done.stderr
    assert not (tmp_path / "runs").exists()

"""Wrong input is answered by one message: what is wrong, which value, what was expected, what to do.

Without a trace, and without a file left behind. The table is `bad_inputs.txt`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
from bad_inputs import BadInput, app_of, write_bench
from user_commands import in_this_process, one_error

from sim.world.control_port import ControlledRoom, ControlPort
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World
from studies import plugin_trial as trial

BAD_INPUTS = BadInput.read(Path(__file__).with_name("bad_inputs.txt"))
FEWEST = 150
LOADED = ("8700338",)  # into the tracker that runs alone


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with every file that a row names."""
    folder = tmp_path_factory.mktemp("bench")
    write_bench(folder)
    return folder


@pytest.fixture(scope="module")
def names() -> Iterator[Mapping[str, str]]:
    """Control ports: of a theatre, of a tracker and of a robot that run alone."""
    theatre = World.create(draw_scene("mini"), paced=False)
    alone = World.create(draw_scene("bench"), paced=False)
    ports = {
        "control": ControlPort(ControlledRoom(theatre, None)),
        "tracker_alone": ControlPort(ControlledRoom(alone, None, ("tracker", "room"), lambda: LOADED)),
        "robot_alone": ControlPort(ControlledRoom(alone, None, ("robot",))),
    }
    yield {name: port.endpoint for name, port in ports.items()}
    for port in ports.values():
        port.close()


@pytest.mark.parametrize("bad", BAD_INPUTS, ids=lambda bad: bad.command)
def test_a_bad_input_gets_a_message_with_the_value_the_expectation_and_the_action(
    bad: BadInput, bench: Path, names: Mapping[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(bench)
    monkeypatch.delenv("RONNA_CONTROL", raising=False)
    monkeypatch.setattr(trial, "try_in_subprocess", lambda kind, text, _tell: trial.try_plugin(kind, text))
    before = sorted(bench.rglob("*"))
    name, *arguments = bad.arguments(names)
    done = in_this_process(app_of(name), *arguments)
    message = " ".join(one_error(done.stderr))
    assert [word for word in bad.words if word not in message] == [], message
    assert done.returncode == bad.exit_code, message
    assert done.stdout == ""
    assert sorted(bench.rglob("*")) == before


def test_the_table_has_enough_distinct_bad_inputs_with_four_words_each() -> None:
    assert [
        bad.command for bad in BAD_INPUTS if len(bad.words) > len(set(filter(str.strip, bad.words)))
    ] == []
    assert len({bad.command for bad in BAD_INPUTS}) == len(BAD_INPUTS) >= FEWEST

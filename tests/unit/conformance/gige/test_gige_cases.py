"""Each case of the GigE suite finds its mistake, made in one camera of a pair."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
import spoilt_cameras as spoil
from spoilt_cameras import Mistake, Patch, Stand

from conformance.case import CaseOutcome
from conformance.gige.protocol import PROTOCOL
from ronna_hw.wire.gige_vision import Bootstrap, GevStatus, GvcpCommand
from sim.basler.control.bootstrap import XML_ADDRESS
from sim.basler.control.feature_table import address_of
from sim.basler.control.port import Actions
from sim.basler.device import SimulatedCamera

FRAME_LIMIT_S = 0.5  # for an image that a spoilt camera never sends
GOOD_FRAME_LIMIT_S = 30.0
GOOD_SILENCE_S = 0.05  # a good camera is silent when it should be, however short the look
# Seconds of heartbeats and exposures; on a clock of their own in tests/unit/sim_basler.
WAITING = {"G14", "G15", "G33", "G42"}


def _level_not_inverted(camera: SimulatedCamera) -> int:
    return camera.settings.user_output_value


@pytest.fixture
def make_stand(monkeypatch: Patch) -> Iterator[Callable[[], Stand]]:
    monkeypatch.setattr("conformance.gige.stream.FRAME_LIMIT_S", FRAME_LIMIT_S)
    made: list[Stand] = []

    def make() -> Stand:
        made.append(Stand())
        return made[-1]

    yield make
    for stand in made:
        stand.close()


MISTAKES: dict[str, tuple[str, Mistake]] = {
    "any first byte is a command": (
        "G04",
        spoil.member("port.answer", lambda _, true: lambda data, peer: true(data, peer) or bytes(8)),
    ),
    "discovery without content": (
        "G02",
        spoil.handle(GvcpCommand.DISCOVERY, lambda *_: lambda *_: bytes(248)),
    ),
    "discovery for the controller only": (
        "G03",
        spoil.handle(GvcpCommand.DISCOVERY, spoil.denies_while_controlled),
    ),
    "any command succeeds": ("G05", spoil.know_a_further_command),
    "registers in reverse": ("G06", spoil.handle(GvcpCommand.READREG, spoil.in_reverse)),
    "memory in small pieces": ("G07", spoil.handle(GvcpCommand.READMEM, spoil.in_small_pieces)),
    "absent registers read as 0": (
        "G08",
        spoil.member("registers.read_word", spoil.forgiving(GevStatus.INVALID_ADDRESS)),
    ),
    "writes to read-only registers succeed": (
        "G09",
        spoil.member("registers.write_word", spoil.forgiving(GevStatus.WRITE_PROTECT)),
    ),
    "anybody writes": ("G10", spoil.member("privilege.may_write", lambda *_: lambda peer: True)),
    "no index of the failure": ("G11", spoil.handle(GvcpCommand.WRITEREG, spoil.tells_no_index)),
    "control for everybody": ("G12", spoil.member("privilege.request", spoil.gives_way)),
    "exclusive access keeps nobody out": (
        "G13",
        spoil.member("privilege.may_read", lambda *_: lambda peer: True),
    ),
    "commands are no sign of life": (
        "G14",
        spoil.member("port._refreshes_heartbeat", lambda *_: lambda: False),
    ),
    "control for ever": ("G15", spoil.member("privilege.seconds_left", lambda *_: lambda: spoil.LONG_S)),
    "streams without a controller": (
        "G15",
        spoil.member("privilege._released", lambda *_: spoil.does_nothing),
    ),
    "any heartbeat": (
        "G16",
        spoil.register(
            Bootstrap.HEARTBEAT_TIMEOUT_MS, lambda it: it.privilege.heartbeat_ms, spoil.store_heartbeat
        ),
    ),
    "half of the description": (
        "G17",
        spoil.block(Bootstrap.FIRST_URL, lambda url: url.rsplit(b";", 1)[0] + b";1000"),
    ),
    "a described register is missing": ("G17a", spoil.lose_a_register),
    "no lock in the description": (
        "G18",
        spoil.block(XML_ADDRESS, lambda xml: xml.replace(b'Name="TLParamsLocked"', b'Name="TLParamsLockeX"')),
    ),
    "a fixed payload size": ("G19", spoil.register(address_of("PayloadSize"), lambda _: 2048)),
    "any gain": (
        "G20",
        spoil.register(address_of("GainRaw"), lambda it: it.settings.gain_raw, spoil.set_gain),
    ),
    "any width": ("G21", spoil.register(address_of("Width"), lambda it: it.settings.width, spoil.set_width)),
    "nothing is locked": ("G22", spoil.unlocked),
    "two test packets": ("G23", spoil.member("channel.fire_test_packet", spoil.twice)),
    "0.0.0.0 is nobody": ("G24", spoil.no_default_destination),
    "a trigger starts": ("G25", spoil.member("acquisition.software_trigger", spoil.starts_by_itself)),
    "streams after the release": ("G25a", spoil.member("privilege._released", lambda *_: spoil.does_nothing)),
    "short packets": ("G26", spoil.short_packets),
    "blocks from 7": (
        "G27",
        spoil.member("channel.begin", lambda it, _: lambda: setattr(it.channel, "_next_block_id", 7)),
    ),
    "a leader of another area": ("G28", spoil.member("channel._faults", lambda *_: spoil.ShiftedLeader())),
    "stamps that stand still": ("G29", spoil.member("_ticks.stamp", lambda *_: lambda moment_ns: 5)),
    "no latch": ("G30", spoil.member("_ticks.latch", lambda *_: spoil.does_nothing)),
    "nothing is repeated": (
        "G31",
        spoil.member("port._actions", lambda _, true: Actions(spoil.does_nothing, true.act)),
    ),
    "silence about what is gone": ("G32", spoil.member("port._actions", spoil.only_known_blocks)),
    "every image twice": ("G33", spoil.member("channel.send", spoil.twice)),
    "triggers are not counted": ("G33", spoil.register(address_of("OvertriggerCount"), lambda _: 0)),
    "repeated commands act again": ("G34", spoil.member("port._replay.find", lambda *_: spoil.does_nothing)),
    "every action is obeyed": ("G35", spoil.member("port._actions", spoil.obeys_every_action)),
    "two cameras of one number": ("G36", spoil.block(0, spoil.serial_of_the_other)),
    "a rate that is only told": (
        "G37",
        spoil.register(address_of("ResultingFrameRateAbs"), lambda _: 0x42480000),
    ),
    "always 50 images per second": ("G37", spoil.always_fifty),
    "no stop": ("G38", spoil.member("acquisition.stop", lambda *_: spoil.does_nothing)),
    "the inverter does nothing": ("G41", spoil.register(address_of("LineStatus"), _level_not_inverted)),
    "a line that is always low": ("G42", spoil.register(address_of("LineStatus"), lambda _: 0)),
    "user sets load nothing": ("G39", spoil.member("load_user_set", lambda *_: spoil.does_nothing)),
}


@pytest.mark.parametrize(
    "mistake",
    [
        pytest.param(one, marks=() if number % 3 == 0 else pytest.mark.slow)
        for number, one in enumerate(MISTAKES)
    ],
)
def test_each_mistake_is_found_by_its_case(
    make_stand: Callable[[], Stand], monkeypatch: Patch, mistake: str
) -> None:
    number, make_mistake = MISTAKES[mistake]
    stand = make_stand()
    make_mistake(stand.left, monkeypatch)
    result = stand.run(number)
    assert result.outcome is CaseOutcome.FAIL
    assert "no error of the tree" not in result.reason


def test_good_cameras_pass_every_case(make_stand: Callable[[], Stand], monkeypatch: Patch) -> None:
    for module in ("client", "stream"):
        monkeypatch.setattr(f"conformance.gige.{module}.SILENCE_S", GOOD_SILENCE_S)
    stand = make_stand()
    monkeypatch.setattr("conformance.gige.stream.FRAME_LIMIT_S", GOOD_FRAME_LIMIT_S)
    results = [stand.run(case.number) for case in PROTOCOL.cases if case.number not in WAITING]
    assert {
        result.number: result.reason for result in results if result.outcome is not CaseOutcome.PASS
    } == {}


def test_cameras_that_ignore_broadcasts_fail(make_stand: Callable[[], Stand], monkeypatch: Patch) -> None:
    monkeypatch.setattr("sim.basler.server.bind_broadcast", list)
    assert make_stand().run("G01").outcome is CaseOutcome.FAIL


def test_every_gige_case_has_its_mistake() -> None:
    assert {number for number, _ in MISTAKES.values()} | {"G01"} == {case.number for case in PROTOCOL.cases}


def test_a_zipped_description_is_read_too(make_stand: Callable[[], Stand], monkeypatch: Patch) -> None:
    stand = make_stand()
    for camera in (stand.left, stand.right):
        spoil.pack_description(camera, monkeypatch)
    assert [stand.run(number).outcome for number in ("G17", "G18")] == [CaseOutcome.PASS, CaseOutcome.PASS]

"""Which two images form a pair, in theatre time: the load of the host computer has no influence."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from faulty_cameras import AREA, LIMIT_S
from numpy.typing import NDArray

from drivers.basler_stereo import BaslerStereoPair
from drivers.basler_stereo.errors import TriggerMissed
from ronna_hw.clock import open_clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.readings import StereoReading, Validity
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.wire.gige_vision import TICK_FREQUENCY_HZ
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import ArmState, World

# In lock-step two commands one after the other are dated at most 1 ms apart, as on a real network.
SKEW_MS, LARGEST_SKEW_MS = 1.0, 1.5
POWERED_ON_NS = 1_000_000_000


class Theatre:
    """Both cameras in lock-step, and drivers that live by the theatre's clock."""

    def __init__(self, world: World, child: ChildProcess) -> None:
        self.world = world
        self._endpoints = dict(child.ready["endpoints"])
        self._pairs: list[BaslerStereoPair] = []

    def script(self, *phrases: str) -> None:
        """These faults act from now on, and no others."""
        now_s = self.world.clock.now_s()
        self.world.set_fault_script("".join(f"at {now_s:.9f} s: camera {phrase}\n" for phrase in phrases))

    def put_head(self, height_mm: float) -> None:
        """Hold the stereo head still at a height above the table."""
        flange = np.diag([1.0, -1.0, -1.0, 1.0])
        flange[:3, 3] = 400.0, 0.0, height_mm
        self.world.publish_arm(ArmState((0.0,) * 6, flange, motion_number=0, at_rest=True))

    def streaming(self, **options: object) -> BaslerStereoPair:
        config = DeviceConfig(
            driver="basler_stereo",
            endpoints=self._endpoints,
            options={"pair_skew_ms": LARGEST_SKEW_MS, **options},
        )
        pair = BaslerStereoPair("stereo", config, open_clock(self.world.clock_endpoint))
        self._pairs.append(pair)
        pair.connect(LIMIT_S)
        pair.configure(LIMIT_S)
        pair.set_areas(AREA, AREA)
        pair.activate(LIMIT_S)
        return pair

    def close(self) -> None:
        self.script()
        for pair in self._pairs:
            pair.close()
        self._pairs.clear()


@contextmanager
def started(at_ns: int) -> Iterator[Theatre]:
    """A theatre whose cameras were powered on so long ago."""
    world = World.create(draw_scene("bench"), paced=False)
    world.clock.wait_until_ns(at_ns)
    with ChildProcess("ronna-sim basler", command("sim.cli", "basler", "--world", world.endpoint)) as child:
        made = Theatre(world, child)
        yield made
        made.close()


@pytest.fixture(scope="module")
def running_theatre() -> Iterator[Theatre]:
    """For all tests of this file that do not ask for the moment of powering on."""
    with started(POWERED_ON_NS) as made:
        yield made


@pytest.fixture
def theatre(running_theatre: Theatre) -> Iterator[Theatre]:
    """Without faults and under nobody's control."""
    yield running_theatre
    running_theatre.close()


def skew_ms(reading: StereoReading) -> float:
    """How far apart the cameras' own counters say that the two exposures began. Both count from one zero."""
    assert reading.left is not None
    assert reading.right is not None
    return abs(reading.left.stamp.device_clock - reading.right.stamp.device_clock) / TICK_FREQUENCY_HZ * 1e3


@pytest.mark.parametrize("trigger", ["software", "action"])
def test_one_command_to_each_camera_gives_one_simultaneous_pair(theatre: Theatre, trigger: str) -> None:
    pair = theatre.streaming(trigger=trigger)
    begun_ns = theatre.world.clock.now_ns()
    for number in (1, 2, 3):
        reading = pair.grab_pair(LIMIT_S)
        assert reading.validity is Validity.OK
        assert pair.block_ids == (number, number)
        assert skew_ms(reading) <= SKEW_MS
    # exposure and read-out, and no more
    frame_ms = 2.0 + AREA.height * 20.0 / 1088
    taken_ms, rounding_ms = (theatre.world.clock.now_ns() - begun_ns) / 1e6, 1e-4
    assert 3 * frame_ms - rounding_ms <= taken_ms <= 3 * (frame_ms + SKEW_MS) + rounding_ms


def test_one_pulse_on_the_line_gives_one_simultaneous_pair(theatre: Theatre) -> None:
    pair = theatre.streaming(trigger="line1")
    with pytest.raises(TriggerMissed, match=r"GEV-013.*no pulse.*Line1"):
        pair.grab_pair(0.2)  # nobody pulses
    for number in (1, 2):
        pulse = threading.Timer(0.3, theatre.script, ["pulse line"])
        pulse.start()
        reading = pair.grab_pair(LIMIT_S)
        pulse.join()
        assert reading.validity is Validity.OK
        assert pair.block_ids == (number, number)
        assert skew_ms(reading) <= SKEW_MS


@pytest.mark.parametrize(
    "phrase", ["delay answers both 300 ms", "announce answers both 300 ms", "lose answers both 30 %"]
)
def test_late_or_lost_answers_only_delay_and_no_trigger_acts_twice(theatre: Theatre, phrase: str) -> None:
    pair = theatre.streaming()
    theatre.script(phrase)
    for number in (1, 2):
        reading = pair.grab_pair(LIMIT_S)
        assert reading.validity is Validity.OK
        assert pair.block_ids == (number, number)
        assert skew_ms(reading) <= SKEW_MS
        theatre.script()


def test_twelve_bit_pixels_are_identical_packed_and_unpacked(theatre: Theatre) -> None:
    images = {}
    for pixel_format in ("Mono12", "Mono12Packed"):
        pair = theatre.streaming(pixel_format=pixel_format)
        image = pair.grab_pair(LIMIT_S).left
        assert image is not None
        images[pixel_format] = image.pixels  # of trigger 1 of the same scene: the same noise
        pair.close()
    assert images["Mono12"].max() > 255
    assert np.array_equal(images["Mono12"], images["Mono12Packed"])


@pytest.mark.parametrize(("late_ms", "validity"), [(0.3, Validity.OK), (4.0, Validity.UNPAIRED)])
def test_a_side_that_exposes_later_than_allowed_is_unpaired(
    theatre: Theatre, late_ms: float, validity: Validity
) -> None:
    pair = theatre.streaming(trigger="action")
    theatre.script(f"expose late right {late_ms} ms")
    reading = pair.grab_pair(LIMIT_S)  # a second trigger does not help
    assert reading.validity is validity
    assert skew_ms(reading) >= late_ms - SKEW_MS


def test_the_first_pair_is_judged_although_the_counters_start_at_zero() -> None:
    with started(at_ns=0) as theatre:
        pair = theatre.streaming(trigger="action")
        theatre.script("expose late right 4 ms")
        assert pair.grab_pair(LIMIT_S).validity is Validity.UNPAIRED
        theatre.script()
        assert pair.grab_pair(LIMIT_S).validity is Validity.OK


@pytest.mark.parametrize(
    "loss", [("expose late right 4 ms",), ("lose right 60 %", "forget right")], ids=["unpaired", "partial"]
)
def test_a_lost_pair_does_not_change_the_next_pictures(theatre: Theatre, loss: tuple[str, ...]) -> None:
    def pictures(lost: int | None) -> list[NDArray[np.integer]]:
        pair = theatre.streaming(trigger="action")
        found = []
        for look in range(3):
            theatre.put_head(height_mm=600.0 + look)
            if look == lost:
                theatre.script(*loss)
                assert pair.grab_pair(LIMIT_S).validity is not Validity.OK
                theatre.script()
            reading = pair.grab_pair(LIMIT_S)
            assert reading.left is not None
            assert reading.right is not None
            found += [reading.left.pixels, reading.right.pixels]
        pair.close()
        return found

    undisturbed, disturbed = pictures(lost=None), pictures(lost=1)
    assert all(map(np.array_equal, undisturbed, disturbed))

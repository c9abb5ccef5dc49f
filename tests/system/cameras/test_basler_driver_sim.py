"""The stereo driver on the simulated cameras, from the trigger to the sphere in the image."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from faulty_cameras import LIMIT_S, Cameras

from drivers.basler_stereo import BaslerStereoPair
from procedures.relocalization import SphereStatus, measure_sphere
from ronna_hw.devices.readings import AreaOfInterest, Validity

AREA = AreaOfInterest(640, 160, 768, 768)

CLIENT = """
import json, sys, time
from drivers.basler_stereo import BaslerStereoPair
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
config = DeviceConfig(driver="basler_stereo", endpoints=json.loads(sys.argv[1]))
pair = BaslerStereoPair("stereo", config, HostClock())
pair.connect(5.0)
pair.configure(5.0)
print("in control", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def pair(cameras: Cameras) -> BaslerStereoPair:
    device = cameras.new_pair()
    device.connect(LIMIT_S)
    device.configure(LIMIT_S)
    return device


def test_a_sphere_measures_the_same_in_the_full_frame_and_in_an_area(pair):
    pair.activate(5.0)
    full = pair.grab_pair(5.0)
    pair.set_areas(AREA, AREA)
    part = pair.grab_pair(5.0)
    assert (full.validity, part.validity) == (Validity.OK, Validity.OK)
    for whole, cut in ((full.left, part.left), (full.right, part.right)):
        seen = measure_sphere(whole.pixels)
        again = measure_sphere(cut.pixels).with_offset(cut.area.offset_x, cut.area.offset_y)
        assert seen.status is again.status is SphereStatus.OK
        assert again.centre_px == pytest.approx(seen.centre_px, abs=0.05)
        assert again.axes_px == pytest.approx(seen.axes_px, abs=0.05)


def test_a_longer_exposure_is_brighter(pair):
    pair.set_areas(AREA, AREA)
    pair.set_exposure(500.0, 36)
    pair.activate(5.0)
    dim = pair.grab_pair(5.0).left.pixels.mean()
    pair.set_exposure(2000.0, 36)
    assert pair.grab_pair(5.0).left.pixels.mean() > 1.5 * dim


def test_the_exposure_share_refers_to_the_set_exposure_and_a_share_of_one_restores_it(pair):
    pair.set_areas(AREA, AREA)
    pair.set_exposure(500.0, 36)
    pair.activate(5.0)

    def brightness(share):
        pair.scale_exposure(share)
        return pair.grab_pair(5.0).left.pixels.mean()

    dim, bright, again = brightness(1.0), brightness(4.0), brightness(1.0)
    assert bright > 1.5 * dim
    assert again == pytest.approx(dim, rel=0.1)


def test_the_next_client_waits_for_the_cameras_of_a_killed_client(cameras: Cameras) -> None:
    with subprocess.Popen(
        [sys.executable, "-P", "-c", CLIENT, json.dumps(cameras.endpoints)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as client:
        assert client.stdout is not None
        assert client.stdout.readline() == "in control\n"
        client.kill()
    device = cameras.new_pair()
    device.connect(5.0)
    device.configure(10.0)
    device.activate(5.0)
    assert device.grab_pair(5.0).validity is Validity.OK


@pytest.mark.slow
def test_the_whole_conformance_suite_passes_on_the_simulated_cameras(commands):
    result = commands.run("ronna-conformance", "stereo", "--sim", "--json")
    assert result.returncode == 0, result.stderr
    report = json.loads(result.stdout)
    assert report["summary"] == {"pass": len(report["cases"]), "fail": 0, "skip": 0}

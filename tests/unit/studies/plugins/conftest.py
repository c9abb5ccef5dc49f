"""A folder with a module of user methods, good and bad ones of each kind."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

METHODS = '''
import numpy as np
from scipy.spatial.transform import RigidTransform
from procedures.registration.point_registration import register
from procedures.strategies.fixed_orientation import OrientationCorrection

drawn = []

def in_order(image_mm, physical_mm, *, sigma_image_mm, sigma_physical_mm):
    """By a random order of NumPy's global numbers."""
    return [(i, i) for i in np.random.permutation(min(len(image_mm), len(physical_mm)))[:3]]

def two_points(image_mm, physical_mm):
    return []

def not_whole(image_mm, physical_mm, **given):
    return np.zeros((3, 2))

def twice(image_mm, physical_mm, **given):
    return [(0, 1), (0, 2), (1, 3)]

def beyond(image_mm, physical_mm, **given):
    return [(0, 0), (1, 1), (2, 99)]

def uneven(image_mm, physical_mm, **given):
    return [(0, 0), (1,)]

def looks_up(image_mm, physical_mm, **given):
    return {}["nothing"]

def writes(image_mm, physical_mm, **given):
    image_mm -= image_mm.mean(axis=0)

def remembers(image_mm, physical_mm, **given):
    drawn.append(1)
    return [(0, len(drawn) % 2)]

def leaves(image_mm, physical_mm, **given):
    raise SystemExit(3)

def stays(image_mm, physical_mm, *, covariance_mm2):
    return np.eye(4)

def mirror(image_mm, physical_mm, *, covariance_mm2):
    return np.diag([1.0, 1.0, -1.0, 1.0])

def larger(image_mm, physical_mm, *, covariance_mm2):
    return np.diag([1.1, 1.1, 1.1, 1.0])

def only_turn(image_mm, physical_mm, *, covariance_mm2):
    return np.eye(3)

def inverted(image_mm, physical_mm, *, covariance_mm2):
    return register(image_mm, physical_mm).transform.inv()

def in_metres(image_mm, physical_mm, *, covariance_mm2):
    matrix = register(image_mm, physical_mm).transform.as_matrix()
    matrix[:3, 3] /= 1000.0
    return matrix

def lost(image_mm, physical_mm, *, covariance_mm2):
    return np.full((4, 4), np.nan)

def strings(image_mm, physical_mm, *, covariance_mm2):
    return register(image_mm, physical_mm).transform.as_matrix().astype(str).tolist()

def imaginary(image_mm, physical_mm, *, covariance_mm2):
    return register(image_mm, physical_mm).transform.as_matrix() + 1j

def indices(volume):
    return [[500.0, 20.0, 30.0]]

def flat(volume):
    return [1.0, 2.0]

def nothing(volume):
    return None

def words(volume):
    return [["1.0", "2.0", "3.0"]]

class Beside(OrientationCorrection):
    def localization_poses(self, along, fiducials_mm, robot_from_ct, arm):
        return super().localization_poses(along, np.asarray(fiducials_mm) + 5.0, robot_from_ct, arm)

class Once(OrientationCorrection):
    def localized_along(self, trajectories, fiducials_mm, robot_from_ct):
        return trajectories[:1]

class Still(OrientationCorrection):
    def turns_rad(self, along, fiducials_mm, robot_from_ct, arm):
        return []

class Endless(OrientationCorrection):
    def turns_rad(self, along, fiducials_mm, robot_from_ct, arm):
        return [10**400]

class Degrees(OrientationCorrection):
    def turns_rad(self, along, fiducials_mm, robot_from_ct, arm):
        return [0, 90, 180]

class Later(OrientationCorrection):
    def turns_rad(self, along, fiducials_mm, robot_from_ct, arm):
        return (1 / turn for turn in range(3))

class Moody(OrientationCorrection):
    @property
    def controls_approach(self):
        return {}["nothing"]

    @controls_approach.setter
    def controls_approach(self, value):
        pass

class Undecided:
    localizes_per_trajectory = "always"

class Shorter(OrientationCorrection):
    def turns_rad(self, along):
        return [0.0]

number = 3
'''


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The current folder, with the methods in a module."""
    (tmp_path / "mine.py").write_text(METHODS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    sys.modules.pop("mine", None)
    yield tmp_path
    sys.modules.pop("mine", None)

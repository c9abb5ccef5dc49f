"""Trial of a user method on a small problem, to catch errors before a campaign starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import wait
from concurrent.futures.process import BrokenProcessPool

import numpy as np
from scipy.spatial.transform import RigidTransform

from procedures.imaging.volume import Volume, VoxelGeometry
from ronna_hw.arrays import Array
from ronna_hw.host.worker_processes import start_workers
from ronna_hw.near_names import find_near
from studies.accuracy.phantom import Markers, draw_phantom, phantom_pose
from studies.accuracy.postures import plan_postures
from studies.campaign.workers import PROCESS_ENDED, SilenceWatch, Tell
from studies.correspondence.study import StudiedMatching
from studies.errors import MethodAnswerWrong, MethodFailed, MethodRefused
from studies.heads import NoiseReading, draw_pose, draw_readings, sites_mm
from studies.plugins.answers import PluginLocalizer, PluginPairing, PluginRegistration
from studies.plugins.contracts import MethodKind
from studies.plugins.method import PluginMethod, find_plugin, list_installed_plugins
from studies.plugins.strategy import PluginStrategy
from studies.strategies.study import DEPTHS_MM, TARGETS

TRIAL_SEED = 17
PATIENT = 1
FIDUCIALS, OUTLIERS = 4, 1
SIGMA_MM = 0.5
FITTING_MM = 0.1  # on points without error: far above rounding and convergence limits
TRIAL_VOXELS = 60  # along each axis, 1 mm
TRIAL_BALLS = ((0.25, 0.25, 0.3), (0.75, 0.25, 0.4), (0.25, 0.75, 0.5), (0.75, 0.75, 0.7))  # of the edge
BALL_RADIUS_MM = 5.75
BALL_HU, AIR_HU = 100, -1000
NAMES = {
    "clique": StudiedMatching.CLIQUE,
    "orientation": StudiedMatching.PRIOR,
    "count": StudiedMatching.COUNT,
    "thesis": StudiedMatching.THESIS,
    "thesis-validated": StudiedMatching.VALIDATED,
    "gradual": StudiedMatching.GRADUAL,
    "gradual-validated": StudiedMatching.GRADUAL_VALIDATED,
}


def try_in_subprocess(kind: MethodKind, text: str, tell: Tell = lambda text: None) -> PluginMethod:
    """Try a method in a separate process, so that a crash is contained and reported.

    `tell` is called if it does not respond.
    """
    silence = SilenceWatch([text], tell)
    with start_workers(1) as pool:
        try:
            answer = pool.submit(try_plugin, kind, text)
            while not answer.done():
                silence.report_silent(["its trial"])
                wait([answer], silence.limit_s)
            answer.result()
        except BrokenProcessPool as error:
            raise MethodFailed(f"{text} {PROCESS_ENDED}, when it was tried") from error
    return find_plugin(kind, text)


def try_plugin(kind: MethodKind, text: str) -> PluginMethod:
    """Load the method named by `text` and require two equal answers to a trial. Raises STU-012 to STU-014."""
    method = find_plugin(kind, text)
    once, again = (ANSWERS[kind](method) for _ in range(2))
    if once != again:
        raise MethodRefused(
            f"{text} returns different results for the same input",
            expected="the same result every time",
            got="a different one the second time",
            action="Seed its random numbers, and keep no state between calls.",
        )
    return method


def select_methods(
    names: Sequence[str], tell: Tell = lambda text: None
) -> tuple[tuple[StudiedMatching, ...], tuple[PluginMethod, ...]]:
    """Return the built-in and user methods selected by `names`, or all built-in ones if it is empty.

    `tell` is called with the name of a user method that does not respond.
    """
    if not names:
        return tuple(StudiedMatching), ()
    requested = tuple(dict.fromkeys(names))
    unknown = [name for name in requested if name not in NAMES]
    for name in unknown:
        if ":" not in name and name not in (there := list_installed_plugins()):
            known = [*NAMES, *there]
            near = find_near(name, known)
            raise MethodRefused(
                f"--method: there is no method {name!r}",
                expected=f"{', '.join(known)} or module:function",
                action=f"Did you mean {near[0]}? {MethodRefused.action}" if near else None,
            )
    own = tuple(try_in_subprocess(MethodKind.PAIRING, name, tell) for name in unknown)
    return tuple(NAMES[name] for name in requested if name in NAMES), own


def _try_pairing(method: PluginMethod) -> object:
    random = np.random.default_rng(TRIAL_SEED)
    seen = draw_readings(sites_mm(PATIENT), FIDUCIALS, OUTLIERS, NoiseReading.NORM, 1, random)
    found = PluginPairing.of(method)(
        seen.image_mm[0], seen.physical_mm[0], sigma_image_mm=SIGMA_MM, sigma_physical_mm=SIGMA_MM
    )
    return None if found is None else found.tolist()


def _try_registration(method: PluginMethod) -> object:
    image_mm = sites_mm(PATIENT)[:FIDUCIALS]
    physical_mm = draw_pose(np.random.default_rng(TRIAL_SEED)).apply(image_mm)
    covariance_mm2 = np.tile(SIGMA_MM**2 * np.eye(3), (FIDUCIALS, 1, 1))
    fitted = PluginRegistration.of(method)(image_mm, physical_mm, covariance_mm2=covariance_mm2)
    _require_direction(method.name, fitted, image_mm, physical_mm)
    return fitted.as_matrix().tolist()


def _require_direction(name: str, fitted: RigidTransform, image_mm: Array, physical_mm: Array) -> None:
    """Raise STU-014 if only the inverse of the answer, or a conversion from metres, fits the points.

    One that fits in neither direction is a bad method, which the campaign measures.
    """
    metres = RigidTransform.from_components(1e3 * fitted.translation, fitted.rotation)
    if _fits(fitted, image_mm, physical_mm):
        return
    for sense, other in (
        ("its inverse fits: image <- physical", fitted.inv()),
        ("it fits with the translation × 1000: metres", metres),
        ("its inverse fits with the translation × 1000: metres", metres.inv()),
    ):
        if _fits(other, image_mm, physical_mm):
            raise MethodAnswerWrong(
                f"{name} does not fit the points of its trial, which have no error",
                expected="physical <- image, mm",
                got=sense,
            )


def _fits(transform: RigidTransform, image_mm: Array, physical_mm: Array) -> bool:
    return float(np.linalg.norm(transform.apply(image_mm) - physical_mm, axis=1).max()) < FITTING_MM


def _try_localizer(method: PluginMethod) -> object:
    shape, centres = (TRIAL_VOXELS,) * 3, TRIAL_VOXELS * np.array(TRIAL_BALLS)
    places = np.moveaxis(np.indices(shape), 0, -1)
    away = np.min([np.linalg.norm(places - centre, axis=-1) for centre in centres], axis=0)
    filled = np.clip(BALL_RADIUS_MM - away + 0.5, 0.0, 1.0)  # of a 1 mm voxel
    voxels = np.rint(AIR_HU + filled * (BALL_HU - AIR_HU)).astype(np.int16)
    voxels.setflags(write=False)
    geometry = VoxelGeometry(shape, np.full(3, -0.5 * TRIAL_VOXELS), np.eye(3)[:, ::-1], np.ones(3))
    return PluginLocalizer.of(method)(Volume(voxels, geometry, "1.2.3", "1.2.4")).tolist()


def _try_strategy(method: PluginMethod) -> object:
    """Plan postures for the free markers of the accuracy studies at the first position."""
    strategy = PluginStrategy.of(method)
    planned = plan_postures(strategy, draw_phantom(Markers.FREE, DEPTHS_MM, TARGETS), phantom_pose(1))
    return planned.localizations.joints_rad.tolist()


ANSWERS: dict[MethodKind, Callable[[PluginMethod], object]] = {
    MethodKind.LOCALIZER: _try_localizer,
    MethodKind.PAIRING: _try_pairing,
    MethodKind.REGISTRATION: _try_registration,
    MethodKind.STRATEGY: _try_strategy,
}

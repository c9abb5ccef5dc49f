"""Rigid registration of another series to a CT by mutual information, coarse to fine, from several starts.

Mattes mutual information (Mattes and others 2003, PET-CT image registration in the chest using free-form
deformations) in SimpleITK, in one thread, with a fixed seed: equal series give equal results.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.fusion.errors import FUSION_MISSING, NothingToFuse
from procedures.imaging.pose_starts import list_turned_starts
from procedures.imaging.volume import Volume, VoxelGeometry
from ronna_hw.arrays import Array, Mask

if TYPE_CHECKING:
    import SimpleITK

SOFT_HU, COMPACT_HU = -200.0, 1200.0  # below: air; above: compact bone or metal
SKIN_HU = -150.0  # fat is about -100; clipped air is below
BRIGHT_SHARE = 99.5  # percentile of the other series above which its values are cut
COARSE_MM, MIDDLE_MM, FINE_MM = 6.0, 3.0, 1.2  # spacing of the levels; the blur is half of it
THIN_MM = 12.0  # what is thinner is not the head: holders, cables, spheres on their posts
AROUND_MM = 5.0  # beyond the skin: its edge counts
LEAST_VOXELS = 1500  # at 6 mm: 0.3 litres, a quarter of a small head
BINS = 50
SEED = 1
START_TURN_RAD = float(np.radians(20.0))  # tried either way about each axis
FIRST_STEP_MM = {COARSE_MM: 4.0, MIDDLE_MM: 1.0, FINE_MM: 0.5}
LAST_STEP_MM = {COARSE_MM: 0.3, MIDDLE_MM: 0.05, FINE_MM: 0.02}
MOST_ROUNDS, MOST_LINE_STEPS = 20, 15
STILL_NATS = 1e-5
MOST_SAMPLES = 20_000  # of the CT's voxels: more moves a result by less than its error
SHADING_MM, SHADING_ROUNDS = 5.0, (30, 20)
INT16 = (-32768, 32767)
CUT_AROUND_MM = 10.0


@dataclass(frozen=True, eq=False)
class Level:
    """CT and other series at one resolution, and the head's voxels in the CT."""

    spacing_mm: float
    ct: SimpleITK.Image
    other: SimpleITK.Image
    head: Mask
    geometry: VoxelGeometry  # of the CT's level


@dataclass(frozen=True, eq=False)
class Optimum:
    """Pose other <- CT found from one start, and its mutual information in nats."""

    other_from_ct: RigidTransform
    information: float


def build_level(ct: Volume, other: Volume, spacing_mm: float) -> Level:
    """Blur and thin both series to about this spacing, cut to the head. Raises FUS-001, FUS-002."""
    values, geometry = _thin(np.clip(ct.voxels, SOFT_HU, COMPACT_HU), ct.geometry, spacing_mm)
    head = _find_head(values > SKIN_HU, geometry)
    (values, head), geometry = _cut((values, head), geometry, head)
    brightest = float(np.percentile(other.voxels[::2, ::4, ::4], BRIGHT_SHARE))
    others, other_geometry = _thin(np.minimum(other.voxels, brightest), other.geometry, spacing_mm)
    (others,), other_geometry = _cut((others,), other_geometry, _find_bright(others))
    return Level(spacing_mm, _as_image(values, geometry), _as_image(others, other_geometry), head, geometry)


def search_starts(level: Level) -> tuple[Optimum, ...]:
    """Register from several turns about the middle of both heads; the best optimum is first."""
    middle = level.geometry.to_patient_mm(np.argwhere(level.head)).mean(axis=0)
    there = _find_middle(level.other)
    found = [_try_start(level, start) for start in list_turned_starts(middle, there, START_TURN_RAD)]
    return tuple(sorted(found, key=lambda one: -one.information))


def _try_start(level: Level, start: RigidTransform) -> Optimum:
    """Register from a start; one from which both heads hardly overlap tells nothing."""
    try:
        return refine_pose(level, start, level.head)
    except NothingToFuse:
        return Optimum(start, 0.0)


def refine_pose(level: Level, start: RigidTransform, within: Mask) -> Optimum:
    """Refine a pose other <- CT by the voxels of the CT that are marked `within`, or some of them.

    Raises FUS-002 where the series hardly overlap.
    """
    sitk = require_simple_itk()
    index = np.argwhere(within)
    middle = level.geometry.to_patient_mm(index).mean(axis=0)
    transform = sitk.Euler3DTransform()
    transform.SetCenter(middle.tolist())
    transform.SetMatrix(start.rotation.as_matrix().ravel().tolist())
    transform.SetTranslation((start.apply(middle) - middle).tolist())
    method = sitk.ImageRegistrationMethod()
    method.SetNumberOfThreads(1)  # sums in another order would give another result
    method.SetMetricAsMattesMutualInformation(BINS)
    method.SetMetricFixedMask(_as_image(within.astype(np.uint8), level.geometry))
    if len(index) > MOST_SAMPLES:
        method.SetMetricSamplingStrategy(method.REGULAR)
        method.SetMetricSamplingPercentage(MOST_SAMPLES / len(index), SEED)
    method.SetMetricUseFixedImageGradientFilter(False)  # Powell's method needs no gradients
    method.SetMetricUseMovingImageGradientFilter(False)
    method.SetInterpolator(sitk.sitkLinear)
    # By line searches: the gradient of ITK's metric ends a descent early where rotation is weakly determined.
    method.SetOptimizerAsPowell(
        numberOfIterations=MOST_ROUNDS,
        maximumLineIterations=MOST_LINE_STEPS,
        stepLength=FIRST_STEP_MM[level.spacing_mm],
        stepTolerance=LAST_STEP_MM[level.spacing_mm],
        valueTolerance=STILL_NATS,
    )
    method.SetOptimizerScalesFromPhysicalShift()
    method.SetInitialTransform(transform, inPlace=True)
    try:
        method.Execute(level.ct, level.other)
    except RuntimeError as error:  # of ITK: too few samples fall into the other series
        raise NothingToFuse("the two series hardly overlap") from error
    rotation = Rotation.from_matrix(np.array(transform.GetMatrix()).reshape(3, 3))
    shift = np.array(transform.TransformPoint((0.0, 0.0, 0.0)))
    return Optimum(RigidTransform.from_components(shift, rotation), -float(method.GetMetricValue()))


def flatten_shading(other: Volume) -> Volume:
    """Return the series without the slow shading of a coil, by N4 (Tustison and others 2010).

    Raises FUS-002 for a blank series.
    """
    sitk = require_simple_itk()
    if other.voxels.min() == other.voxels.max():
        raise NothingToFuse("the other series is blank", got=f"{other.voxels.max()} everywhere")
    values, geometry = _thin(other.voxels, other.geometry, SHADING_MM)
    coarse = _as_image(values - min(0.0, float(values.min())) + 1.0, geometry)
    correction = sitk.N4BiasFieldCorrectionImageFilter()
    correction.SetNumberOfThreads(1)
    correction.SetMaximumNumberOfIterations(SHADING_ROUNDS)
    correction.Execute(coarse, sitk.OtsuThreshold(coarse, 0, 1))
    field = sitk.GetArrayFromImage(correction.GetLogBiasFieldAsImage(coarse))
    ratio = other.geometry.spacing_mm / geometry.spacing_mm
    slices, rows, columns = (np.arange(n) * step for n, step in zip(other.voxels.shape, ratio, strict=True))
    flat = np.empty_like(other.voxels)
    for number, place in enumerate(slices):  # slice by slice: a whole volume of floats would be large
        at = np.broadcast_arrays(np.full((1, 1), place), rows[:, None], columns)
        gain = np.exp(-ndimage.map_coordinates(field, at, order=1, mode="nearest"))
        flat[number] = np.clip(other.voxels[number] * gain, *INT16)
    return replace(other, voxels=flat)


def require_simple_itk() -> Any:
    """Import SimpleITK. Raises FUS-001 if it is not installed."""
    try:
        import SimpleITK as sitk  # noqa: N813 - as its own documentation
    except ImportError:
        raise FUSION_MISSING("the fusion of two series needs SimpleITK") from None
    return sitk


def _thin(
    values: NDArray[Any], geometry: VoxelGeometry, spacing_mm: float
) -> tuple[NDArray[np.float32], VoxelGeometry]:
    """Blur by half the spacing and subsample to about this spacing."""
    thinned = values.astype(np.float32)
    strides = np.maximum(1, np.rint(spacing_mm / geometry.spacing_mm)).astype(int)
    for axis, (stride, voxel_mm) in enumerate(zip(strides, geometry.spacing_mm, strict=True)):
        if stride > 1:  # one axis at a time, subsampled at once: less to blur
            thinned = ndimage.gaussian_filter1d(thinned, 0.5 * spacing_mm / voxel_mm, axis=axis)
            thinned = thinned[(slice(None),) * axis + (slice(None, None, int(stride)),)]
    spaced = VoxelGeometry(thinned.shape, geometry.origin_mm, geometry.axes, geometry.spacing_mm * strides)
    return thinned, spaced


def _find_head(solid: Mask, geometry: VoxelGeometry) -> Mask:
    """Mark the head with what surrounds it closely. Raises FUS-002."""
    mean_mm = float(geometry.spacing_mm.mean())
    rounds = max(1, round(THIN_MM / 2.0 / mean_mm))
    solid = ndimage.binary_fill_holes(solid)
    kept = ndimage.binary_erosion(solid, iterations=rounds, border_value=1)
    labels, count = ndimage.label(kept)
    sizes = np.bincount(labels.ravel())[1:] if count else np.zeros(1, dtype=int)
    if sizes.max() * (mean_mm / COARSE_MM) ** 3 < LEAST_VOXELS / 2:
        raise NothingToFuse("the CT shows nothing of the size of a head", got=f"{sizes.max()} solid cells")
    largest = labels == 1 + int(sizes.argmax())
    more = rounds + max(1, round(AROUND_MM / mean_mm))
    return np.asarray(ndimage.binary_dilation(largest, iterations=more))


def _find_middle(image: SimpleITK.Image) -> Array:
    """Return the centroid (3,) mm of what is brighter than the background of the other series."""
    bright = _find_bright(require_simple_itk().GetArrayViewFromImage(image))
    index = np.argwhere(bright).mean(axis=0)[::-1]
    return np.array(image.TransformContinuousIndexToPhysicalPoint(index.tolist()))


def _find_bright(values: NDArray[Any]) -> Mask:
    """Mark what is brighter than half the mean of the brighter part: the head, not its noise."""
    bright = values > 0.5 * values[values > values.mean()].mean()
    return np.asarray(ndimage.binary_opening(bright))  # noise and threads are thinner


def _cut(
    volumes: tuple[NDArray[Any], ...], geometry: VoxelGeometry, around: Mask
) -> tuple[tuple[NDArray[Any], ...], VoxelGeometry]:
    """Cut volumes to the box around a mask, with a margin. Raises FUS-002 for an empty mask."""
    if not around.any():
        raise NothingToFuse("the other series shows nothing of the size of a head")
    margin = np.ceil(CUT_AROUND_MM / geometry.spacing_mm).astype(int)
    index = np.argwhere(around)
    low = np.maximum(index.min(axis=0) - margin, 0)
    high = np.minimum(index.max(axis=0) + margin + 1, geometry.shape)
    box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    kept = tuple(np.ascontiguousarray(one[box]) for one in volumes)
    return kept, replace(geometry, shape=kept[0].shape, origin_mm=geometry.to_patient_mm(low))


def _as_image(values: NDArray[Any], geometry: VoxelGeometry) -> SimpleITK.Image:
    sitk = require_simple_itk()
    image = sitk.GetImageFromArray(values)
    image.SetSpacing(geometry.spacing_mm[::-1].tolist())
    image.SetOrigin(geometry.origin_mm.tolist())
    image.SetDirection(geometry.axes[:, ::-1].ravel().tolist())
    return image

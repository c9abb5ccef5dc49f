"""Small CTs for the tests: painted from shapes at a finer grid, blurred, averaged into voxels, made noisy.

Nothing here uses the code under test: geometry is written out by hand, so that a shared mistake cannot
hide. Shapes live in scanner millimetres along (slice, row, column); an orientation places them in LPS.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import UID, CTImageStorage, ExplicitVRLittleEndian
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from ronna_hw.arrays import Array

AIR_HU = -1000.0
POLYMER_HU = 150.0
FILM_HU = 600.0
METAL_HU = 3000.0
SKIN_HU = 40.0
RADIUS_MM = 5.75
PLANE_BLUR_MM = 0.42
SLICE_BLUR_MM = 0.35
FINER = (5, 3, 3)  # sub-samples per voxel along slice, row, column

SERIES_UID = "1.2.826.0.1.3680043.8.498.1"
FRAME_UID = "1.2.826.0.1.3680043.8.498.2"


Inside = Callable[[Array, Array, Array], Array]  # signed depth in mm at (z, y, x)


@dataclass(frozen=True)
class Shape:
    """Something of one intensity; later shapes cover earlier ones. `box` is two corners around it, if any."""

    hu: float
    inside: Inside
    box: tuple[Array, Array] | None = None


@dataclass
class Scan:
    """A scan to paint on; `voxels()` gives int16 HU with the noise of the seed.

    Shapes are sharp where they are drawn and blurred once, all together. Around every ball this is done on
    a finer grid, elsewhere on the voxels.
    """

    shape: tuple[int, int, int] = (40, 80, 80)
    spacing_mm: tuple[float, float, float] = (1.0, 0.5, 0.5)
    noise_hu: float = 20.0
    seed: int = 1
    shapes: list[Shape] = field(default_factory=list)
    focus: list[tuple[Array, float]] = field(default_factory=list)
    streak_sources: list[tuple[Array, float, float]] = field(default_factory=list)

    def render(self, start: Array, stop: Array, finer: tuple[int, int, int]) -> Array:
        """Noise-free HU of the voxels from `start` to `stop`, blurred by the scanner."""
        spacing = np.asarray(self.spacing_mm)
        margin = np.ceil(2.0 / spacing).astype(int)  # blur reaches in from outside the piece
        fine_mm = spacing / finer
        axes = []
        for axis in range(3):
            count = int(stop[axis] - start[axis] + 2 * margin[axis]) * finer[axis]
            first = (start[axis] - margin[axis] - 0.5) * spacing[axis] + 0.5 * fine_mm[axis]
            axes.append(first + fine_mm[axis] * np.arange(count))
        image = np.full([len(axis) for axis in axes], AIR_HU, dtype=np.float32)
        for shape in self.shapes:
            patch = tuple(slice(None) for _ in axes)
            if shape.box is not None:  # beyond it nothing is covered, at an edge as wide as a sub-sample
                edge_mm = 2.0 * fine_mm.mean()
                corners = zip(axes, shape.box[0] - edge_mm, shape.box[1] + edge_mm, strict=True)
                patch = tuple(slice(*np.searchsorted(axis, (low, high))) for axis, low, high in corners)
            z, y, x = (axis[part] for axis, part in zip(axes, patch, strict=True))
            depth_mm = shape.inside(z[:, None, None], y[None, :, None], x[None, None, :])
            cover = np.clip(depth_mm / fine_mm.mean() + 0.5, 0.0, 1.0).astype(np.float32)
            image[patch] += (np.float32(shape.hu) - image[patch]) * cover
        blurs = np.array([SLICE_BLUR_MM, PLANE_BLUR_MM, PLANE_BLUR_MM]) / fine_mm
        for size, factor, left_out, sigma in zip(image.shape, finer, margin.tolist(), blurs, strict=True):
            seen = _blurred_and_averaged(size, factor, left_out, float(sigma))
            image = np.tensordot(image, seen, axes=(0, 1))  # its result becomes the last axis
        return image.astype(float)

    def clean(self) -> Array:
        """Noise-free HU of the whole scan."""
        size = np.asarray(self.shape)
        image = self.render(np.zeros(3, dtype=int), size, (1, 1, 1))
        for centre_mm, reach_mm in self.focus:
            start = np.clip(np.floor((centre_mm - reach_mm) / self.spacing_mm).astype(int), 0, size)
            stop = np.clip(np.ceil((centre_mm + reach_mm) / self.spacing_mm).astype(int) + 1, 0, size)
            if (stop > start).all():
                patch = tuple(slice(a, b) for a, b in zip(start, stop, strict=True))
                image[patch] = self.render(start, stop, FINER)
        return image

    def ball(self, centre_mm: Array, radius_mm: float = RADIUS_MM, hu: float = POLYMER_HU) -> None:
        """A plain ball."""
        c = np.asarray(centre_mm, dtype=float)
        self.focus.append((c, radius_mm + 3.5))

        def inside(z: Array, y: Array, x: Array) -> Array:
            return np.asarray(radius_mm - np.sqrt((z - c[0]) ** 2 + (y - c[1]) ** 2 + (x - c[2]) ** 2))

        self.shapes.append(Shape(hu, inside, (c - radius_mm, c + radius_mm)))

    def rod(self, start_mm: Array, along: Array, length_mm: float, radius_mm: float, hu: float) -> None:
        """A cylinder with flat ends."""
        a, d = np.asarray(start_mm, dtype=float), np.asarray(along, dtype=float)
        d = d / np.linalg.norm(d)

        def inside(z: Array, y: Array, x: Array) -> Array:
            dz, dy, dx = z - a[0], y - a[1], x - a[2]
            height = dz * d[0] + dy * d[1] + dx * d[2]
            across = np.sqrt(np.maximum(dz**2 + dy**2 + dx**2 - height**2, 0.0))
            inward: Array = np.minimum(radius_mm - across, np.minimum(height, length_mm - height))
            return inward

        end = a + length_mm * d
        self.shapes.append(
            Shape(hu, inside, (np.minimum(a, end) - radius_mm, np.maximum(a, end) + radius_mm))
        )

    def half_space(self, point_mm: Array, outward: Array, hu: float) -> None:
        """Everything behind a plane, within the scan."""
        p, n = np.asarray(point_mm, dtype=float), np.asarray(outward, dtype=float)
        n = n / np.linalg.norm(n)
        self.shapes.append(
            Shape(hu, lambda z, y, x: -((z - p[0]) * n[0] + (y - p[1]) * n[1] + (x - p[2]) * n[2]))
        )

    def marker(self, centre_mm: Array, post_along: Array, *, skin: bool = True) -> None:
        """A ball with bright film on a metal post that enters it, a flange, and skin behind."""
        c, d = np.asarray(centre_mm, dtype=float), np.asarray(post_along, dtype=float)
        d = d / np.linalg.norm(d)
        if skin:
            self.half_space(c + (RADIUS_MM + 10.0) * d, -d, SKIN_HU)
        self.ball(c, RADIUS_MM + 0.1, FILM_HU)
        self.ball(c)
        self.focus.pop()  # the same place as the film
        self.rod(c + (RADIUS_MM - 1.5) * d, d, 9.5, 2.0, METAL_HU)
        self.rod(c + (RADIUS_MM + 4.0) * d, d, 1.5, 4.0, METAL_HU)

    def streaks(self, centre_mm: Array, amplitude_hu: float = 250.0, phase_rad: float = 0.0) -> None:
        """Dark and bright lobes around a piece of metal, in the slices that hold it, fading as 1/r."""
        self.streak_sources.append((np.asarray(centre_mm, dtype=float), amplitude_hu, phase_rad))

    def voxels(self) -> NDArray[np.int16]:
        """The noisy image; noise is correlated within a slice, as a reconstruction makes it."""
        image = self.clean()
        z, y, x = (np.arange(n) * s for n, s in zip(self.shape, self.spacing_mm, strict=True))
        for centre, amplitude_hu, phase_rad in self.streak_sources:
            dy, dx = y[:, None] - centre[1], x[None, :] - centre[2]
            r = np.maximum(np.hypot(dy, dx), 2.0)
            lobes = amplitude_hu * np.cos(2 * np.arctan2(dy, dx) + phase_rad) * 2.0 / r
            image += np.exp(-(((z - centre[0]) / 3.0) ** 2))[:, None, None] * lobes
        white = np.random.default_rng(self.seed).standard_normal(self.shape)
        noise = gaussian_filter(white, (0, 0.35 / self.spacing_mm[1], 0.35 / self.spacing_mm[2]), mode="wrap")
        image += noise * (self.noise_hu / noise.std())
        return np.clip(np.rint(image), -1024, 3071).astype(np.int16)


@cache
def _blurred_and_averaged(size: int, factor: int, left_out: int, sigma: float) -> NDArray[np.float32]:
    """Matrix (voxels, samples) along one axis; both ends without `left_out` voxels."""
    blurred = gaussian_filter1d(np.eye(size), sigma, axis=0, mode="nearest", truncate=4.0)
    averaged = blurred.reshape(size // factor, factor, size).mean(axis=1)
    whole: NDArray[np.float32] = averaged[left_out : len(averaged) - left_out].astype(np.float32)
    return whole


SeriesEdit = Callable[[Dataset, int], None]


def write_series(
    folder: Path,
    voxels: NDArray[np.int16],
    spacing_mm: tuple[float, float, float] = (1.0, 0.5, 0.5),
    *,
    row_direction: tuple[float, ...] = (1.0, 0.0, 0.0),
    column_direction: tuple[float, ...] = (0.0, 1.0, 0.0),
    origin_mm: tuple[float, ...] = (-20.0, -30.0, 40.0),
    reverse: bool = False,
    edit: SeriesEdit | None = None,
) -> Path:
    """Write (slices, rows, columns) HU as CT slices; `edit` may spoil each data set before it is saved."""
    folder.mkdir(parents=True, exist_ok=True)
    normal = np.cross(row_direction, column_direction)
    for number, plane in enumerate(voxels):
        data = Dataset()
        data.file_meta, data.preamble = FileMetaDataset(), b"\0" * 128
        data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        data.file_meta.MediaStorageSOPClassUID = CTImageStorage
        data.SOPClassUID = CTImageStorage
        instance_uid = UID(f"{SERIES_UID}.{number + 1}")
        data.SOPInstanceUID = data.file_meta.MediaStorageSOPInstanceUID = instance_uid
        data.SeriesInstanceUID = SERIES_UID
        data.StudyInstanceUID = f"{SERIES_UID}.0"
        data.FrameOfReferenceUID = FRAME_UID
        data.Modality = "CT"
        data.PatientName = "Secret^Name"
        data.PatientID = "SECRET-ID"
        data.PatientPosition = "HFS"
        data.ConvolutionKernel = "STANDARD"
        data.InstanceNumber = len(voxels) - number if reverse else number + 1
        position = np.asarray(origin_mm) + number * spacing_mm[0] * normal
        data.ImagePositionPatient = [f"{value:.6f}" for value in position]
        data.ImageOrientationPatient = [f"{value:.10f}" for value in (*row_direction, *column_direction)]
        data.PixelSpacing = [str(spacing_mm[1]), str(spacing_mm[2])]
        data.SliceThickness = str(spacing_mm[0])
        data.RescaleSlope, data.RescaleIntercept = "1", "-1024"
        data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
        data.Rows, data.Columns = plane.shape
        data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelRepresentation = 16, 16, 15, 1
        data.PixelData = (plane.astype(np.int32) + 1024).astype("<i2").tobytes()
        if edit is not None:
            edit(data, number)
        name = len(voxels) - number if reverse else number
        data.save_as(folder / f"{name:04d}.dcm", enforce_file_format=True)
    return folder


def compress_slice(path: Path, syntax: int) -> None:
    """Store the slice in another transfer syntax of gdcm's."""
    import gdcm  # few tests need it

    reader, change, writer = gdcm.ImageReader(), gdcm.ImageChangeTransferSyntax(), gdcm.ImageWriter()
    reader.SetFileName(str(path))
    assert reader.Read()
    change.SetTransferSyntax(gdcm.TransferSyntax(syntax))
    change.SetInput(reader.GetImage())
    assert change.Change()
    for setting, value in (
        (writer.SetFileName, str(path)),
        (writer.SetFile, reader.GetFile()),
        (writer.SetImage, change.GetOutput()),
    ):
        setting(value)
    assert writer.Write()

"""Views of a laser line on skin by the path tracer Mitsuba, for `benchmarks.stereo_head.traced_lines`.

    python line_tracer.py FOLDER [--views 12] [--first 0] [--rows 544] [--columns 400] [--samples 48]
                          [--deep-samples 0]

Runs in an environment of its own with `mitsuba` and `numpy`, as `path_tracer.py` does. Writes one file per
view: for both cameras the light of the lamps of the room, of the line on the surface (principled BSDF with
mottled colour), and with `--deep-samples` of the line scattered inside, besides what is true: the line in
each image and on the surface, and the poses of the cameras.

The skin is a ball, or a ridge like a nose or brow, so that all truth is exact. Light inside is scattered in a
homogeneous medium with the reduced scattering and absorption of skin at 850 nm, without a step of the
refractive index: Mitsuba cannot reach a projector through one. Refraction would make what lies below the
surface appear less deep, so the shift by light from inside is an upper limit.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import mitsuba as mi  # type: ignore[import-not-found]  # only in the environment that renders
import numpy as np

mi.set_variant("llvm_ad_rgb")

FOCAL_PX, SENSOR_PX = 62.5e3 / 5.5, (2048, 1088)
HALF_ANGLE_RAD, DISTANCE_MM, APERTURE_MM = np.radians(27.5), 250.0, 3.125
DIFFRACTION_PX = 0.65
PROJECTOR_MM = 200.0  # from the tool centre point
FAN_DEG, LINE_TEXELS = 4.0, (1024, 2048)  # across and along
LINE_SIGMA_MM = 0.1  # at the tool centre point
LONG_RADIUS_MM, SHORT_RADIUS_MM = (70.0, 110.0), (12.0, 30.0)  # of balls, and of every third view's ridge
LARGEST_TILT_DEG, LARGEST_HEIGHT_MM = 35.0, 4.0  # of the skin at the tool centre point
MOTTLE, TEXELS, TEXTURE_MM = 0.10, 1024, 60.0  # relative, over all sizes from 0.12 to 15 mm
SCATTERING_PER_MM, ABSORPTION_PER_MM = 1.0, 0.03  # reduced, at 850 nm: 0.8 to 1.5 and 0.02 to 0.05
SCATTERED_TIMES = 96
LONGEST_RIDGE_MM = 150.0  # to either side
TRUE_STEPS = 4001


def turned_towards(direction: np.ndarray, x_axis: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) whose z axis is a direction, and whose x axis is near another."""
    z = direction / np.linalg.norm(direction)
    y = np.cross(z, x_axis)
    y /= np.linalg.norm(y)
    return np.stack([np.cross(y, z), y, z], axis=1)


def homogeneous(turn: np.ndarray, place: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, place
    return pose


def draw_cameras(random: np.random.Generator) -> list[np.ndarray]:
    """Draw both poses tool <- camera, (4, 4)."""
    poses = []
    for side in (-1.0, 1.0):
        place = DISTANCE_MM * np.array([0.0, side * np.sin(HALF_ANGLE_RAD), -np.cos(HALF_ANGLE_RAD)])
        place = place + random.normal(0.0, 0.3, 3)
        poses.append(homogeneous(turned_towards(-place, np.array([0.0, 1.0, 0.0])), place))
    return poses


def draw_skin(number: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw the pose (4, 4) tool <- skin and the semi-axes (3,): a ball, or a cylinder along y."""
    axes = np.full(3, random.uniform(*LONG_RADIUS_MM))
    if number % 3 == 2:
        axes[:] = random.uniform(*SHORT_RADIUS_MM), np.inf, np.nan
        axes[2] = axes[0]
    tilt, turn, spin = np.radians(random.uniform(0.0, LARGEST_TILT_DEG)), *random.uniform(0.0, 2.0 * np.pi, 2)
    outwards = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), -np.cos(tilt)])
    frame = turned_towards(outwards, np.array([np.cos(spin), np.sin(spin), 0.1]))
    height = random.uniform(-1.0, 1.0) * LARGEST_HEIGHT_MM
    return homogeneous(frame, np.array([0.0, 0.0, height]) - axes[2] * outwards), axes


def hit(origin: np.ndarray, directions: np.ndarray, skin: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return the points (n, 3) where rays first meet the skin, NaN where they miss."""
    start = (skin[:3, :3].T @ (origin - skin[:3, 3])) / axes
    ways = directions @ skin[:3, :3] / axes
    a, b, c = (ways**2).sum(axis=1), ways @ start, start @ start - 1.0
    square = b**2 - a * c
    distance = (-b - np.sqrt(np.where(square > 0.0, square, np.nan))) / a
    return np.asarray(origin + distance[:, None] * directions)


def true_line(
    projector: np.ndarray, cameras: list[np.ndarray], skin: np.ndarray, axes: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the line on the skin (n, 3), and in each image (n, 2), NaN where the skin itself hides it."""
    along = np.tan(np.linspace(-1.0, 1.0, TRUE_STEPS) * np.radians(FAN_DEG))
    ways = np.stack([0.0 * along, along, np.ones_like(along)], axis=1) @ projector[:3, :3].T
    points = hit(projector[:3, 3], ways, skin, axes)
    truth = {"line_mm": points}
    for side, camera in zip(("left", "right"), cameras, strict=True):
        seen = points - camera[:3, 3]
        first = hit(camera[:3, 3], seen, skin, axes)
        in_camera = seen @ camera[:3, :3]
        pixel = FOCAL_PX * in_camera[:, :2] / in_camera[:, 2:] + (np.array(SENSOR_PX) - 1.0) / 2.0
        hidden = ~(np.linalg.norm(first - points, axis=1) < 1e-3)
        truth[f"{side}_line_px"] = np.where(hidden[:, None], np.nan, pixel)
    return truth


def mottled(random: np.random.Generator, radius_mm: float, length_mm: float) -> dict[str, Any]:
    """Draw the colour of skin: blotches of all sizes, on a ball or cylinder as large along its axis."""
    cycles = np.hypot(np.fft.fftfreq(TEXELS)[:, None], np.fft.rfftfreq(TEXELS)[None]) * TEXELS
    spectrum = np.fft.rfft2(random.standard_normal((TEXELS, TEXELS))) / np.maximum(cycles, 4.0)
    noise = np.fft.irfft2(spectrum, s=(TEXELS, TEXELS))
    colour = np.clip(0.55 * (1.0 + MOTTLE * noise / noise.std()), 0.05, 0.95)
    bitmap = mi.Bitmap(np.repeat(colour[..., None], 3, axis=-1).astype(np.float32))
    times = 2.0 * np.pi * radius_mm / TEXTURE_MM, length_mm / TEXTURE_MM
    repeated = mi.ScalarTransform4f().scale([*map(float, times), 1.0])
    return {"type": "bitmap", "bitmap": bitmap, "raw": True, "to_uv": repeated}


def line_texture() -> dict[str, Any]:
    across, along = LINE_TEXELS
    width_mm = 2.0 * PROJECTOR_MM * np.tan(np.radians(FAN_DEG) / 2.0)
    offset_mm = ((np.arange(across) + 0.5) / across - 0.5) * width_mm
    profile = np.exp(-0.5 * (offset_mm / LINE_SIGMA_MM) ** 2)
    values = np.broadcast_to(profile, (along, across))[..., None]
    bitmap = mi.Bitmap(np.repeat(values, 3, axis=-1).astype(np.float32))
    return {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"}


def as_transform(matrix: np.ndarray) -> Any:
    return mi.ScalarTransform4f(matrix.astype(np.float64))


def sensor(pose: np.ndarray, middle: np.ndarray, options: argparse.Namespace, samples: int) -> dict[str, Any]:
    corner = np.clip(
        np.rint(middle - [options.columns / 2, options.rows / 2]).astype(int),
        0,
        [SENSOR_PX[0] - options.columns, SENSOR_PX[1] - options.rows],
    )
    return {
        "type": "thinlens",
        "fov": float(np.degrees(2.0 * np.arctan(SENSOR_PX[0] / 2.0 / FOCAL_PX))),
        "fov_axis": "x",
        "aperture_radius": APERTURE_MM,
        "focus_distance": DISTANCE_MM,
        "near_clip": 5.0,
        "to_world": as_transform(pose) @ mi.ScalarTransform4f().rotate([0, 0, 1], 180.0),
        "film": {
            "type": "hdrfilm", "width": SENSOR_PX[0], "height": SENSOR_PX[1],
            "crop_offset_x": int(corner[0]), "crop_offset_y": int(corner[1]),
            "crop_width": options.columns, "crop_height": options.rows,
            "pixel_format": "luminance", "component_format": "float32", "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent", "sample_count": samples},
    }  # fmt: skip


def render_view(number: int, options: argparse.Namespace) -> dict[str, Any]:
    """Render the parts of one view, all drawn from its number."""
    random = np.random.default_rng([77, number])
    cameras, (skin, axes) = draw_cameras(random), draw_skin(number, random)
    place = np.array([0.0, 0.0, -PROJECTOR_MM]) + random.normal(0.0, 1.0, 3)
    projector = homogeneous(
        turned_towards(-place, np.array([0.05 * random.standard_normal(), 1.0, 0.0])), place
    )
    truth = true_line(projector, cameras, skin, axes)
    shape = {"type": "sphere", "radius": float(axes[0])}
    if np.isinf(axes[1]):
        ends = [0.0, -LONGEST_RIDGE_MM, 0.0], [0.0, LONGEST_RIDGE_MM, 0.0]
        shape = {"type": "cylinder", "p0": ends[0], "p1": ends[1], "radius": float(axes[0])}
        length_mm = 2.0 * LONGEST_RIDGE_MM
    else:
        length_mm = np.pi * float(axes[0])
    # The poles of the texture lie aside, where they are not seen.
    upright = mi.ScalarTransform4f() if np.isinf(axes[1]) else mi.ScalarTransform4f().rotate([1, 0, 0], 90.0)
    shape["to_world"] = as_transform(skin) @ upright
    surface = {
        "type": "principled", "base_color": mottled(random, float(axes[0]), length_mm),
        "roughness": 0.45, "specular": 0.5, "flatness": 1.0,
    }  # fmt: skip
    laser = {
        "type": "projector", "to_world": as_transform(projector), "fov": FAN_DEG, "fov_axis": "x",
        "irradiance": line_texture(), "scale": 1000.0,
    }  # fmt: skip
    inside = {
        "type": "homogeneous", "albedo": SCATTERING_PER_MM / (SCATTERING_PER_MM + ABSORPTION_PER_MM),
        "sigma_t": SCATTERING_PER_MM + ABSORPTION_PER_MM,
    }  # fmt: skip
    lamp_way = np.array([*random.uniform(-1.0, 1.0, 2), -1.5])
    lamp = {"type": "directional", "direction": [float(each) for each in -lamp_way], "irradiance": 1.0}
    parts: dict[str, tuple[dict[str, Any], dict[str, Any], dict[str, Any], int]] = {
        "room": ({"type": "path", "max_depth": 2}, shape | {"bsdf": surface}, lamp, 16),
        "surface": ({"type": "path", "max_depth": 2}, shape | {"bsdf": surface}, laser, options.samples),
    }
    if options.deep_samples:
        body = shape | {"bsdf": {"type": "null"}, "interior": inside}
        volume = {"type": "volpath", "max_depth": SCATTERED_TIMES, "rr_depth": SCATTERED_TIMES}
        parts["inside"] = (volume, body, laser, options.deep_samples)
    view: dict[str, Any] = truth | {"tool_from_cameras": np.stack(cameras), "tool_from_projector": projector}
    for index, side in enumerate(("left", "right")):
        middle = np.nanmean(truth[f"{side}_line_px"], axis=0)
        for part, (integrator, body, light, samples) in parts.items():
            eye = sensor(cameras[index], middle, options, samples)
            scene = {"type": "scene", "integrator": integrator, "sensor": eye, "skin": body, "light": light}
            picture = np.array(mi.render(mi.load_dict(scene), seed=2 * number + index))[..., 0]
            view[f"{side}_{part}"] = blur_by_diffraction(picture).astype(np.float32)
            view[f"{side}_offset_px"] = np.array(
                [eye["film"]["crop_offset_x"], eye["film"]["crop_offset_y"]], dtype=int
            )
    return view


def blur_by_diffraction(light: np.ndarray) -> np.ndarray:
    reach = int(4.0 * DIFFRACTION_PX) + 1
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / DIFFRACTION_PX) ** 2)
    kernel /= kernel.sum()
    for axis in (0, 1):
        padded = np.pad(light, [(reach, reach) if each == axis else (0, 0) for each in (0, 1)], mode="edge")
        light = np.apply_along_axis(np.convolve, axis, padded, kernel, mode="valid")
    return light


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--views", type=int, default=12)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--rows", type=int, default=544)
    parser.add_argument("--columns", type=int, default=400)
    parser.add_argument("--samples", type=int, default=48)
    parser.add_argument("--deep-samples", type=int, default=0)
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    for number in range(options.first, options.first + options.views):
        np.savez_compressed(options.folder / f"{number:04d}.npz", **render_view(number, options))


if __name__ == "__main__":
    main()

"""Views of a retro-reflective ball before a drape, by the path tracer Mitsuba, for `traced_views`.

    python path_tracer.py FOLDER [--views 24] [--first 0] [--focal-px 11364] [--size 600] [--samples 10]
                          [--ring-mm 14] [--paint 0.5] [--defocus-mm 1] [--hidden 0]

Runs in an environment of its own with `mitsuba` and `numpy` (no dependency of this project; Mitsuba 3.9 needs
LLVM 17 or newer, given by DRJIT_LIBLLVM_PATH if it is not found). Writes one file per view: light of the ring
of lamps around the lens, of a theatre lamp from above and of one from the side, and the true outline.

Camera frame as in this project: x right, y down, z along the axis, lens at the origin. A thin lens at f/8
blurs by depth, a Gaussian by diffraction, a pixel integrates over its area.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import drjit as dr  # type: ignore[import-not-found]  # only in the environment that renders
import mitsuba as mi  # type: ignore[import-not-found]  # likewise
import numpy as np

mi.set_variant("llvm_ad_rgb")

BALL_MM, FOCUS_MM, APERTURE_MM = 5.75, 250.0, 3.125  # radii, and the distance of the plane of focus
DIFFRACTION_PX, OVERSAMPLING = 0.65, 2
PATH_VERTICES = 3  # lamp to drape to ball to lens, and the other way round
PARTS = ("ring", "top", "side")
LAMPS_AROUND_LENS, LAMP_MM = 10, 1.5
FILM_GAIN, FILM_LOBE_RAD, FILM_LIMB = 8.0, 0.06, 0.25
GRAIN, CLOUDS = 0.04, 0.02  # of the film's brightness: beads, and what is longer
TEXELS, CLOTH_POINTS, CLOTH_MM, FOLD_MM = 1024, 241, 120.0, 4.0
CLEARANCE_MM, CLEAR_RADIUS_MM = 8.0, 9.0  # of the drape behind the ball
FIREFLY = 2.0  # over the median of the neighbours
COVER_BEFORE_MM, COVER_MM, COVER_REFLECTANCE = (6.0, 25.0), 60.0, (0.02, 0.5)  # before the ball, its side


class BeadFilm(mi.BSDF):  # type: ignore[misc]  # its base is unknown where Mitsuba is not installed
    """Matt paint plus a lobe that returns light to its source, weaker at the limb."""

    def __init__(self, props: mi.Properties) -> None:
        mi.BSDF.__init__(self, props)
        self._paint = float(props["paint"])
        self._grain = props["grain"]
        self.m_flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
        self.m_components = [self.m_flags]

    def _value(self, surface: Any, outgoing: Any) -> Any:
        seen, lit = mi.Frame3f.cos_theta(surface.wi), mi.Frame3f.cos_theta(outgoing)
        angle = dr.safe_acos(dr.dot(surface.wi, outgoing))
        lobe = dr.exp(-0.5 * dr.square(angle / FILM_LOBE_RAD)) * (1.0 - FILM_LIMB * (1.0 - seen))
        value = (self._paint / np.pi * lit + FILM_GAIN * lobe) * self._grain.eval_1(surface)
        return dr.select((seen > 0) & (lit > 0), value, 0.0)

    def sample(self, context: Any, surface: Any, _one: Any, two: Any, active: Any = True) -> Any:
        drawn = mi.BSDFSample3f()
        drawn.wo = mi.warp.square_to_cosine_hemisphere(two)
        drawn.pdf = mi.warp.square_to_cosine_hemisphere_pdf(drawn.wo)
        drawn.eta = 1.0
        drawn.sampled_type = mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
        drawn.sampled_component = mi.UInt32(0)
        weight = self._value(surface, drawn.wo) / drawn.pdf
        return drawn, mi.Color3f(dr.select(active & (drawn.pdf > 0), weight, 0.0))

    def eval(self, context: Any, surface: Any, outgoing: Any, active: Any = True) -> Any:
        return mi.Color3f(dr.select(active, self._value(surface, outgoing), 0.0))

    def pdf(self, context: Any, surface: Any, outgoing: Any, active: Any = True) -> Any:
        density = mi.warp.square_to_cosine_hemisphere_pdf(outgoing)
        return dr.select(mi.Frame3f.cos_theta(outgoing) > 0, density, 0.0)

    def eval_pdf(self, context: Any, surface: Any, outgoing: Any, active: Any = True) -> Any:
        return self.eval(context, surface, outgoing, active), self.pdf(context, surface, outgoing, active)

    def traverse(self, callback: Any) -> None:
        """Nothing of it is differentiated."""


mi.register_bsdf("bead_film", BeadFilm)


def draw_noise(random: np.random.Generator, weigh: Any) -> np.ndarray:
    """Draw a periodic texture of unit deviation, its spectrum weighed by cycles per texture."""
    cycles = np.hypot(np.fft.fftfreq(TEXELS)[:, None], np.fft.rfftfreq(TEXELS)[None]) * TEXELS
    spectrum = np.fft.rfft2(random.standard_normal((TEXELS, TEXELS))) * weigh(np.maximum(cycles, 1.0))
    noise = np.fft.irfft2(spectrum, s=(TEXELS, TEXELS))
    return np.asarray(noise / noise.std())


def draw_cloth_texture(random: np.random.Generator) -> np.ndarray:
    """Draw blotches, weave and a few stains."""
    y, x = np.mgrid[:TEXELS, :TEXELS]
    weave = np.sin(2.0 * np.pi * x / 8.0) * np.sin(2.0 * np.pi * y / 8.0)
    cloth = 1.0 + 0.12 * draw_noise(random, lambda cycles: cycles**-1.2) + 0.08 * weave
    for _ in range(random.integers(3, 12)):
        at_x, at_y, width = *random.uniform(0.0, TEXELS, 2), random.uniform(4.0, 60.0)
        distance = ((x - at_x) ** 2 + (y - at_y) ** 2) / (2.0 * width**2)
        cloth *= 1.0 - random.uniform(0.0, 0.6) * np.exp(-distance)
    return np.asarray(np.clip(cloth / cloth.max(), 0.02, 1.0))


def draw_grain(random: np.random.Generator) -> np.ndarray:
    beads = draw_noise(random, lambda cycles: np.exp(-0.5 * (cycles / (0.12 * TEXELS)) ** 2))
    clouds = draw_noise(random, lambda cycles: np.exp(-0.5 * (cycles / (0.01 * TEXELS)) ** 2))
    return np.asarray(np.clip(1.0 + GRAIN * beads + CLOUDS * clouds, 0.3, 2.0))


def write_cloth(random: np.random.Generator, ball: np.ndarray, path: Path) -> None:
    """Write a folded cloth behind the ball, tilted at random, as a mesh."""
    along = np.linspace(-CLOTH_MM / 2.0, CLOTH_MM / 2.0, CLOTH_POINTS)
    x, y = np.meshgrid(along, along)
    z = np.zeros_like(x)
    for _ in range(7):
        turn, length, phase = random.uniform(0.0, np.pi), random.uniform(8.0, 50.0), random.uniform(0.0, 6.28)
        z += length * np.sin(2.0 * np.pi * (x * np.cos(turn) + y * np.sin(turn)) / length + phase)
    points = np.stack([x, y, FOLD_MM * z / np.abs(z).max()], axis=-1).reshape(-1, 3)
    tilt = mi.ScalarTransform4f()
    for axis, limit in (([1, 0, 0], 45.0), ([0, 1, 0], 45.0), ([0, 0, 1], 180.0)):
        tilt = tilt @ mi.ScalarTransform4f().rotate(axis, random.uniform(-limit, limit))
    points = points @ np.array(tilt.matrix)[:3, :3].T + ball + [0.0, 0.0, random.uniform(14.0, 45.0)]
    behind = np.hypot(points[:, 0] - ball[0], points[:, 1] - ball[1]) < CLEAR_RADIUS_MM
    points[:, 2] += max(0.0, ball[2] + CLEARANCE_MM - points[behind, 2].min())
    index = np.arange(CLOTH_POINTS**2).reshape(CLOTH_POINTS, CLOTH_POINTS)
    corners = [each.ravel() for each in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1])]
    a, b, c, d = corners
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    texture = np.stack(np.meshgrid(*2 * [np.linspace(0.0, 1.0, CLOTH_POINTS)]), axis=-1)
    mesh = mi.Mesh("cloth", len(points), len(faces), has_vertex_texcoords=True)
    content = mi.traverse(mesh)
    content["vertex_positions"] = points.astype(np.float32).ravel()
    content["faces"] = faces.astype(np.uint32).ravel()
    content["vertex_texcoords"] = texture.astype(np.float32).ravel()
    content.update()
    mesh.write_ply(str(path))


def as_bitmap(values: np.ndarray) -> dict[str, Any]:
    bitmap = mi.Bitmap(np.repeat(values[..., None], 3, axis=-1).astype(np.float32))
    return {"type": "bitmap", "bitmap": bitmap, "raw": True}


def lamps(
    part: str, ring_mm: float, ball: np.ndarray, where: dict[str, tuple[float, float]]
) -> dict[str, Any]:
    if part == "ring":
        return {
            f"lamp{number}": {
                "type": "sphere",
                "center": [ring_mm * np.cos(turn), ring_mm * np.sin(turn), -2.0],
                "radius": LAMP_MM,
                "emitter": {"type": "area", "radiance": 300.0},
            }
            for number, turn in enumerate(np.linspace(0.0, 2.0 * np.pi, LAMPS_AROUND_LENS, endpoint=False))
        }
    turn, rise = where[part]
    distance_mm, radius_mm, radiance = (700.0, 90.0, 8.0) if part == "top" else (500.0, 25.0, 60.0)
    towards = [np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), -np.sin(rise)]
    look = mi.ScalarTransform4f().look_at(
        origin=[float(each) for each in ball + distance_mm * np.array(towards)],
        target=[float(each) for each in ball],
        up=[0.1, 0.2, 1.0],
    )
    shape = look @ mi.ScalarTransform4f().scale(radius_mm)
    return {"lamp": {"type": "disk", "to_world": shape, "emitter": {"type": "area", "radiance": radiance}}}


def draw_cover(random: np.random.Generator, ball: np.ndarray, hidden: float) -> dict[str, Any]:
    """Return a matt sheet before the ball, whose straight edge hides this share of the rim."""
    before_mm = random.uniform(*COVER_BEFORE_MM)
    turn = random.uniform(0.0, 2.0 * np.pi)
    edge_mm = BALL_MM * np.cos(np.pi * hidden) * (ball[2] - before_mm) / ball[2]
    away_mm = edge_mm + 0.5 * COVER_MM
    middle = ball * (ball[2] - before_mm) / ball[2] + away_mm * np.array([np.cos(turn), np.sin(turn), 0.0])
    shape = mi.ScalarTransform4f().translate([float(each) for each in middle])
    shape = shape @ mi.ScalarTransform4f().rotate([0, 0, 1], float(np.degrees(turn)))
    shape = shape @ mi.ScalarTransform4f().scale(0.5 * COVER_MM)
    paint = {"type": "diffuse", "reflectance": random.uniform(*COVER_REFLECTANCE)}
    return {"type": "rectangle", "to_world": shape, "bsdf": {"type": "twosided", "paint": paint}}


def render_view(number: int, options: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """Render the parts of one view, all drawn from its number."""
    random = np.random.default_rng(number)
    aside_mm = random.uniform(-0.6, 0.6, 2)
    ball = np.array([*aside_mm, FOCUS_MM + options.defocus_mm * random.uniform(-1.0, 1.0)])
    post = np.array([random.uniform(-0.5, 0.5), random.uniform(-0.1, 0.8), 1.0])
    post /= np.linalg.norm(post)
    rises = {"top": np.radians(random.uniform(35.0, 75.0)), "side": np.radians(random.uniform(-20.0, 15.0))}
    where = {part: (random.uniform(0.0, 2.0 * np.pi), rise) for part, rise in rises.items()}
    cloth, grain = draw_cloth_texture(random), draw_grain(random)
    write_cloth(random, ball, folder / "cloth.ply")
    pixels = options.size * OVERSAMPLING
    flange = mi.ScalarTransform4f().look_at(
        origin=[float(each) for each in ball + 6.2 * post],
        target=[float(each) for each in ball],
        up=[0.3, 1.0, 0.2],
    )
    fixed = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": PATH_VERTICES},
        "sensor": {
            "type": "thinlens",
            "fov": float(np.degrees(2.0 * np.arctan(options.size / 2.0 / options.focal_px))),
            "aperture_radius": APERTURE_MM,
            "focus_distance": FOCUS_MM,
            "near_clip": 5.0,
            "to_world": mi.ScalarTransform4f().rotate([0, 0, 1], 180.0),
            "film": {
                "type": "hdrfilm", "width": pixels, "height": pixels, "pixel_format": "luminance",
                "component_format": "float32", "rfilter": {"type": "box"},
            },
            "sampler": {"type": "independent", "sample_count": options.samples},
        },
        "ball": {
            "type": "sphere", "center": [float(each) for each in ball], "radius": BALL_MM,
            "bsdf": {"type": "bead_film", "grain": as_bitmap(grain), "paint": options.paint},
        },
        "post": {
            "type": "cylinder", "p0": [float(each) for each in ball + 5.0 * post],
            "p1": [float(each) for each in ball + 30.0 * post], "radius": 1.6,
            "bsdf": {"type": "twosided", "metal": {"type": "roughconductor", "alpha": 0.3}},
        },
        "flange": {
            "type": "disk", "to_world": flange @ mi.ScalarTransform4f().scale(3.2),
            "bsdf": {"type": "twosided", "paint": {"type": "diffuse", "reflectance": 0.3}},
        },
        "cloth": {
            "type": "ply", "filename": str(folder / "cloth.ply"),
            "bsdf": {"type": "twosided", "dye": {"type": "diffuse", "reflectance": as_bitmap(0.85 * cloth)}},
        },
    }  # fmt: skip
    if options.hidden:
        fixed["cover"] = draw_cover(random, ball, options.hidden)
    seeds = {part: number * len(PARTS) + index for index, part in enumerate(PARTS)}
    scenes = {part: mi.load_dict(fixed | lamps(part, options.ring_mm, ball, where)) for part in PARTS}
    light = {
        part: expose_pixels(np.array(mi.render(scenes[part], seed=seeds[part]))[..., 0]) for part in PARTS
    }
    return light | {"outline": true_outline(ball, options.focal_px, options.size)}


def expose_pixels(light: np.ndarray) -> np.ndarray:
    """Remove fireflies, blur by diffraction, and integrate over pixels."""
    shifts = [(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1)]
    usual = np.median([np.roll(light, shift, (0, 1)) for shift in shifts], axis=0)
    light = np.where(light > FIREFLY * usual + 1e-6, usual, light)
    spread = int(4.0 * DIFFRACTION_PX * OVERSAMPLING) + 1
    kernel = np.exp(-0.5 * (np.arange(-spread, spread + 1) / (DIFFRACTION_PX * OVERSAMPLING)) ** 2)
    kernel /= kernel.sum()
    for axis in (0, 1):
        padded = np.pad(light, [(spread, spread) if each == axis else (0, 0) for each in (0, 1)], mode="edge")
        light = np.apply_along_axis(np.convolve, axis, padded, kernel, mode="valid")
    side = len(light) // OVERSAMPLING
    blocks = light.reshape(side, OVERSAMPLING, side, OVERSAMPLING)
    return np.asarray(blocks.mean(axis=(1, 3)), dtype=np.float32)


def true_outline(ball: np.ndarray, focal_px: float, size: int) -> np.ndarray:
    """Return centre and mean radius of the outline's ellipse, from the section of the tangent cone."""
    x, y, z = ball
    scale = focal_px * z / (z**2 - BALL_MM**2)
    middle = (size - 1) / 2.0
    return np.array([x * scale + middle, y * scale + middle, focal_px * BALL_MM / np.sqrt(z**2 - BALL_MM**2)])


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--views", type=int, default=24)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--focal-px", type=float, default=62.5e3 / 5.5)
    parser.add_argument("--size", type=int, default=600)
    parser.add_argument("--samples", type=int, default=10)
    parser.add_argument("--ring-mm", type=float, default=14.0)
    parser.add_argument("--paint", type=float, default=0.5)
    parser.add_argument("--defocus-mm", type=float, default=1.0, help="largest, before or behind")
    parser.add_argument("--hidden", type=float, default=0.0, help="share of the rim")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        for number in range(options.first, options.first + options.views):
            arrays = render_view(number, options, Path(scratch))
            np.savez(options.folder / f"{number:04d}.npz", **arrays)


if __name__ == "__main__":
    main()

"""The images of one camera: what is in view, drawn from far to near, blurred by depth, and read out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim.basler.optics import sphere as sphere_image
from sim.basler.optics import stalk as stalk_image
from sim.basler.optics.blur import blurred, spread_px
from sim.basler.optics.canvas import Area, Canvas, Image, bounds_of
from sim.basler.optics.film import Film, Surface
from sim.basler.optics.foreground import CLEAR, Disturbance, nearest_to_axis, occlude, shine
from sim.basler.optics.grain import Grain
from sim.basler.optics.lens import LARGEST_SIGMA_PX, Lens
from sim.basler.optics.light import Lighting
from sim.basler.optics.sphere import Sphere
from sim.basler.optics.stalk import StalkImage
from sim.world.scene.model import CameraTruth

MARGIN_PX = spread_px(LARGEST_SIGMA_PX)  # drawn around the area of interest as input for the blur
NEAREST_MM = 60.0  # nothing closer is drawn: the lens is longer than that


class Optics:
    """Lens, light and the films seen so far by one camera."""

    def __init__(self, camera: CameraTruth, seed: int) -> None:
        self.lens = Lens.of(camera)
        self._lighting = Lighting(seed, camera.serial, camera.sensor_px)
        self._seed = seed
        self._grains: dict[int, Grain] = {}

    def light_on(self, area: Area, spheres: Sequence[Sphere], disturbance: Disturbance = CLEAR) -> Image:
        """Electrons per microsecond (height, width) on an area of the sensor."""
        around = area.grown(MARGIN_PX) if spheres else area
        canvas = Canvas(around, self._lighting.on_background(around))
        for sphere in sorted(spheres, key=lambda each: -each.distance_mm):
            self._draw(canvas, sphere, disturbance)
        looked_at = nearest_to_axis([each for each in spheres if _drawable(each)])
        if looked_at is not None:
            sigma_px = self.lens.blur_sigma_px(float(looked_at.centre_mm[2]))
            for occluder in disturbance.occluders:
                occlude(canvas, occluder, looked_at, self.lens, sigma_px)
        for glare in disturbance.glares:
            shine(canvas, glare)
        return canvas.part(area)

    def _draw(self, canvas: Canvas, sphere: Sphere, disturbance: Disturbance) -> None:
        if not _drawable(sphere):
            return
        sigma_px = self.lens.blur_sigma_px(float(sphere.centre_mm[2]))
        sphere_area = bounds_of(self.lens, sphere.outline_mm()).common(canvas.area)
        stalk_area = bounds_of(self.lens, stalk_image.outline_mm(sphere)).common(canvas.area)
        parts = [part for part in (sphere_area, stalk_area) if not part.empty]
        if not parts:
            return
        patch_area = _hull(parts).grown(spread_px(sigma_px)).common(canvas.area)
        patch = canvas.part(patch_area)
        drawn = Canvas(patch_area, patch.copy())
        self._paint(drawn, sphere, self._film(sphere, disturbance), sphere_area, stalk_area)
        patch[:] = blurred(drawn.light, sigma_px)

    def _paint(
        self, canvas: Canvas, sphere: Sphere, film: Surface, sphere_area: Area, stalk_area: Area
    ) -> None:
        # Light falls off with the square of the distance; full strength at the focus distance.
        strength = np.float32((self.lens.focus_mm / sphere.distance_mm) ** 2)
        stalk = self._stalk(sphere, stalk_area, strength)
        if stalk is not None:
            _over(canvas.part(stalk_area), stalk.cover, stalk.light)
        if sphere_area.empty:
            return
        drawn = sphere_image.image_of(sphere, self.lens, sphere_area, film)
        drawn_light = drawn.light * self._lighting.on_film(sphere_area) * strength
        _over(canvas.part(sphere_area), drawn.cover, drawn_light)
        both = sphere_area.common(stalk_area)
        if stalk is None or both.empty:
            return
        stalk_part, drawn_part = Canvas(stalk_area, stalk.depth_mm), Canvas(sphere_area, drawn.depth_mm)
        in_front = stalk_part.part(both) < drawn_part.part(both)
        in_front &= np.isfinite(drawn_part.part(both))
        cover = Canvas(stalk_area, stalk.cover).part(both) * in_front
        _over(canvas.part(both), cover, Canvas(stalk_area, stalk.light).part(both))

    def _stalk(self, sphere: Sphere, area: Area, strength: np.float32) -> StalkImage | None:
        """Post and base as they appear in an area, or None if they do not."""
        if area.empty:
            return None
        image = stalk_image.image_of(sphere, self.lens, area)
        return replace(image, light=image.light * self._lighting.on_film(area) * strength)

    def _film(self, sphere: Sphere, disturbance: Disturbance) -> Surface:
        if sphere.number not in self._grains:
            self._grains[sphere.number] = Grain(self._seed, sphere.number)
        grain = self._grains[sphere.number]
        to_camera = -sphere.camera_from_sphere.T @ sphere.centre_mm / sphere.distance_mm
        stains = [each for each in disturbance.stains_of(sphere.number) if each.may_be_seen(to_camera)]
        return Film(grain, stains, sphere.radius_mm) if stains else grain


def _drawable(sphere: Sphere) -> bool:
    return bool(sphere.centre_mm[2] - sphere.radius_mm >= NEAREST_MM)


def _over(behind: Image, cover: Image, light: Image) -> None:
    """Composite light over what is behind it, in place."""
    behind += cover * (light - behind)


def _hull(areas: Sequence[Area]) -> Area:
    left, top = min(area.x for area in areas), min(area.y for area in areas)
    right = max(area.x + area.width for area in areas)
    bottom = max(area.y + area.height for area in areas)
    return Area(left, top, right - left, bottom - top)

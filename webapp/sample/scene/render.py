"""Renders photos of the park, also from straight above, as a satellite image."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.sample.scene.camera import SceneCamera
from webapp.sample.scene.foliage import draw_foliage
from webapp.sample.scene.ground import DETAIL_METRES_PER_PIXEL, PAVED, WATER
from webapp.sample.scene.plan import DEPTH_M, WIDTH_M
from webapp.sample.scene.raster import NEAR_M, Frame, Quad, draw_quad, hit_quad, remap, sample
from webapp.sample.scene.stage import Stage, shadow_pixels

_HAZE_M, _HAZE_TOP_M = 420.0, 25.0
_DETAIL_REACH_M = 22.0
_OVERSAMPLING = 1.25

_ALTITUDE_M = 4000.0


def render(stage: Stage, camera: SceneCamera, *, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Render a photo: (h, w, 3) uint8; red, green, blue."""
    large = camera.resized(_OVERSAMPLING)
    frame = Frame.empty(large)
    for number in visible(stage, large):
        draw_quad(frame, large, quad=stage.world.quads[number], sun=float(stage.quad_sun[number]))
    draw_ground(frame, large, stage=stage, quad=stage.ground.park)
    draw_ground(frame, large, stage=stage, quad=stage.ground.country)
    draw_foliage(frame, large, foliage=stage.foliage, leaves=stage.world.leaves, sun=stage.foliage_sun)
    return _develop(_lit(frame, camera, stage), stage, rng)


def visible(stage: Stage, camera: SceneCamera) -> NDArray[np.intp]:
    """Find the quads that can be in the photo, the nearest first.

    Returns:
        (n,) intp: Numbers of quads of the world.
    """
    world = stage.world
    local = camera.to_camera(world.corners.reshape(-1, 3)).reshape(-1, 4, 3)
    x, y, depth = local[..., 0], local[..., 1], local[..., 2]
    wide = camera.width / 2 / camera.focal_px
    high = camera.height / 2 / camera.focal_px
    gone = (depth < NEAR_M).all(1)
    gone |= (x > wide * depth).all(1) | (x < -wide * depth).all(1)
    gone |= (y > high * depth).all(1) | (y < -high * depth).all(1)
    behind = np.einsum("nk,nk->n", world.normals, np.array(camera.position) - world.corners[:, 0])
    gone |= (behind <= 0) & world.normals.any(axis=1)
    kept = np.nonzero(~gone)[0]
    return kept[np.argsort(depth[kept].mean(axis=1), kind="stable")]


def draw_ground(frame: Frame, camera: SceneCamera, *, stage: Stage, quad: Quad) -> None:
    """Draw level ground with fine detail, shadows, and reflections of the sky; changes the frame."""
    hits = hit_quad(frame, camera, quad=quad)
    if hits is None:
        return
    pixels = sample(quad.texture, hits).view(np.uint8).reshape(-1, 4)
    east = hits.across * np.float32(quad.along[0]) + np.float32(quad.corner[0])
    north = (1 - hits.down) * np.float32(quad.up[1]) + np.float32(quad.corner[1])
    kind = pixels[:, 3]
    near = np.nonzero(hits.depth < _DETAIL_REACH_M)[0]
    if near.size:
        tone = _detail(stage, east[near], north[near], kind=kind[near])
        fade = 1 - hits.depth[near] / _DETAIL_REACH_M
        tone = 1 + (tone - 1) * fade
        pixels[near] = np.clip(pixels[near] * tone[:, None], 0, 255).astype(np.uint8)
    wet = np.nonzero(kind > (PAVED + WATER) // 2)[0]
    if wet.size:
        rise = camera.position[2] / np.hypot(
            camera.position[2], np.hypot(east[wet] - camera.position[0], north[wet] - camera.position[1])
        )
        mirror = (0.06 + 0.72 * (1 - rise) ** 3)[:, None]
        sky = np.sqrt(np.clip(stage.light.horizon, 0, 1)) * (176, 196, 208)
        pixels[wet, :3] = (pixels[wet, :3] * (1 - mirror) + sky * mirror).astype(np.uint8)
    sunny = remap(stage.shadow, *shadow_pixels(east, north))[:, 0].astype(np.float32) / 255
    frame.colour.reshape(-1)[hits.index] = pixels.view(np.uint32).ravel()
    frame.depth.reshape(-1)[hits.index] = hits.depth
    frame.sun.reshape(-1)[hits.index] = sunny * np.float32(stage.light.to_sun[2])


def _detail(
    stage: Stage, east: NDArray[np.float32], north: NDArray[np.float32], *, kind: NDArray[np.uint8]
) -> NDArray[np.float32]:
    """Return the brightness of the fine structure: two rotated copies of a tile hide its repetition."""
    layer = (kind > PAVED // 2).astype(np.int8) + (kind > (PAVED + WATER) // 2)
    tone = np.ones(east.size, np.float32)
    for number, tile in enumerate(stage.ground.detail):
        chosen = np.nonzero(layer == number)[0]
        for cos, sin, scale in ((1.0, 0.0, 1.0), (0.79, 0.61, 1.7)) if chosen.size else ():
            step = np.float32(1 / (DETAIL_METRES_PER_PIXEL * scale))
            x = (np.float32(cos) * east[chosen] - np.float32(sin) * north[chosen]) * step
            y = (np.float32(sin) * east[chosen] + np.float32(cos) * north[chosen]) * step
            found = remap(tile, x, y, border=cv2.BORDER_WRAP)[:, 0]
            tone[chosen] *= found.astype(np.float32) * np.float32(1 / 128)
    return tone


def _lit(frame: Frame, camera: SceneCamera, stage: Stage) -> NDArray[np.float32]:
    """Scale the frame to the camera's size and light it; return linear colours."""
    light, size = stage.light, (camera.width, camera.height)
    thin = min(1.0, _HAZE_TOP_M / camera.position[2])  # share of the way to the ground that is in the haze
    clear = _shrink(np.exp(frame.depth * np.float32(-thin / _HAZE_M)), size)[..., None]
    cover = _shrink(np.isfinite(frame.depth).astype(np.float32), size)[..., None]
    albedo = np.square(_shrink(frame.rgba(), size)[..., :3].astype(np.float32) / 255)
    sun = _shrink(frame.sun, size)[..., None] * np.array(light.sun, np.float32)
    lit = albedo * (sun + np.array(light.ambient, np.float32)) * clear
    lit += (cover - clear) * np.array(light.horizon, np.float32) * np.float32(0.8)
    if cover.min() < 1:
        lit += (1 - cover) * _sky(camera, stage)
    return np.asarray(lit, np.float32)


def _shrink(image: NDArray[np.generic], size: tuple[int, int]) -> NDArray[np.float32]:
    return np.asarray(cv2.resize(np.ascontiguousarray(image), size, interpolation=cv2.INTER_AREA))


def _sky(camera: SceneCamera, stage: Stage) -> NDArray[np.float32]:
    """Render the sky of the whole photo, (h, w, 3); at a quarter of the resolution, as it is smooth."""
    light, coarse = stage.light, camera.resized(0.25)
    y, x = np.mgrid[: coarse.height, : coarse.width]
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(coarse.intrinsics).T
    rays = (rays @ camera.camera_from_world).astype(np.float32)
    up = np.clip(rays[..., 2] / np.linalg.norm(rays, axis=-1), 0.02, 1)[..., None]
    side = stage.clouds.shape[0]
    flat = rays[..., :2] / np.maximum(rays[..., 2:], 0.04) * np.float32(0.12 * side)
    cover = remap(stage.clouds, flat[..., 0].ravel(), flat[..., 1].ravel(), border=cv2.BORDER_WRAP)
    cover = cover.reshape(*x.shape, 1)
    cover = cover.astype(np.float32) / 255 * np.clip((up - 0.03) / 0.2, 0, 1)
    share = (1 - np.clip(up * 1.9, 0, 1)) ** 1.5
    blue = share * np.array(light.horizon, np.float32) + (1 - share) * np.array(light.zenith, np.float32)
    white = np.array(light.sun, np.float32) * 0.35 + np.array(light.ambient, np.float32) + 0.2
    sky = (blue * (1 - cover) + np.minimum(white, 1.0) * cover).astype(np.float32)
    return np.asarray(cv2.resize(sky, (camera.width, camera.height), interpolation=cv2.INTER_CUBIC))


def _develop(lit: NDArray[np.float32], stage: Stage, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Convert linear light to a photo: response, lens, noise."""
    height, width = lit.shape[:2]
    y, x = np.linspace(-1, 1, height, dtype=np.float32)[:, None], np.linspace(-1, 1, width, dtype=np.float32)
    vignette = 1 - 0.10 * (x**2 + y**2)
    photo = np.sqrt(np.clip(lit * vignette[..., None], 0, 1)) * 255
    photo = np.asarray(cv2.GaussianBlur(photo, (0, 0), 0.45), np.float32)
    photo += rng.standard_normal((height, width, 1), np.float32) * np.float32(stage.light.noise)
    return np.asarray(np.clip(photo + 0.5, 0, 255), np.uint8)


def overhead(stage: Stage, metres_per_pixel: float, *, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Render a picture from so high above that it is nearly orthographic.

    Args:
        metres_per_pixel: Of the ground.

    Returns:
        (h, w, 3) uint8: Red, green, blue; north is up, and it shows exactly the park's rectangle on the
            ground.
    """
    width, height = round(WIDTH_M / metres_per_pixel), round(DEPTH_M / metres_per_pixel)
    fov = 2 * np.degrees(np.arctan(WIDTH_M / 2 / _ALTITUDE_M))
    camera = SceneCamera(
        (WIDTH_M / 2, DEPTH_M / 2, _ALTITUDE_M), 0.0, float(fov), width, height, pitch_deg=-90.0
    )
    return render(stage, camera, rng=rng)

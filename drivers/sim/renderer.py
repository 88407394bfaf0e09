"""A ray-cast camera on the geoms that collide: exact lens, sub-pixel edges, shading, hard shadow, texture.

One ray through every pixel's centre first; then, only where the picture changes between neighbours, many samples of
the pixel's area on a rank-1 lattice (references/sim.md section 1): edges without bias, 0.03 px in a single row. The
rays of sub-pixel samples follow from the lens's derivative, exact to far below 1e-6 px over half a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import mujoco
import numpy as np

from drivers.sim.texture import Label, SurfaceGrain
from drivers.sim.world_model import MM

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from drivers.sim.lens import Lens
    from drivers.sim.world import Snapshot, World
    from srvs_cell.geometry import Array

_NO_GEOM: Final = -1
_OFFSET_M: Final = 1e-6
_CHUNK_PIXELS: Final = 512
_CHUNK_RAYS: Final = 32768
_UP: Final = 0.95
_INK: Final = 0.35
_SAME_NORMAL: Final = 0.999


@dataclass(frozen=True, kw_only=True)
class Lighting:
    """One lamp that throws shadows, a fill light from above without shadows, ambient light.

    Attributes:
        lamp_mm: place of the lamp, base frame.
        lamp, fill, ambient: irradiance shares; their sum lights a surface that faces the lamp fully.
        exposure: grey share (0 to 1) of a white surface that is lit by an irradiance of 1.
    """

    lamp_mm: tuple[float, float, float] = (1100.0, 420.0, 1250.0)
    lamp: float = 0.62
    fill: float = 0.22
    ambient: float = 0.24
    fill_direction: tuple[float, float, float] = (0.35, -0.45, 0.82)
    exposure: float = 1.0


@dataclass(frozen=True, kw_only=True)
class RenderParameters:
    """How finely to sample.

    Attributes:
        samples: per pixel where the picture changes; a Fibonacci number.
        lattice: the generator of the rank-1 lattice, the Fibonacci number before.
        contrast: relative difference to a neighbour from which a pixel is sampled finely.
    """

    samples: int = 34
    lattice: int = 21
    contrast: float = 0.08
    lighting: Lighting = field(default_factory=Lighting)


class Renderer:
    """Renders snapshots of a world. Has its own MuJoCo state; use it from one thread at a time.

    Args:
        world: whose model and parts are seen.
        lens: the camera's lens.
        tcp_T_camera: true mount of the camera, 4x4, millimetres.
        table_albedo: reflectance of the table.
        seed: of the textures.
        parameters: sampling and light.
        textured: without, all surfaces are plain.
    """

    def __init__(
        self,
        world: World,
        lens: Lens,
        tcp_T_camera: Array,
        table_albedo: float,
        seed: int,
        parameters: RenderParameters | None = None,
        *,
        textured: bool = True,
    ) -> None:
        self._model, self._parts = world.model, world.parts
        self._data = mujoco.MjData(self._model)
        self._lens, self._mount = lens, np.asarray(tcp_T_camera)
        self._parameters = parameters or RenderParameters()
        self._textured = textured
        random = np.random.default_rng([seed, 1])
        self._table = self._model.geom("table").id
        self._table_grain = SurfaceGrain(random, ((47.0, 0.035), (19.0, 0.035), (7.0, 0.03), (2.6, 0.02)))
        self._part_grain = SurfaceGrain(random, ((23.0, 0.015), (6.0, 0.015), (2.2, 0.012)))
        self._labels = {i: Label(random) for i, part in enumerate(self._parts) if part.label}
        self._part_of_geom = np.full(self._model.ngeom, _NO_GEOM)
        self._albedo = np.full(self._model.ngeom, 0.3)
        self._albedo[self._table] = table_albedo
        for index, part in enumerate(self._parts):
            geom = self._model.geom(f"part{index}").id
            self._part_of_geom[geom], self._albedo[geom] = index, part.albedo
        self._geom_body = np.asarray(self._model.geom_bodyid)
        v, u = np.mgrid[0.0 : lens.height, 0.0 : lens.width]
        self._rays, self._ray_slope = lens.rays(np.stack([u, v], axis=-1).reshape(-1, 2))
        count = np.arange(self._parameters.samples)
        lattice = np.stack([count, count * self._parameters.lattice % self._parameters.samples], axis=1)
        self._sub_pixels = (lattice + 0.5) / self._parameters.samples - 0.5

    def render(self, snapshot: Snapshot) -> Array:
        """Return the irradiance on the sensor, 0 dark to 1 white, shape (H, W), without the sensor's own effects."""
        self._data.qpos[:] = snapshot.qpos
        mujoco.mj_kinematics(self._model, self._data)
        base_T_camera = snapshot.base_T_tcp @ self._mount
        shape = (self._lens.height, self._lens.width)
        chunks = [
            self._shade(self._rays[start : start + _CHUNK_RAYS], base_T_camera, None)
            for start in range(0, len(self._rays), _CHUNK_RAYS)
        ]
        grey, geom, normal, lit = (np.concatenate(column) for column in zip(*chunks, strict=True))
        image = grey.reshape(shape)
        fine = np.flatnonzero(
            self._changes(image, geom.reshape(shape), normal.reshape(*shape, 3), lit.reshape(shape)).ravel()
        )
        flat = image.ravel()
        all_lit = _least_of_neighbours(lit.reshape(shape)).ravel()
        for start in range(0, len(fine), _CHUNK_PIXELS):
            pixels = fine[start : start + _CHUNK_PIXELS]
            offset = np.matmul(self._ray_slope[pixels], self._sub_pixels.T).transpose(0, 2, 1)
            rays = self._rays[pixels][:, None, :] + offset
            surely_lit = np.repeat(all_lit[pixels], self._parameters.samples)
            values = self._shade(rays.reshape(-1, 2), base_T_camera, surely_lit)[0]
            flat[pixels] = values.reshape(len(pixels), -1).mean(axis=1)
        return image

    def _shade(
        self, rays: Array, base_T_camera: Array, surely_lit: NDArray[np.bool_] | None
    ) -> tuple[Array, NDArray[np.int32], Array, NDArray[np.bool_]]:
        """Return grey (N,), geom (N,), normal (N, 3) and whether the lamp is seen (N,) for rays (N, 2).

        ``surely_lit`` (N,) tells where nothing nearby is in a shadow, so that none has to be looked for.
        """
        light = self._parameters.lighting
        count = len(rays)
        camera_rays = np.concatenate([rays, np.ones((count, 1))], axis=1)
        direction = camera_rays @ base_T_camera[:3, :3].T
        eye = base_T_camera[:3, 3] * MM
        geom, distance, normal = self._cast(eye, direction)
        hit = geom != _NO_GEOM
        point = eye + distance[:, None] * direction
        lamp = np.asarray(light.lamp_mm) * MM
        to_lamp = lamp - point
        cosine = np.einsum("ij,ij->i", normal, to_lamp) / np.sqrt(np.einsum("ij,ij->i", to_lamp, to_lamp))
        lit = hit & (cosine > 0.0)
        doubtful = np.flatnonzero(lit if surely_lit is None else lit & ~surely_lit)
        lit[doubtful] = self._sees_lamp(lamp, point[doubtful] + _OFFSET_M * normal[doubtful])
        fill = np.asarray(light.fill_direction) / np.linalg.norm(light.fill_direction)
        irradiance = (
            light.ambient
            + light.fill * np.maximum(normal @ fill, 0.0)
            + light.lamp * np.where(lit, np.maximum(cosine, 0.0), 0.0)
        )
        grey = np.where(hit, irradiance * light.exposure * self._reflectance(geom, point, normal), 0.0)
        return grey, geom, normal, lit

    def _cast(self, origin: Array, direction: Array) -> tuple[NDArray[np.int32], Array, Array]:
        count = len(direction)
        geom = np.empty(count, dtype=np.int32)
        distance, normal = np.empty(count), np.empty(3 * count)
        mujoco.mj_multiRay(
            self._model,
            self._data,
            origin,
            np.ascontiguousarray(direction).ravel(),
            None,
            True,
            -1,
            geom,
            distance,
            normal,
            count,
            mujoco.mjMAXVAL,
        )
        return geom, distance, normal.reshape(-1, 3)

    def _sees_lamp(self, lamp: Array, points: Array) -> NDArray[np.bool_]:
        """Return whether nothing stands between the lamp and each point (metres)."""
        count = len(points)
        geom = np.empty(count, dtype=np.int32)
        distance = np.empty(count)
        mujoco.mj_multiRay(
            self._model,
            self._data,
            lamp,
            np.ascontiguousarray(points - lamp).ravel(),
            None,
            True,
            -1,
            geom,
            distance,
            None,
            count,
            mujoco.mjMAXVAL,
        )
        return np.asarray((distance < 0.0) | (distance > 1.0 - _OFFSET_M))

    def _reflectance(self, geom: NDArray[np.int32], point: Array, normal: Array) -> Array:
        albedo = self._albedo[geom]
        if not self._textured:
            return np.asarray(albedo)
        on_table = geom == self._table
        place = point[on_table] / MM
        albedo[on_table] *= self._table_grain.factor(place[:, 0], place[:, 1])
        part_of = np.where(geom == _NO_GEOM, _NO_GEOM, self._part_of_geom[geom])
        for index, part in enumerate(self._parts):
            on_part = part_of == index
            if not on_part.any():
                continue
            body = self._geom_body[self._model.geom(f"part{index}").id]
            turn = self._data.xmat[body].reshape(3, 3)
            local = (point[on_part] - self._data.xpos[body]) @ turn / MM
            facing = normal[on_part] @ turn
            across = np.abs(facing).argmax(axis=1)
            rows = np.arange(len(local))
            shift = 137.0 * (index + 1)
            factor = self._part_grain.factor(
                local[rows, (across + 1) % 3] + shift, local[rows, (across + 2) % 3] + 61.0 * across
            )
            if index in self._labels:
                ink = self._labels[index].printed(2.0 * local[:, 0] / part.length_mm, 2.0 * local[:, 1] / part.width_mm)
                factor = np.where(ink & (facing[:, 2] > _UP), factor * _INK, factor)
            albedo[on_part] *= factor
        return np.asarray(albedo)

    def _changes(
        self, grey: Array, geom: NDArray[np.int32], normal: Array, lit: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Return the pixels where the picture differs from a neighbour, widened by one pixel."""
        changed = np.zeros(grey.shape, dtype=bool)
        for axis in (0, 1):
            first = tuple(slice(None, -1) if a == axis else slice(None) for a in (0, 1))
            second = tuple(slice(1, None) if a == axis else slice(None) for a in (0, 1))
            difference = (
                (geom[first] != geom[second])
                | (lit[first] != lit[second])
                | (np.einsum("...i,...i->...", normal[first], normal[second]) < _SAME_NORMAL)
                | (
                    np.abs(grey[first] - grey[second])
                    > self._parameters.contrast * np.maximum(grey[first], grey[second])
                )
            )
            changed[first] |= difference
            changed[second] |= difference
        return ~_least_of_neighbours(~changed)


def _least_of_neighbours(flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return where a flag and those of all four neighbours are set."""
    least = flags.copy()
    least[1:] &= flags[:-1]
    least[:-1] &= flags[1:]
    least[:, 1:] &= flags[:, :-1]
    least[:, :-1] &= flags[:, 1:]
    return least

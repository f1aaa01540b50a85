"""Ray casting of posed bodies in a room: pictures, silhouettes, shadows (Embree through embreex).

The empty room of a camera is lit once. Per frame the bodies' pixels are cast and shaded, and the shadows on the
room are looked up in small maps of the bodies as each light sample sees them; the maps serve all cameras.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera
from mocap.errors import MissingExtra
from mocap.synth._render_kernels import project_to_map
from mocap.synth.depth import TrueDepth
from mocap.synth.rooms import Room

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

_CELL = 8  # side of the pixel blocks that are tested first, px
_MAP = 72  # side of a light map, texels
GAMMA = 1 / 2.2
_PSF_PX = 0.55
_SUBPIXELS = ((-0.25, -0.25), (0.25, 0.25), (-0.25, 0.25), (0.25, -0.25))
_CONTACT_M = 0.22  # bodies closer to the floor than this keep diffuse light away from it
_CONTACT_TEXEL_M = 0.02
_BIAS_M = 0.035  # a surface does not shadow itself within this depth


def require_embree() -> Any:
    """The embreex modules. Raises MocapError with the remedy when they are not installed."""
    try:
        from embreex import mesh_construction, rtcore_scene
    except ImportError as error:
        raise MissingExtra("rendering needs the optional package embreex", "synth") from error
    return rtcore_scene, mesh_construction


class RayScene:
    """An Embree scene of one mesh (a resource: build once per posed mesh)."""

    def __init__(self, vertices: Array, faces: NDArray[np.int64]) -> None:
        rtcore_scene, mesh_construction = require_embree()
        self._scene = rtcore_scene.EmbreeScene()
        self._mesh = mesh_construction.TriangleMesh(
            self._scene,
            np.ascontiguousarray(vertices, dtype=np.float32),
            np.ascontiguousarray(faces, dtype=np.int32),
        )

    def cast(self, origins: NDArray, directions: NDArray) -> dict[str, NDArray]:
        """First hits: primID (-1 = none), u, v, tfar."""
        return self._scene.run(_float32(origins), _float32(directions), output=1)

    def blocked(self, origins: NDArray, directions: NDArray, distances: NDArray) -> Mask:
        """Whether anything lies on the segments."""
        dists = np.ascontiguousarray(distances, dtype=np.float32)
        return self._scene.run(_float32(origins), _float32(directions), dists, query="OCCLUDED") >= 0


def _float32(a: NDArray) -> NDArray[np.float32]:
    return np.ascontiguousarray(a, dtype=np.float32)


@dataclass(frozen=True, eq=False)
class LightMap:
    """The bodies seen from one light sample.

    R : (3, 3) world to map axes, z forward.  scale, offset : tangent to texel.  hit : (M, M) float32, 1 = body.
    wide : the same, grown by two texels.  reach : (M, M) float32, distance of the hit, m; inf where none.
    """

    position: Array
    R: Array
    scale: Array
    offset: Array
    hit: NDArray[np.float32]
    wide: NDArray[np.float32]
    reach: NDArray[np.float32]

    def texels(self, points: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Texel coordinates (N, 2) and squared distances (N,) of world points (N, 3) float32."""
        return project_to_map(
            _float32(points),
            self.R.astype(np.float32),
            (self.R @ self.position).astype(np.float32),
            self.scale.astype(np.float32),
            self.offset.astype(np.float32),
        )


@dataclass(frozen=True, eq=False)
class ContactMap:
    """How much the bodies hide of the diffuse light close above the floor.

    low : (2,) m, world x and y of texel (0, 0).  amount : (ny, nx) float32 in 0 .. 1.
    """

    low: Array
    amount: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class PosedScene:
    """All bodies of one frame: mesh, attributes, ray scene and light maps (one tuple per light).

    things : what each piece of the mesh is, indices into the world's things; first_vertex : where each piece begins,
    and the end.  crosses_wall : whether some of it is outside the room.
    """

    vertices: Array
    normals: Array
    faces: NDArray[np.int64]
    rest: Array
    things: tuple[int, ...]
    first_vertex: tuple[int, ...]
    rays: RayScene | None
    maps: tuple[tuple[LightMap, ...], ...]
    contact: ContactMap | None
    crosses_wall: bool = False

    def of(self, thing: int) -> tuple[Array, Array]:
        """Vertices and normals, each (V, 3), of one thing."""
        i = self.things.index(thing)
        own = slice(self.first_vertex[i], self.first_vertex[i + 1])
        return self.vertices[own], self.normals[own]


class Thing(Protocol):
    """A mesh to render: vertices (V, 3) at rest and faces (F, 3)."""

    @property
    def vertices(self) -> Array: ...

    @property
    def faces(self) -> NDArray[np.int64]: ...


class Paint(Protocol):
    """The colours of a thing."""

    def albedo(self, body: Any, rest: Array) -> Array:
        """Linear RGB (N, 3) at rest positions (N, 3) on a thing's surface."""
        ...


def posed_scene(
    bodies: tuple[Thing, ...],
    posed: list[tuple[Array, Array]],
    room: Room,
    *,
    things: tuple[int, ...] | None = None,
    with_light: bool = True,
) -> PosedScene:
    """Join the posed bodies of a frame.  posed : vertices and normals of each body.  things : their numbers."""
    things = tuple(range(len(bodies))) if things is None else things
    if not bodies:
        empty = np.zeros((0, 3))
        return PosedScene(empty, empty, np.zeros((0, 3), np.int64), empty, (), (0,), None, (), None)
    starts = np.cumsum([0] + [len(b.vertices) for b in bodies])
    vertices = np.concatenate([v for v, _ in posed])
    faces = np.concatenate([b.faces + s for b, s in zip(bodies, starts, strict=False)])
    rays = RayScene(vertices, faces)
    lights = room.lights if with_light else ()
    maps = tuple(tuple(_light_map(sample, vertices, rays) for sample in light.samples) for light in lights)
    return PosedScene(
        vertices,
        np.concatenate([n for _, n in posed]),
        faces,
        np.concatenate([b.vertices for b in bodies]),
        things,
        tuple(int(s) for s in starts),
        rays,
        maps,
        _contact_map(vertices) if with_light else None,
        bool(np.any(vertices < room.lower) or np.any(vertices > room.upper)),
    )


def _contact_map(vertices: Array) -> ContactMap | None:
    """Diffuse shade under what is close to the floor; None when nothing is."""
    near = vertices[vertices[:, 2] < _CONTACT_M]
    if not len(near):
        return None
    low = near[:, :2].min(axis=0) - 0.2
    n = np.ceil((near[:, :2].max(axis=0) + 0.2 - low) / _CONTACT_TEXEL_M).astype(int) + 1
    cover = np.zeros((n[1], n[0]), dtype=np.float32)
    texel = np.rint((near[:, :2] - low) / _CONTACT_TEXEL_M).astype(int)
    np.maximum.at(cover, (texel[:, 1], texel[:, 0]), (1 - near[:, 2] / _CONTACT_M).astype(np.float32))
    return ContactMap(low, 0.75 * cv2.GaussianBlur(cover, (0, 0), 0.045 / _CONTACT_TEXEL_M))


def _light_map(position: Array, vertices: Array, rays: RayScene) -> LightMap:
    x0, y0, z0 = vertices.T
    middle = 0.5 * np.array([x0.min() + x0.max(), y0.min() + y0.max(), z0.min() + z0.max()])
    z = (middle - position) / np.linalg.norm(middle - position)
    x = np.cross(z, [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    local = (vertices @ R.T - R @ position).T
    tangent = local[:2] / np.maximum(local[2], 0.05)
    low = np.array([tangent[0].min(), tangent[1].min()])
    high = np.array([tangent[0].max(), tangent[1].max()])
    pad = 3
    scale = (_MAP - 1 - 2 * pad) / np.maximum(high - low, 1e-6)
    offset = pad - low * scale
    # Only texels next to a projected vertex can hit.
    near = np.zeros((_MAP, _MAP), dtype=np.uint8)
    column = np.rint(tangent[0] * scale[0] + offset[0]).astype(int)
    near[np.rint(tangent[1] * scale[1] + offset[1]).astype(int), column] = 1
    candidates = np.flatnonzero(cv2.dilate(near, np.ones((3, 3), np.uint8)).ravel())
    row, column = np.divmod(candidates, _MAP)
    tan = np.stack([(column - offset[0]) / scale[0], (row - offset[1]) / scale[1], np.ones(len(row))])
    directions = (tan / np.sqrt(np.einsum("kn,kn->n", tan, tan))).T @ R
    result = rays.cast(np.broadcast_to(position, directions.shape), directions)
    is_hit = result["primID"] >= 0
    hit = np.zeros(_MAP * _MAP, dtype=np.float32)
    reach = np.full(_MAP * _MAP, np.inf, dtype=np.float32)
    hit[candidates[is_hit]] = 1.0
    reach[candidates[is_hit]] = result["tfar"][is_hit]
    hit = cv2.GaussianBlur(hit.reshape(_MAP, _MAP), (0, 0), 0.7)
    wide = cv2.dilate(hit, np.ones((5, 5), np.uint8))
    return LightMap(position, R, scale, offset, hit, wide, reach.reshape(_MAP, _MAP))


@dataclass(frozen=True, eq=False)
class FirstHits:
    """What rays meet: distances (N,) m of the room (walls, furniture) and of the bodies, inf where none.

    face : (N,) face of the posed scene, -1 where none.
    """

    room_m: Array
    body_m: Array
    face: NDArray[np.int64]


class CameraView:
    """One camera in one room: everything that does not change from frame to frame."""

    def __init__(self, camera: Camera, room: Room) -> None:
        self.camera = camera
        self.room = room
        w, h = camera.size
        if w % _CELL or h % _CELL:
            raise ValueError(f"picture size must be a multiple of {_CELL}, got {w} x {h}")
        u, v = np.meshgrid(np.arange(w, dtype=np.float64), np.arange(h, dtype=np.float64))
        self.directions = camera.rays(np.stack([u, v], axis=-1).reshape(-1, 2)).astype(np.float32)
        self.eye = camera.center.astype(np.float32)
        vertices, faces, owner = room.mesh()
        self._shell = shell = RayScene(vertices, faces)
        corner = vertices[faces]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)

        def hits(directions: NDArray[np.float32]) -> tuple[NDArray, NDArray, NDArray, NDArray]:
            """Distance, point, normal towards the camera and owner of what each ray meets."""
            result = shell.cast(np.broadcast_to(self.eye, directions.shape), directions)
            face = result["primID"]
            if np.any(face < 0):
                raise ValueError(f"camera {camera.name} stands outside the room")
            depth = result["tfar"].astype(np.float32)
            facing = normal[face].astype(np.float32)
            facing *= -np.sign(np.einsum("ni,ni->n", facing, directions))[:, None]
            return depth, self.eye + depth[:, None] * directions, facing, owner[face]

        self.depth, self.points, normals, owners = hits(self.directions)
        self._cosine = -np.einsum("ni,ni->n", normals, self.directions)
        albedo = np.zeros((w * h, 3))
        grid = self.directions.reshape(h, w, 3)
        along_v, along_u = np.asarray(np.gradient(grid, axis=0)), np.asarray(np.gradient(grid, axis=1))
        for du, dv in _SUBPIXELS:
            # Edges of the paint are sampled finer than the pixels, or thin joints break up.
            shifted = (
                self.directions
                + np.float32(du) * along_u.reshape(-1, 3)
                + np.float32(dv) * along_v.reshape(-1, 3)
            )
            _, at, facing, of = hits(shifted / np.sqrt(np.einsum("ni,ni->n", shifted, shifted))[:, None])
            albedo += room.paint(at.astype(np.float64), facing, of) / len(_SUBPIXELS)
        albedo *= room.texture(self.points.astype(np.float64), normals, owners)[:, None]
        albedo = np.clip(albedo, 0.01, 0.95)
        obstacles = (
            RayScene(vertices[8:], faces[len(faces) - 12 * len(room.furniture) :] - 8)
            if len(room.furniture)
            else None
        )
        # Light that each sample of each light sends from each pixel's point to the camera, before shadows.
        self.parts: list[NDArray[np.float32]] = []
        diffuse = albedo * room.ambient
        total = diffuse.copy()
        is_floor = (owners == 0) & (normals[:, 2] > 0.5)
        for light in room.lights:
            arriving = np.zeros(w * h)
            for sample in light.samples:
                arriving += _arriving(light.is_dome, sample, self.points, normals, obstacles)
            part = arriving[:, None] * albedo * (light.power / len(light.samples))
            total += part
            self.parts.append(part.astype(np.float32))
        self.parts.append(diffuse.astype(np.float32))  # the last part: shaded by contact only
        self.lit = total.astype(np.float32)
        empty = _display(self.lit).reshape(h, w, 3)
        self.empty = cv2.GaussianBlur(empty, (0, 0), _PSF_PX)
        self._blocks = (
            np.arange(w * h).reshape(h // _CELL, _CELL, w // _CELL, _CELL).transpose(0, 2, 1, 3)
        ).reshape(-1, _CELL * _CELL)
        self._block_shape = (h // _CELL, w // _CELL)
        middle = self._blocks[:, _CELL * _CELL // 2 + _CELL // 2]
        self._block_points = self.points[middle]
        self._block_on_floor = is_floor[self._blocks].any(axis=1)
        self._is_floor = is_floor

    def render(
        self, scene: PosedScene, bodies: tuple[Thing, ...], looks: tuple[Paint, ...]
    ) -> tuple[Array, Mask]:
        """Noise-free picture (H, W, 3) float32 in 0 .. 255 and the silhouette (H, W) of the visible bodies."""
        w, h = self.camera.size
        if scene.rays is None:
            return self.empty, np.zeros((h, w), dtype=bool)
        pixels, hit = self._body_pixels(scene)
        mask = np.zeros(w * h, dtype=bool)
        mask[pixels] = True
        shadows: list[tuple[int, NDArray, NDArray]] = []  # part, pixels, share of the part taken away
        for i, maps in enumerate(scene.maps):
            for light_map in maps:
                shaded, amount = self._shadowed(light_map, scene.crosses_wall)
                shadows.append((i, shaded, amount / np.float32(len(maps))))
        if scene.contact is not None:
            shadows.append((len(self.parts) - 1, *self._contact(scene.contact)))
        touched = np.concatenate([pixels, *(shaded for _, shaded, _ in shadows)])
        if not len(touched):
            return self.empty, mask.reshape(h, w)
        rows, columns = np.divmod(touched, w)
        pad = 4
        top, bottom = max(int(rows.min()) - pad, 0), min(int(rows.max()) + pad + 1, h)
        left, right = max(int(columns.min()) - pad, 0), min(int(columns.max()) + pad + 1, w)
        window = (slice(top, bottom), slice(left, right))
        darkness = np.zeros((len(self.parts), (bottom - top) * (right - left)), dtype=np.float32)
        for i, shaded, amount in shadows:
            darkness[i, (shaded // w - top) * (right - left) + shaded % w - left] += amount
        linear = self.lit.reshape(h, w, 3)[window].copy()
        for i, part in enumerate(self.parts):
            linear -= darkness[i].reshape(linear.shape[:2])[..., None] * part.reshape(h, w, 3)[window]
        colours = self._shade(scene, bodies, looks, pixels, hit)
        linear[pixels // w - top, pixels % w - left] = colours
        picture = self.empty.copy()
        patch = cv2.GaussianBlur(_display(linear), (0, 0), _PSF_PX)
        # The rim of the window keeps the room's own blur, except at the border of the picture.
        rim = [2 * (top > 0), 2 * (bottom < h), 2 * (left > 0), 2 * (right < w)]
        inner = (slice(rim[0], patch.shape[0] - rim[1]), slice(rim[2], patch.shape[1] - rim[3]))
        picture[window][inner] = patch[inner]
        return picture, mask.reshape(h, w)

    def true_depth(self, scene: PosedScene, bodies: tuple[Thing, ...], looks: tuple[Paint, ...]) -> TrueDepth:
        """How far everything is, and what a depth camera's reading of it depends on."""
        w, h = self.camera.size
        distance, albedo, cosine = self.depth.astype(np.float64), np.ones(w * h), self._cosine.copy()
        if scene.rays is not None:
            pixels, hit = self._body_pixels(scene)
            normals, colours = _surface(scene, bodies, looks, hit)
            distance[pixels] = hit["tfar"]
            albedo[pixels] = colours.mean(axis=1)
            cosine[pixels] = np.abs(np.einsum("ni,ni->n", normals, self.directions[pixels]))
        depth_m = distance * (self.directions @ self.camera.R[2].astype(np.float32))
        return TrueDepth(depth_m.reshape(h, w), albedo.reshape(h, w), cosine.reshape(h, w))

    def silhouette(self, scene: PosedScene) -> Mask:
        """Visible bodies only, (H, W) bool."""
        w, h = self.camera.size
        mask = np.zeros(w * h, dtype=bool)
        if scene.rays is not None:
            mask[self._body_pixels(scene)[0]] = True
        return mask.reshape(h, w)

    def first_hits(self, points: Array, scene: PosedScene) -> FirstHits:
        """What the rays from the camera through points (N, 3) m, world, meet first."""
        towards = points - self.camera.center
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        origins = np.broadcast_to(self.eye, towards.shape)
        room = self._shell.cast(origins, towards)
        room_m = np.where(room["primID"] >= 0, room["tfar"], np.inf).astype(np.float64)
        if scene.rays is None:
            none = np.full(len(points), -1, np.int64)
            return FirstHits(room_m, np.full(len(points), np.inf), none)
        body = scene.rays.cast(origins, towards)
        face = body["primID"].astype(np.int64)
        return FirstHits(room_m, np.where(face >= 0, body["tfar"], np.inf).astype(np.float64), face)

    def _body_pixels(self, scene: PosedScene) -> tuple[NDArray, dict[str, NDArray]]:
        """Pixels (n,) where a body is in front of the room, with face, barycentric coordinates and distance."""
        uv, _ = self.camera.project(scene.vertices)
        rows, columns = self._block_shape
        with np.errstate(invalid="ignore"):
            cell = np.floor((uv + 0.5) / _CELL)
            near = (cell[:, 0] >= -1) & (cell[:, 0] <= columns) & (cell[:, 1] >= -1) & (cell[:, 1] <= rows)
        cells = cell[near].astype(int) + 1
        marked = np.zeros((rows + 2, columns + 2), dtype=np.uint8)
        marked[cells[:, 1], cells[:, 0]] = 1
        marked = cv2.dilate(marked, np.ones((3, 3), np.uint8))[1:-1, 1:-1]
        candidates = self._blocks[np.flatnonzero(marked.ravel())].ravel()
        none: dict[str, NDArray] = {k: np.zeros(0, np.float32) for k in ("u", "v", "tfar")}
        none["primID"] = np.zeros(0, np.int32)
        if not len(candidates) or scene.rays is None:
            return np.zeros(0, np.int64), none
        result = scene.rays.cast(np.broadcast_to(self.eye, (len(candidates), 3)), self.directions[candidates])
        visible = (result["primID"] >= 0) & (result["tfar"] < self.depth[candidates])
        return candidates[visible], {k: result[k][visible] for k in none}

    def _shadowed(self, light_map: LightMap, crosses_wall: bool) -> tuple[NDArray, NDArray]:
        """Pixels of the room that the bodies shade from one light sample, and by how much (0 .. 1)."""
        texel, _ = light_map.texels(self._block_points)
        coarse = _lookup(light_map.wide, texel, cv2.INTER_NEAREST) > 0
        coarse = cv2.dilate(coarse.reshape(self._block_shape).astype(np.uint8), np.ones((3, 3), np.uint8))
        pixels = self._blocks[np.flatnonzero(coarse.ravel())].ravel()
        if not len(pixels):
            return pixels, np.zeros(0, np.float32)
        texel, square = light_map.texels(self.points[pixels])
        amount = _lookup(light_map.hit, texel, cv2.INTER_LINEAR)
        if len(self.room.furniture) or crosses_wall:
            # Only furniture can be between a lamp and a body; walls and floor are behind whoever is in the room.
            reach = _lookup(light_map.reach, texel, cv2.INTER_NEAREST)
            amount[np.isfinite(reach) & (square < reach * reach)] = 0
        keep = amount > 0.004
        return pixels[keep], amount[keep]

    def _contact(self, contact: ContactMap) -> tuple[NDArray, NDArray]:
        """Pixels of the floor in diffuse shade of the bodies, and by how much (0 .. 1)."""
        ny, nx = contact.amount.shape
        high = contact.low + np.array([nx, ny]) * _CONTACT_TEXEL_M
        at = self._block_points[:, :2]
        reach = 0.25  # a block covers some floor round its middle
        close = np.all((at > contact.low - reach) & (at < high + reach), axis=1) & self._block_on_floor
        pixels = self._blocks[close].ravel()
        pixels = pixels[self._is_floor[pixels]]
        if not len(pixels):
            return pixels, np.zeros(0, np.float32)
        texel = (self.points[pixels, :2] - contact.low.astype(np.float32)) / np.float32(_CONTACT_TEXEL_M)
        amount = _lookup(contact.amount, texel, cv2.INTER_LINEAR)
        keep = amount > 0.004
        return pixels[keep], amount[keep]

    def _shade(
        self,
        scene: PosedScene,
        bodies: tuple[Thing, ...],
        looks: tuple[Paint, ...],
        pixels: NDArray,
        hit: dict[str, NDArray],
    ) -> NDArray:
        normals, albedo = _surface(scene, bodies, looks, hit)
        points = self.eye + hit["tfar"][:, None] * self.directions[pixels]
        # Open sky above is brighter than the floor below.
        light = self.room.ambient.astype(np.float32) * (0.85 + 0.3 * normals[:, 2:])
        for lamp, maps in zip(self.room.lights, scene.maps, strict=True):
            some = maps[::2]  # the body's own shadows need fewer samples than the soft edges on the floor
            for light_map in some:
                arriving = _arriving(lamp.is_dome, light_map.position, points, normals, None)
                texel, square = light_map.texels(points)
                reach = _lookup(light_map.reach, texel, cv2.INTER_NEAREST) + np.float32(_BIAS_M)
                arriving[square > reach * reach] = 0.0
                light += arriving[:, None] * (lamp.power / len(some)).astype(np.float32)
        return albedo * light


def _surface(
    scene: PosedScene, bodies: tuple[Thing, ...], looks: tuple[Paint, ...], hit: dict[str, NDArray]
) -> tuple[NDArray, NDArray]:
    """Unit normals and albedos, each (n, 3), of the bodies where rays have hit them."""
    corner = scene.faces[hit["primID"]]
    u, v = hit["u"][:, None].astype(np.float32), hit["v"][:, None].astype(np.float32)
    weights = (1 - u - v, u, v)
    rest = sum(scene.rest[corner[:, k]] * weights[k] for k in range(3))
    normals = sum(scene.normals[corner[:, k]] * weights[k] for k in range(3)).astype(np.float32)
    normals /= np.sqrt(np.einsum("ni,ni->n", normals, normals))[:, None] + np.float32(1e-9)
    albedo = np.zeros((len(corner), 3))
    person = np.searchsorted(np.array(scene.first_vertex[1:]), corner[:, 0], side="right")
    for i, thing in enumerate(scene.things):
        mine = person == i
        if mine.any():
            albedo[mine] = looks[thing].albedo(bodies[thing], rest[mine])
    return normals, albedo


def _arriving(
    is_dome: bool, sample: Array, points: NDArray, normals: NDArray, obstacles: RayScene | None
) -> NDArray:
    """Irradiance (N,) of unit power from one light sample at points with unit normals."""
    towards = sample.astype(points.dtype) - points
    square = np.einsum("ni,ni->n", towards, towards)
    distance = np.sqrt(square)
    cosine = np.maximum(np.einsum("ni,ni->n", towards, normals), 0) / distance
    if is_dome:
        out = cosine / (1 + 0.05 * square)
    else:
        out = cosine * (np.maximum(towards[:, 2], 0) / distance) / (0.5 + square)
    if obstacles is not None:
        start = points + 1e-3 * normals
        out[obstacles.blocked(start, towards / distance[:, None], distance - 2e-3)] = 0.0
    return out


def _lookup(table: NDArray[np.float32], texel: NDArray, interpolation: int) -> NDArray[np.float32]:
    """Values of a map at texel coordinates (N, 2); outside: 0 for shares, inf for distances."""
    outside = float("inf") if np.isinf(table[0, 0]) else 0.0
    width = 2048  # remap wants a picture, not a line longer than 32767
    n = len(texel)
    if n == 0:  # a person is hidden, his shadow is not
        return np.zeros(0, dtype=np.float32)
    padded = np.full((-(-n // width) * width, 2), -99, dtype=np.float32)
    padded[:n] = texel
    grid = padded.reshape(-1, width, 2)
    values = cv2.remap(table, grid, None, interpolation, borderMode=cv2.BORDER_CONSTANT, borderValue=outside)
    return values.reshape(-1)[:n]


def _display(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """Linear light to picture values 0 .. 255 (a power law, so that gains commute with it)."""
    return (255.0 * np.power(np.clip(linear, 0, None), GAMMA)).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Sensor:
    """Exposure, colour cast and noise of one camera.

    gain : (3,) per channel.  noise_levels : standard deviation of the noise, grey levels of 255.
    drift : (T,) exposure of each frame relative to the first.
    """

    gain: Array
    noise_levels: float
    drift: Array
    grain: NDArray[np.float32]

    def expose(self, picture: NDArray, index: int, *, rng: np.random.Generator, light: float = 1.0) -> Image:
        """8-bit RGB picture of frame `index` with noise.  light : linear factor on the light."""
        h, w = picture.shape[:2]
        factor = (self.gain * (light * self.drift[index % len(self.drift)]) ** GAMMA).astype(np.float32)
        out = picture * factor
        if self.noise_levels > 0:
            # A window of a long strip of normal numbers at a random place: as good, and ten times faster.
            start = int(rng.integers(len(self.grain) - h * w * 3))
            out += self.grain[start : start + h * w * 3].reshape(h, w, 3)
        return np.clip(np.rint(out), 0, 255).astype(np.uint8)


def make_sensor(
    n_frames: int,
    size: tuple[int, int],
    *,
    noise_levels: float,
    light_drift: float,
    colour_cast: float,
    fps: float,
    rng: np.random.Generator,
) -> Sensor:
    """A sensor for pictures of size (width, height) with random gain and colour cast.

    light_drift : relative size of slow changes of the light.  colour_cast : spread of gain and colour.
    """
    gain = (1 + colour_cast * rng.uniform(-1, 1)) * (1 + 0.4 * colour_cast * rng.uniform(-1, 1, 3))
    t = np.arange(n_frames) / fps
    drift = 1 + light_drift * (np.sin(2 * np.pi * t / rng.uniform(3, 8) + rng.uniform(0, 6)))
    grain = rng.standard_normal(3 * size[0] * size[1] + 480_000, dtype=np.float32) * np.float32(noise_levels)
    return Sensor(gain, noise_levels, drift, grain)

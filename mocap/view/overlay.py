"""Pictures drawn over camera images: silhouettes, hulls, fitted bodies, stick figures, the floor.

Every function takes an RGB image (H, W, 3) uint8 and returns a new one; the input is never modified. What is
drawn on an image of a camera goes through `Camera.project`, so lens distortion is honoured and whatever lies
behind the camera or is NaN is left out.

Legend (Okabe-Ito colours, told apart with every common colour vision): left limbs blue, right limbs orange,
trunk and head pale grey; a filled joint was observed, a hollow one was not. Left and right are the subject's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, Hull, bones_between, landmark_names

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Colour = tuple[int, int, int]
Side = Literal["left", "right", "middle"]
Cone = tuple[Array, Array, float, float]

SIDE_COLOURS: dict[str, Colour] = {
    "left": (0, 128, 214),
    "right": (236, 130, 0),
    "middle": (226, 226, 226),
}
PERSON_COLOURS: tuple[Colour, ...] = (
    (0, 158, 115),
    (204, 121, 167),
    (240, 228, 66),
    (86, 180, 233),
    (213, 94, 0),
    (0, 114, 178),
    (230, 159, 0),
)
MASK_COLOUR: Colour = (235, 64, 165)
AXIS_COLOURS: dict[str, Colour] = {"x": (213, 94, 0), "y": (0, 158, 115), "z": (0, 114, 178)}

_SHIFT = 4  # OpenCV draws with 4 fractional bits: thin lines land where the camera model says
_MOST_LINE_PX = 200
_MAX_PX = 15_000.0  # beyond this OpenCV's fixed-point coordinates overflow
_MAX_SPLAT_PX = 96
_SPLAT_SHARE = 1.35  # a cube seen from a corner is up to 1.7 sides wide; 1 would leave holes between splats
_SPLATS_PER_CHUNK = 200_000
_DARK: Colour = (24, 24, 28)
_CIRCLE_STEPS = 28
_CONE_STEPS = 5


@dataclass(frozen=True, eq=False)
class BodyPart:
    """One rigid part of a fitted body, ready to be drawn.

    side : whose limb it is, 'left', 'right' (the subject's) or 'middle' for trunk and head.
    cones : truncated cones (p0 (3,) m, p1 (3,) m, r0 m, r1 m), world frame; may be empty.
    """

    name: str
    side: Side
    cones: tuple[Cone, ...]

    def __post_init__(self) -> None:
        if self.side not in SIDE_COLOURS:
            raise ValueError(f"body part {self.name}: side is {self.side!r}, expected left, right or middle")


def person_colour(person: int) -> Colour:
    """RGB colour of a person's id, the same in every picture and plot."""
    return PERSON_COLOURS[(int(person) - 1) % len(PERSON_COLOURS)]


def side_of_landmark(name: str) -> Side:
    """'left', 'right' or 'middle' from a landmark's name."""
    if name.startswith("left_"):
        return "left"
    return "right" if name.startswith("right_") else "middle"


def draw_mask(image: Image, mask: Mask, colour: Colour = MASK_COLOUR, alpha: float = 0.4) -> Image:
    """A silhouette as a tint with a crisp outline.

    image : (H, W, 3) uint8 RGB.  mask : (H, W) bool; an empty mask draws nothing.  alpha : 0..1, tint.
    Raises ValueError when the sizes differ.
    """
    out = _copy(image)
    inside = np.asarray(mask, dtype=np.bool_)
    if inside.shape != out.shape[:2]:
        raise ValueError(f"mask has shape {inside.shape}, expected {out.shape[:2]}")
    out[inside] = _blend(out[inside], colour, alpha)
    contours, _ = cv2.findContours(inside.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(out, contours, -1, colour, _stroke(out), cv2.LINE_AA)
    return out


def draw_hull(
    image: Image,
    camera: Camera,
    hull: Hull,
    *,
    colour_by: Literal["depth", "rgb"] = "depth",
    alpha: float = 0.85,
) -> Image:
    """The surface voxels of a hull as splats, near ones over far ones.

    image : (H, W, 3) uint8 RGB of `camera`.  hull : world frame; an empty one draws nothing.
    colour_by : 'depth' (yellow near, dark blue far) or 'rgb' (the colours seen by the cameras; grey where no
    camera saw the voxel). Creases are darkened, so that limbs in front of the trunk can be told from it.
    """
    out = _copy(image, camera)
    surface = hull.select(hull.is_surface)
    if len(surface) == 0:
        return out
    uv, depth = camera.project(surface.centers)
    voxel_px = _SPLAT_SHARE * surface.grid.voxel_size_m * 0.5 * (camera.K[0, 0] + camera.K[1, 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        distance = np.linalg.norm(surface.centers - camera.center, axis=1)
        side_px = np.maximum(np.ceil(voxel_px / distance), 1)
        side_px = np.minimum(side_px, _MAX_SPLAT_PX).astype(np.int64)
        first = np.rint(uv - 0.5 * (side_px[:, None] - 1))
        h, w = out.shape[:2]
        visible = _is_known(uv)
        visible &= np.all((first + side_px[:, None] > 0) & (first < (w, h)), axis=1)
    order = np.flatnonzero(visible)
    if order.size == 0:
        return out
    order = order[np.argsort(-depth[order], kind="stable")]
    owner = _splat(first[order].astype(np.int64), side_px[order], (h, w))
    painted = owner >= 0
    nearest = np.full((h, w), np.inf)
    nearest[painted] = depth[order][owner[painted]]
    if colour_by == "rgb":
        palette = surface.rgb[order].copy()
        palette[surface.n_views[order] == 0] = 128
    elif colour_by == "depth":
        palette = _depth_colours(depth[order])
    else:
        raise ValueError(f"colour_by is {colour_by!r}, expected depth or rgb")
    shade = _crease_shading(nearest, surface.grid.voxel_size_m)[painted][:, None]
    colours = palette[owner[painted]].astype(np.float64) * shade
    out[painted] = _blend(out[painted], colours, alpha)
    contours, _ = cv2.findContours(painted.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(out, contours, -1, _DARK, _stroke(out), cv2.LINE_AA)
    return out


def draw_body(image: Image, camera: Camera, parts: Sequence[BodyPart], *, alpha: float = 0.5) -> Image:
    """A fitted body: every truncated cone filled semi-transparently with an outline, far ones first.

    image : (H, W, 3) uint8 RGB of `camera`.  parts : world frame; no parts draw nothing, cones with NaN or
    wholly behind the camera are left out.
    The outline of a truncated cone is exactly the convex hull of its two projected end circles; circles in
    between follow the lens distortion. A cone of no length is drawn as a ball.
    """
    out = _copy(image, camera)
    polygons: list[tuple[float, Colour, NDArray[np.int32]]] = []
    for part in parts:
        for cone in part.cones:
            points = _cone_surface(cone, camera.center)
            if points is None:
                continue
            uv = _drawable(camera.project(points)[0])
            uv = uv[_is_known(uv)]
            if len(uv) < 3:
                continue
            outline = cv2.convexHull(uv.astype(np.float32)).reshape(-1, 2)
            distance = float(np.linalg.norm(points.mean(axis=0) - camera.center))
            polygons.append((distance, SIDE_COLOURS[part.side], _fixed_point(outline)))
    polygons.sort(key=lambda item: -item[0])
    for _, colour, polygon in polygons:
        _fill(out, polygon, colour, alpha)
        edge = tuple(int(0.45 * c) for c in colour)
        cv2.polylines(out, [polygon], True, edge, _stroke(out), cv2.LINE_AA, _SHIFT)
    return out


def draw_limbs(image: Image, camera: Camera, parts: Sequence[BodyPart], *, alpha: float = 0.6) -> Image:
    """A fitted body in a small picture: every truncated cone as a line as thick as its mean, far ones first.

    image, parts : as in `draw_body`, which is exact and takes ten times as long.
    """
    out = _copy(image, camera)
    cones = [(part.side, *cone) for part in parts for cone in part.cones]
    if not cones:
        return out
    ends = np.array([[start, end] for _, start, end, _, _ in cones], dtype=np.float64)
    uv, depth = camera.project(ends)
    uv, far = _drawable(uv), depth.mean(axis=1)
    radii = np.array([0.5 * (r0 + r1) for *_, r0, r1 in cones])
    known = np.asarray(np.isfinite(uv).all(axis=(1, 2)))
    width = np.zeros(len(cones), dtype=np.int64)
    width[known] = np.rint(2.0 * radii[known] * camera.K[0, 0] / far[known]).clip(1, _MOST_LINE_PX)
    places = _fixed_point(np.where(known[:, None, None], uv, 0.0))
    layer = out.copy()
    for k in np.argsort(-far).tolist():
        if known[k]:
            _line(layer, places[k], SIDE_COLOURS[cones[k][0]], int(width[k]))
    return np.asarray(cv2.addWeighted(layer, alpha, out, 1.0 - alpha, 0.0), dtype=np.uint8)


def draw_skeleton(
    image: Image,
    camera: Camera,
    landmarks: Array,
    observed: NDArray[np.bool_] | None = None,
    *,
    label: str = "",
    colour: Colour | None = None,
) -> Image:
    """A stick figure with joints; joints that were not observed are hollow, their bones thin.

    image : (H, W, 3) uint8 RGB of `camera`.  landmarks : (M, 3) m, world, M = 15 or, with feet and hands, 21; NaN
    is left out.  observed : (M,) bool or None = all.  label : text above the head, such as the person's number.
    colour : one RGB colour for all bones (for truth); None = by side.
    """
    out = _copy(image, camera)
    points = np.asarray(landmarks, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"landmarks has shape {points.shape}, expected (M, 3)")
    seen = np.ones(len(points), dtype=np.bool_) if observed is None else np.asarray(observed, dtype=np.bool_)
    uv, depth = camera.project(points)
    uv = _drawable(uv)
    known = _is_known(uv)
    stroke = _stroke(out)
    tints = [colour or SIDE_COLOURS[side_of_landmark(name)] for name in landmark_names(len(points))]
    for a, b in _known_bones(known, depth):
        ends = _fixed_point(uv[[a, b]])
        width = 2 * stroke if seen[a] and seen[b] else stroke
        _line(out, ends, _DARK, width + 2)
        _line(out, ends, tints[b], width)
    for j in np.flatnonzero(known):
        _joint(out, uv[j], tints[j], is_hollow=not seen[j])
    return _labelled_above(out, label, uv[known])


def _labelled_above(image: Image, label: str, uv: Array) -> Image:
    """The picture with a label above the highest of the points (n, 2) px; as it is without points."""
    if not label or not len(uv):
        return image
    u, v = uv[np.argmin(uv[:, 1])]
    return draw_label(image, label, (float(u), float(v) - 12.0 * _stroke(image)), centred=True)


def _known_bones(known: Mask, depth: Array) -> list[tuple[int, int]]:
    """Bones with both ends known, the farthest first."""
    return sorted(
        (ab for ab in bones_between(len(known)) if known[list(ab)].all()),
        key=lambda ab: -depth[list(ab)].mean(),
    )


def _joint(out: Image, uv: Array, tint: Colour, *, is_hollow: bool) -> None:
    stroke = _stroke(out)
    radius = (2.2 + stroke) * 2**_SHIFT
    at = tuple(int(x) for x in _fixed_point(uv))
    cv2.circle(out, at, int(radius + 2**_SHIFT), _DARK, -1, cv2.LINE_AA, _SHIFT)
    cv2.circle(out, at, int(radius), tint, stroke if is_hollow else -1, cv2.LINE_AA, _SHIFT)


def draw_label(
    image: Image,
    text: str,
    uv: tuple[float, float],
    *,
    colour: Colour = (255, 255, 255),
    centred: bool = False,
) -> Image:
    """Text on a dark plate, kept inside the picture.

    image : (H, W, 3) uint8 RGB.  uv : (column, row) px, lower left corner of the text, or the middle of its
    lower edge when centred. Characters outside ASCII are shown as '?', empty text draws nothing.
    """
    out = _copy(image)
    plain = text.encode("ascii", "replace").decode("ascii")
    if not plain or not np.all(np.isfinite(uv)):
        return out
    h, w = out.shape[:2]
    scale = max(0.4, 0.5 * h / 480)
    stroke = _stroke(out)
    (tw, th), below = cv2.getTextSize(plain, cv2.FONT_HERSHEY_SIMPLEX, scale, stroke)
    pad = 3 * stroke
    x = uv[0] - (0.5 * tw if centred else 0.0)
    x = int(np.clip(x, pad, max(pad, w - tw - pad)))
    y = int(np.clip(uv[1], th + pad, max(th + pad, h - below - pad)))
    upper, lower = (x - pad, y - th - pad), (x + tw + pad, y + below + pad)
    plate = out[max(0, upper[1]) : lower[1] + 1, max(0, upper[0]) : lower[0] + 1]
    plate[:] = _blend(plate.reshape(-1, 3), _DARK, 0.7).reshape(plate.shape)
    cv2.putText(out, plain, (x, y), cv2.FONT_HERSHEY_SIMPLEX, scale, colour, stroke, cv2.LINE_AA)
    return out


def draw_floor_grid(
    image: Image,
    camera: Camera,
    bounds: Sequence[Sequence[float]],
    *,
    spacing_m: float = 1.0,
    axis_length_m: float = 0.5,
) -> Image:
    """A metre grid on the floor z = 0 and the world axes, to judge a calibration by eye.

    image : (H, W, 3) uint8 RGB of `camera`.  bounds : lower and upper corner of the room, each (x, y[, z]) m.
    Lines run at whole multiples of spacing_m; x is vermilion, y green, z (up) blue, drawn at the origin. A
    good calibration keeps the grid on the floor, and its lines parallel to real edges, in every camera.
    """
    out = _copy(image, camera)
    (x0, y0), (x1, y1) = (np.asarray(corner, dtype=np.float64)[:2] for corner in bounds)
    if not (x1 > x0 and y1 > y0 and spacing_m > 0):
        raise ValueError(f"floor bounds are empty: {bounds}, spacing {spacing_m} m")
    stroke = _stroke(out)
    lines = []
    for x in _multiples(x0, x1, spacing_m):
        lines.append((np.array([x, y0, 0.0]), np.array([x, y1, 0.0])))
    for y in _multiples(y0, y1, spacing_m):
        lines.append((np.array([x0, y, 0.0]), np.array([x1, y, 0.0])))
    layer = out.copy()
    for start, end in lines:
        _world_line(layer, camera, start, end, (255, 255, 255), stroke)
    out = cv2.addWeighted(layer, 0.7, out, 0.3, 0.0)
    for name, direction in zip("xyz", np.eye(3), strict=True):
        tip = direction * axis_length_m
        _world_line(out, camera, np.zeros(3), tip, _DARK, 2 * stroke + 2)
        _world_line(out, camera, np.zeros(3), tip, AXIS_COLOURS[name], 2 * stroke)
        uv = camera.project(tip * 1.12)[0]
        if bool(camera.contains(uv)):
            out = draw_label(out, name, (float(uv[0]), float(uv[1])), centred=True)
    return out


def person_window(
    camera: Camera, points_world: Array, *, margin: float = 0.2, aspect: float = 0.8
) -> tuple[int, int, int, int]:
    """The part of a picture that shows the given points, as (left, top, right, bottom) px, right exclusive.

    points_world : (N, 3) m, such as landmarks or hull centres; NaN and invisible points are ignored. The
    window is grown by margin (share of its longer side), to the aspect (width / height), then moved and cut to
    fit. With no visible point it is the whole picture.
    """
    w, h = camera.size
    uv, _ = camera.project(np.asarray(points_world, dtype=np.float64).reshape(-1, 3))
    uv = uv[camera.contains(uv)]
    if len(uv) == 0:
        return 0, 0, w, h
    lower, upper = uv.min(axis=0), uv.max(axis=0)
    height = float(np.max(upper - lower)) * (1 + 2 * margin) + 16
    height = max(
        height if height * aspect >= (upper - lower)[0] * 1.1 else (upper - lower)[0] * 1.1 / aspect, 64
    )
    size = np.rint(np.minimum([height * aspect, height], [w, h])).astype(int)
    corner = np.rint((lower + upper - size) / 2).astype(int)
    left, top = (int(c) for c in np.clip(corner, 0, np.array([w, h]) - size))
    return left, top, left + int(size[0]), top + int(size[1])


def crop(image: Image, window: tuple[int, int, int, int], *, scale: float = 1.0) -> Image:
    """A copy of the window (left, top, right, bottom) px of an RGB image, enlarged by scale."""
    left, top, right, bottom = window
    part = _copy(image[max(0, top) : bottom, max(0, left) : right])
    if part.size == 0:
        raise ValueError(f"window {window} lies outside the image of shape {image.shape}")
    if scale != 1.0:
        size = (max(1, round(part.shape[1] * scale)), max(1, round(part.shape[0] * scale)))
        method = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
        part = np.asarray(cv2.resize(part, size, interpolation=method), dtype=np.uint8)
    return part


def contact_sheet(
    images: Sequence[Image], labels: Sequence[str], n_columns: int = 4, width: int = 1600, gap: int = 6
) -> Image:
    """Images side by side in rows, each with its label, on a dark ground.

    images : n RGB images of any sizes; each is scaled to its column, never beyond it.  labels : n texts or
    none at all.  width : px of the sheet. No images give a blank strip.
    """
    if labels and len(labels) != len(images):
        raise ValueError(f"{len(labels)} labels for {len(images)} images")
    if n_columns < 1 or width < 16 * n_columns:
        raise ValueError(f"a sheet of {n_columns} columns does not fit in {width} px")
    if not images:
        return np.full((2 * gap + 1, width, 3), _DARK, dtype=np.uint8)
    n_columns = min(n_columns, len(images))
    cell = (width - gap * (n_columns + 1)) // n_columns
    tiles = [_tile(image, cell, labels[i] if labels else "") for i, image in enumerate(images)]
    return _in_rows(tiles, n_columns, width, gap)


def _in_rows(tiles: Sequence[Image], n_columns: int, width: int, gap: int) -> Image:
    """Tiles of one width on a dark ground, rows as high as their highest tile."""
    rows = [tiles[i : i + n_columns] for i in range(0, len(tiles), n_columns)]
    heights = [max(tile.shape[0] for tile in row) for row in rows]
    sheet = np.full((sum(heights) + gap * (len(rows) + 1), width, 3), _DARK, dtype=np.uint8)
    y = gap
    for row, height in zip(rows, heights, strict=True):
        for column, tile in enumerate(row):
            x = gap + column * (tile.shape[1] + gap)
            sheet[y : y + tile.shape[0], x : x + tile.shape[1]] = tile
        y += height + gap
    return sheet


def _tile(image: Image, width: int, label: str) -> Image:
    """An image scaled to a column, with its label."""
    h, w = image.shape[:2]
    size = (width, max(1, round(h * width / w)))
    method = cv2.INTER_AREA if width < w else cv2.INTER_CUBIC
    tile = np.asarray(cv2.resize(_copy(image), size, interpolation=method), dtype=np.uint8)
    return draw_label(tile, label, (6.0, 0.0)) if label else tile


def _copy(image: Image, camera: Camera | None = None) -> Image:
    array = np.asarray(image)
    if array.ndim != 3 or array.shape[2] != 3 or array.dtype != np.uint8:
        raise ValueError(f"image is {array.dtype} {array.shape}, expected uint8 (H, W, 3) RGB")
    if camera is not None and (array.shape[1], array.shape[0]) != camera.size:
        raise ValueError(
            f"image of camera {camera.name} is {array.shape[1]} x {array.shape[0]} px, "
            f"its calibration says {camera.size[0]} x {camera.size[1]}"
        )
    return np.array(array, order="C")


def _stroke(image: Image) -> int:
    return max(1, round(image.shape[0] / 480))


def _blend(pixels: NDArray[np.uint8], colour: Colour | Array, alpha: float) -> Image:
    mixed = pixels.astype(np.float64) * (1.0 - alpha) + np.asarray(colour, dtype=np.float64) * alpha
    return np.rint(mixed).clip(0, 255).astype(np.uint8)


def _drawable(uv: Array) -> Array:
    """Pixels that OpenCV can hold; farther ones become NaN."""
    with np.errstate(invalid="ignore"):
        far = ~(np.abs(uv) < _MAX_PX).all(axis=-1)
    out = uv.copy()
    out[far] = np.nan
    return out


def _is_known(points: Array) -> Mask:
    """Which of (n, d) points have no NaN, (n,)."""
    return np.asarray(np.isfinite(points).all(axis=-1))


def _fixed_point(uv: NDArray[np.floating]) -> NDArray[np.int32]:
    return np.rint(np.asarray(uv) * 2**_SHIFT).astype(np.int32)


def _line(out: Image, ends: NDArray[np.int32], colour: Colour, width: int) -> None:
    cv2.polylines(out, [ends.reshape(-1, 1, 2)], False, colour, width, cv2.LINE_AA, _SHIFT)


def _world_line(out: Image, camera: Camera, start: Array, end: Array, colour: Colour, width: int) -> None:
    """A straight world line, curved as the lens bends it, cut where it leaves the model's validity."""
    n = max(2, int(np.linalg.norm(end - start) / 0.05) + 1)
    points = start + np.linspace(0.0, 1.0, n)[:, None] * (end - start)
    uv = _drawable(camera.project(points)[0])
    known = _is_known(uv)
    breaks = np.flatnonzero(np.diff(known.astype(np.int8))) + 1
    for run in np.split(np.arange(n), breaks):
        if len(run) > 1 and known[run[0]]:
            _line(out, _fixed_point(uv[run]), colour, width)


def _fill(out: Image, polygon: NDArray[np.int32], colour: Colour, alpha: float) -> None:
    h, w = out.shape[:2]
    lower = np.maximum(polygon.min(axis=0) // 2**_SHIFT - 1, 0)
    upper = np.minimum(polygon.max(axis=0) // 2**_SHIFT + 2, (w, h))
    if np.any(upper <= lower):
        return
    size = upper - lower
    inside = np.zeros((int(size[1]), int(size[0])), dtype=np.uint8)
    cv2.fillPoly(inside, [polygon - (lower * 2**_SHIFT).astype(np.int32)], 1, cv2.LINE_8, _SHIFT)
    window = out[lower[1] : upper[1], lower[0] : upper[0]]
    chosen = inside > 0
    window[chosen] = _blend(window[chosen], colour, alpha)


def _cone_surface(cone: Cone, eye: Array) -> Array | None:
    """Points on circles along a truncated cone, (n, 3) m; None when it is not finite or has no thickness."""
    p0, p1 = np.asarray(cone[0], dtype=np.float64), np.asarray(cone[1], dtype=np.float64)
    r0, r1 = float(cone[2]), float(cone[3])
    if not (np.all(np.isfinite(p0)) and np.all(np.isfinite(p1)) and np.isfinite(r0 + r1)):
        return None
    if min(r0, r1) < 0 or max(r0, r1) == 0:
        return None
    axis = p1 - p0
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        axis, r0, r1 = p0 - eye, max(r0, r1), max(r0, r1)
        length = float(np.linalg.norm(axis))
        if length < 1e-9:
            return None
        p1 = p0
    axis = axis / length
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    e1 = np.cross(axis, helper)
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(axis, e1)
    angle = np.linspace(0.0, 2 * np.pi, _CIRCLE_STEPS, endpoint=False)
    ring = np.cos(angle)[:, None] * e1 + np.sin(angle)[:, None] * e2
    s = np.linspace(0.0, 1.0, _CONE_STEPS)[:, None, None]
    points = p0 + s * (p1 - p0) + (r0 + s * (r1 - r0)) * ring
    return points.reshape(-1, 3)


def _splat(first: NDArray[np.int64], side: NDArray[np.int64], shape: tuple[int, int]) -> NDArray[np.int64]:
    """Index of the splat seen in each pixel, -1 for none; splats are ordered far to near."""
    h, w = shape
    owner = np.full(h * w, -1, dtype=np.int64)
    ends = np.cumsum(side**2)
    start = 0
    while start < len(side):
        used = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, used + _SPLATS_PER_CHUNK)))
        who = np.repeat(np.arange(start, stop), side[start:stop] ** 2)
        within = np.arange(len(who)) - (ends[who] - side[who] ** 2 - used)
        x = first[who, 0] + within % side[who]
        y = first[who, 1] + within // side[who]
        inside = (x >= 0) & (x < w) & (y >= 0) & (y < h)
        # numpy keeps the last value written to a repeated index, hence the nearest splat
        owner[y[inside] * w + x[inside]] = who[inside]
        start = stop
    return owner.reshape(h, w)


def _depth_colours(depth: Array) -> NDArray[np.uint8]:
    near, far = float(depth.min()), float(depth.max())
    closeness = (far - depth) / max(far - near, 0.3)
    grey = np.rint(255 * (0.12 + 0.86 * np.clip(closeness, 0, 1))).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(grey[:, None], cv2.COLORMAP_CIVIDIS)[:, 0, ::-1])


def _crease_shading(nearest: Array, voxel_size_m: float) -> Array:
    """Factor 0..1 per pixel: dark where neighbours stand much nearer (what shading does to a crease)."""
    h, w = nearest.shape
    reach = max(2, round(h / 240))
    padded = np.pad(nearest, reach, constant_values=np.inf)
    step = np.zeros((h, w))
    for dy, dx in ((-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, 1), (-1, 1), (1, -1)):
        y, x = reach + dy * reach, reach + dx * reach
        neighbour = padded[y : y + h, x : x + w]
        with np.errstate(invalid="ignore"):
            gap = np.where(np.isfinite(neighbour) & np.isfinite(nearest), nearest - neighbour, 0.0)
        # steps of one or two voxels are the grid itself, not a crease
        step += np.clip(gap - 2 * voxel_size_m, 0.0, 6 * voxel_size_m)
    return np.exp(-step / (8 * 2.0 * voxel_size_m))


def _multiples(lower: float, upper: float, spacing: float) -> Array:
    return np.arange(np.ceil(lower / spacing - 1e-9), np.floor(upper / spacing + 1e-9) + 1) * spacing

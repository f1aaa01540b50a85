"""Furniture from depth: a box that stands, a person that comes and goes, a floor, and mistakes of the sensor."""

from __future__ import annotations

import numpy as np
import pytest

from mocap.data import Camera, CameraRig, Occluders, VoxelGrid
from mocap.volume.occluders import CELL_PX, masks_by_cells
from mocap.volume.standing import StandingScene, nearest_of

GRID = VoxelGrid.from_bounds(np.array([-1.5, -1.5, 0.0]), np.array([1.5, 1.5, 2.0]), 0.05)
BOX = np.array([[-0.3, -0.4, 0.0], [0.3, 0.4, 0.8]])


def camera(name: str, x: float, y: float, size: tuple[int, int]) -> Camera:
    center = np.array([x, y, 1.6])
    ahead = np.array([0.0, 0.0, 0.5]) - center
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    R = np.array([right, np.cross(ahead, right), ahead])
    K = np.array([[300.0, 0, size[0] / 2 - 0.5], [0, 300.0, size[1] / 2 - 0.5], [0, 0, 1]])
    return Camera(name, size, K, np.zeros(4), R, -R @ center)


RIG = CameraRig((camera("a", 3.0, 0.3, (320, 240)), camera("b", 0.2, 3.1, (312, 248))))


def scene_depth(of: Camera, boxes: list[np.ndarray]) -> np.ndarray:
    """Depth (H, W) m of boxes on a floor."""
    w, h = of.size
    uv = np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1).astype(np.float64)
    rays = of.rays(uv)
    with np.errstate(divide="ignore", invalid="ignore"):
        nearest = np.where(rays[..., 2] < 0, -of.center[2] / rays[..., 2], 8.0)
        for low, high in boxes:
            t = np.sort(np.stack([(low - of.center) / rays, (high - of.center) / rays]), axis=0)
            enter, leave = t[0].max(axis=-1), t[1].min(axis=-1)
            nearest = np.where((enter <= leave) & (enter > 0), np.minimum(nearest, enter), nearest)
    return np.minimum(nearest * (rays @ of.R[2]), 8.0).astype(np.float32)


def learnt(
    boxes: list[np.ndarray], *, n: int = 12, noise_m: float = 0.01, mask: np.ndarray | None = None
) -> Occluders:
    scene, rng = StandingScene(RIG, ["a"], GRID), np.random.default_rng(2)
    masks = [np.zeros(c.size[::-1], dtype=np.bool_) for c in RIG]
    if mask is not None:
        masks[0] = mask
    for _ in range(n):
        depth = scene_depth(RIG["a"], boxes)
        scene.add(masks_by_cells(masks), [depth + rng.normal(0, noise_m, depth.shape).astype(np.float32)])
    return scene.occluders()


@pytest.mark.parametrize(
    ("name", "behind", "before"),
    [
        ("a", [-0.6, 0.0, 0.4], [0.7, 0.1, 0.5]),
        # The depth camera sees the box's side towards a, and its top: that stands in the way of b.
        ("b", [0.1, -0.5, 0.7], [0.1, 0.9, 0.6]),
    ],
)
def test_a_box_hides_what_is_behind_it_from_both_cameras(
    name: str, behind: list[float], before: list[float]
) -> None:
    hidden = learnt([BOX]).hides(RIG[name], np.array([behind, before, [0.0, 0.0, 1.6]]))
    assert hidden.tolist() == [True, False, False]


def test_an_empty_room_hides_nothing() -> None:
    assert learnt([]).is_empty
    assert learnt([], noise_m=0.02).is_empty


def test_a_person_who_never_moves_is_no_furniture() -> None:
    mask = scene_depth(RIG["a"], [BOX]) < scene_depth(RIG["a"], []) - 0.001
    assert learnt([BOX], mask=mask).is_empty


def test_few_looks_and_small_things_say_nothing() -> None:
    assert learnt([BOX], n=3).is_empty
    assert learnt([np.array([[0.0, 0.0, 0.3], [0.05, 0.05, 0.4]])]).is_empty


def test_pixels_without_reading_are_no_things() -> None:
    scene = StandingScene(RIG, ["a"], GRID)
    masks = masks_by_cells([np.zeros(c.size[::-1], dtype=np.bool_) for c in RIG])
    for _ in range(12):
        scene.add(masks, [np.zeros(RIG["a"].size[::-1], dtype=np.float32)])
    assert scene.occluders().is_empty


def test_the_nearer_of_two_maps_counts() -> None:
    first = Occluders({"a": np.array([[1.0, np.inf]], dtype=np.float32)}, CELL_PX)
    second = Occluders(
        {"a": np.array([[2.0, 3.0]], dtype=np.float32), "b": np.ones((1, 1), np.float32)}, CELL_PX
    )
    both = nearest_of(first, second)
    np.testing.assert_array_equal(both.depth_m["a"], [[1.0, 3.0]])
    assert set(both.depth_m) == {"a", "b"}
    assert nearest_of(Occluders({}, CELL_PX), second).depth_m.keys() == {"a", "b"}

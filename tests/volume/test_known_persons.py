"""Silhouettes beside keypoints: what they lack of known persons, and where nobody is."""

from __future__ import annotations

import numpy as np
import pytest
from keypoint_world import KeypointWorld, keypoint_world

from mocap.arrays import Array, Mask
from mocap.body.markers import marker_positions
from mocap.data import CameraRig, VoxelGrid
from mocap.data.keypoints import KEYPOINTS, NOBODY
from mocap.volume import Carver
from mocap.volume.known_persons import BesideSilhouettes, completed, flesh_along, missing_parts, nobodys
from mocap.volume.residuals import silhouette

THIN_M = 0.1  # side of the cubes that stand for flesh: half of the trunk's balls
LOW_M = 0.7  # what furniture hides: a little less than the legs


@pytest.fixture(scope="module")
def two() -> KeypointWorld:
    """Two persons 1.1 m apart before three cameras."""
    return keypoint_world(3, n_cameras=3, apart_m=1.1)


def points_of(world: KeypointWorld) -> Array:
    """Keypoints of all persons in the first frame, (P, K, 3) m."""
    return np.array([marker_positions(world.body, world.markers, s[:1])[0] for s in world.states])


def masks_of(rig: CameraRig, points: Array, above_m: float = -1.0) -> list[Mask]:
    """Silhouettes of persons, of what lies above a height."""
    centres = np.concatenate([flesh_along(person)[0] for person in points])
    return [silhouette(camera, centres[centres[:, 2] > above_m], THIN_M) for camera in rig]


def test_balls_lie_on_the_bones_with_both_ends() -> None:
    person = np.full((len(KEYPOINTS), 3), np.nan)
    person[KEYPOINTS.index("left_hip")] = [0.0, 0.1, 0.9]
    person[KEYPOINTS.index("left_knee")] = [0.0, 0.1, 0.5]
    centres, radii = flesh_along(person)
    np.testing.assert_allclose(centres[[0, -1]], [[0.0, 0.1, 0.9], [0.0, 0.1, 0.5]])
    assert np.diff(centres[:, 2]).min() > -0.02 - 1e-9
    assert len(centres) == len(radii)
    assert set(radii) == {0.08}
    empty, _ = flesh_along(np.full_like(person, np.nan))
    assert empty.shape == (0, 3)


def test_whole_silhouettes_lack_nobody(two: KeypointWorld) -> None:
    points = points_of(two)
    masks = masks_of(two.rig, points)
    assert missing_parts(masks, two.rig, points) == [None, None, None]
    assert missing_parts(masks, two.rig, NOBODY) == [None, None, None]
    for before, after in zip(masks, completed(masks, two.rig, points), strict=True):
        np.testing.assert_array_equal(before, after)


def test_legs_that_furniture_hides_from_one_camera_are_missing_there_alone(two: KeypointWorld) -> None:
    points, rig = points_of(two), two.rig
    masks = masks_of(rig, points)
    masks[1] = masks_of(rig, points, LOW_M)[1]
    missing = missing_parts(masks, rig, points)
    assert missing[0] is None
    assert missing[2] is None
    assert missing[1] is not None
    # The flesh of what is missing reaches back over the 6 cm beside what is seen, where nothing counts as missing.
    bones = silhouette(rig[1], np.concatenate([flesh_along(person)[0] for person in points]), 0.02)
    assert (bones & ~masks[1]).sum() > 500
    assert not (bones & ~masks[1] & ~missing[1]).any()
    grid = VoxelGrid.from_bounds(np.array([-1.5, -1.5, 0.0]), np.array([1.5, 2.5, 2.0]), 0.04)
    ankle = points[0, KEYPOINTS.index("left_ankle")]
    for own, has_it in ((masks, False), (completed(masks, rig, points), True)):
        hull = grid.centers(Carver(rig, grid).carve(own, n_faulty_views=0))
        assert (np.linalg.norm(hull - ankle, axis=1).min() < 0.06) == has_it


def test_a_limb_beside_the_silhouette_is_an_error_of_keypoints(two: KeypointWorld) -> None:
    """A forearm 4 cm beside what a camera shows is in it; one 20 cm beside is missing."""
    points, rig = points_of(two)[:1], two.rig
    masks = masks_of(rig, points)
    wrist = KEYPOINTS.index("right_wrist")
    toward = rig[0].R[0]  # to the right in the first picture
    for beside_m, is_missing in ((0.5 * THIN_M + 0.04, False), (0.5 * THIN_M + 0.2, True)):
        moved = points.copy()
        moved[0, wrist] += beside_m * toward * np.sign((moved[0, wrist] - moved[0].mean(axis=0)) @ toward)
        assert (missing_parts(masks, rig, moved)[0] is not None) == is_missing


def test_who_is_in_no_silhouette_is_of_another_clip(two: KeypointWorld) -> None:
    points, rig = points_of(two), two.rig
    masks = masks_of(rig, points[:1])
    elsewhere = points[:1] + np.array([0.9, -0.6, 0.0])
    assert missing_parts(masks, rig, elsewhere) == [None, None, None]
    # Of the two persons only the first is shown; nothing of the second is made up.
    assert missing_parts(masks, rig, points) == [None, None, None]
    empty = [np.zeros_like(mask) for mask in masks]
    assert missing_parts(empty, rig, points) == [None, None, None]


def test_where_silhouettes_of_two_known_persons_cross_nobody_is(two: KeypointWorld) -> None:
    points, rig = points_of(two), two.rig.subset(two.rig.names[:2])
    grid = VoxelGrid.from_bounds(np.array([-2.0, -2.0, 0.0]), np.array([2.0, 3.0, 2.0]), 0.04)
    voxels = Carver(rig, grid).carve(masks_of(rig, points), n_faulty_views=0)
    at = grid.centers(voxels)
    near = np.full(len(at), np.inf)
    for person in points:
        centres, radii = flesh_along(person)
        for centre, radius in zip(centres, radii, strict=True):
            near = np.minimum(near, np.linalg.norm(at - centre, axis=1) - radius)
    is_ghost = near > 0.5
    assert is_ghost.sum() > 500  # two cameras leave some
    gone = nobodys(voxels, grid, rig, points)
    np.testing.assert_array_equal(gone, near > 0.15)
    assert not nobodys(voxels, grid, rig, points[:1]).any()
    assert nobodys(voxels[:0], grid, rig, points).shape == (0,)


def test_somebody_without_keypoints_beside_two_known_persons_stays(two: KeypointWorld) -> None:
    points, rig = points_of(two), two.rig
    third = points[:1] + np.array([-0.9, 0.4, 0.0])
    grid = VoxelGrid.from_bounds(np.array([-2.5, -2.0, 0.0]), np.array([2.0, 3.0, 2.0]), 0.04)
    voxels = Carver(rig, grid).carve(masks_of(rig, np.concatenate([points, third])), n_faulty_views=0)
    gone = nobodys(voxels, grid, rig, points)
    centres = flesh_along(third[0])[0]
    own = np.array([np.linalg.norm(centres - at, axis=1).min() < 0.04 for at in grid.centers(voxels)])
    assert own.sum() > 100
    assert gone[own].mean() < 0.1


def test_distance_from_silhouettes_is_that_from_their_edge(two: KeypointWorld) -> None:
    """The left part of a picture is silhouette; a point to the right of its edge lies beside it, up to 30 cm."""
    camera = two.rig[0]
    width, height = camera.size
    edge = width // 2
    mask = np.zeros((height, width), dtype=np.bool_)
    mask[:, :edge] = True
    empty = np.zeros_like(mask)
    at_m = 3.0
    for beside_m, expected in ((-0.2, 0.0), (0.1, 0.1), (0.25, 0.25), (0.6, 0.3)):
        u = edge + beside_m * camera.K[0, 0] / at_m
        point = camera.unproject(np.array([[u, height / 2]]), np.array([at_m]))
        person = np.full((1, len(KEYPOINTS), 3), np.nan)
        person[0, 3] = point[0]
        seen = BesideSilhouettes.of([mask, empty, empty], two.rig)
        grain_m = 4 * at_m / camera.K[0, 0]  # every fourth pixel is looked at
        assert seen.mean_m(person) == pytest.approx(expected, abs=1.5 * grain_m)
        assert np.isnan(BesideSilhouettes.of([empty, empty, empty], two.rig).mean_m(person))
        assert np.isnan(seen.mean_m(NOBODY))


def test_keypoints_lie_in_the_silhouettes_of_their_moment(two: KeypointWorld) -> None:
    points = points_of(two)
    seen = BesideSilhouettes.of(masks_of(two.rig, points), two.rig)
    assert seen.mean_m(points) < 0.01
    assert seen.mean_m(points + np.array([0.3, -0.3, 0.0])) > 0.05

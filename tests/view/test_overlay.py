"""Overlays: what is drawn lies where the camera model says, inputs stay untouched, odd input is harmless."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest
import view_world as world

from mocap.data import LANDMARKS, Camera, Hull, VoxelGrid
from mocap.view.overlay import (
    SIDE_COLOURS,
    BodyPart,
    contact_sheet,
    crop,
    draw_body,
    draw_floor_grid,
    draw_hull,
    draw_label,
    draw_mask,
    draw_skeleton,
    person_colour,
    person_window,
)

GREY = 100
# Outlines, joints and anti-aliasing reach this far beyond what is filled
MARGIN_PX = 3


@pytest.fixture(scope="module")
def camera() -> Camera:
    return world.rig()["corner"]


@pytest.fixture
def image(camera: Camera) -> np.ndarray:
    return np.full((camera.size[1], camera.size[0], 3), GREY, dtype=np.uint8)


@pytest.fixture(scope="module")
def scene() -> tuple[np.ndarray, list[BodyPart], list[np.ndarray], Hull]:
    landmarks = world.pose(0.3)
    parts = world.body(landmarks)
    masks = [world.silhouette(c, parts) for c in world.rig()]
    return landmarks, parts, masks, world.hull(world.rig(), masks, 0.04)


def changed(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    return np.any(before != after, axis=2)


def test_no_function_modifies_its_input(camera, image, scene):
    landmarks, parts, masks, hull = scene
    image.flags.writeable = False
    before = image.copy()
    pictures = [
        draw_mask(image, masks[1]),
        draw_hull(image, camera, hull),
        draw_body(image, camera, parts),
        draw_skeleton(image, camera, landmarks, label="person 1"),
        draw_floor_grid(image, camera, ((-2, -2, 0), (2, 2, 2))),
        draw_label(image, "text", (20, 20)),
        contact_sheet([image], ["a"], 1, 200),
        crop(image, (0, 0, 50, 40)),
    ]
    assert np.array_equal(image, before)
    for picture in pictures:
        assert picture.dtype == np.uint8
        assert not np.shares_memory(picture, image)


def test_mask_is_tinted_inside_and_untouched_outside(image):
    mask = np.zeros(image.shape[:2], dtype=bool)
    mask[50:90, 60:130] = True
    out = draw_mask(image, mask, (0, 200, 100), 0.5)
    assert tuple(out[70, 90]) == (50, 150, 100)
    assert np.abs(out[50, 90].astype(int) - (0, 200, 100)).max() < 15  # the outline itself, anti-aliased
    outside = ~mask
    outside[48:92, 58:132] = False
    assert np.all(out[outside] == GREY)


def test_mask_of_wrong_size_is_refused(image):
    with pytest.raises(ValueError, match="mask has shape"):
        draw_mask(image, np.zeros((3, 4), dtype=bool))


def test_image_of_another_size_than_the_calibration_is_refused(camera, image):
    with pytest.raises(ValueError, match=r"corner.*calibration"):
        draw_body(image[:-10], camera, [])


def test_single_voxel_is_painted_where_the_camera_projects_it(camera, image):
    grid = VoxelGrid(np.array([-0.5, -0.5, 0.0]), (20, 21, 40), 0.05)
    for voxel in (0, 5000, grid.n_voxels - 1):
        hull = Hull(
            grid,
            np.array([voxel], np.int32),
            np.ones(1, bool),
            np.ones(1, np.uint8),
            np.full((1, 3), 250, np.uint8),
        )
        rows, columns = np.nonzero(changed(image, draw_hull(image, camera, hull, colour_by="rgb")))
        uv, _ = camera.project(hull.centers[0])
        assert np.hypot(columns.mean() - uv[0], rows.mean() - uv[1]) < 1.0
        # the cube's eight corners bound the splat
        corners = hull.centers[0] + 0.025 * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
        spread = np.ptp(camera.project(corners)[0], axis=0)
        assert np.ptp(columns) <= spread[0] + 2 * MARGIN_PX
        assert np.ptp(rows) <= spread[1] + 2 * MARGIN_PX


def test_hull_covers_its_silhouette_and_little_more(camera, image, scene):
    _, _, masks, hull = scene
    painted = changed(image, draw_hull(image, camera, hull))
    mask = masks[1]
    assert (painted & mask).sum() > 0.97 * mask.sum()
    distance = np.linalg.norm(hull.centers - camera.center, axis=1).min()
    reach = int(1.2 * hull.grid.voxel_size_m * camera.K[0, 0] / distance) + MARGIN_PX
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    assert not np.any(painted & (cv2.dilate(mask.astype(np.uint8), disc) == 0))


def test_near_voxel_hides_the_far_one(camera, image):
    towards = camera.rays(np.array([150.0, 120.0]))
    grid = VoxelGrid(np.array([-4.0, -4.0, -4.0]), (160, 160, 160), 0.05)
    near, far = (grid.voxels_of((camera.center + d * towards)[None])[0] for d in (1.5, 3.0))
    order = np.argsort([near, far])
    rgb = np.array([[255, 0, 0], [0, 0, 255]], np.uint8)[order]
    hull = Hull(grid, np.array([near, far], np.int32)[order], np.ones(2, bool), np.ones(2, np.uint8), rgb)
    out = draw_hull(image, camera, hull, colour_by="rgb", alpha=1.0)
    assert out[120, 150, 0] > 200
    assert out[120, 150, 2] < 50


def test_hull_colour_choice_is_checked(camera, image, scene):
    with pytest.raises(ValueError, match="colour_by"):
        draw_hull(image, camera, scene[3], colour_by="heat")


def test_cone_is_filled_along_its_axis_and_within_its_radius(camera, image):
    p0, p1, r0, r1 = np.array([0.3, -0.4, 0.4]), np.array([-0.2, 0.5, 1.5]), 0.16, 0.07
    out = draw_body(image, camera, [BodyPart("arm", "left", ((p0, p1, r0, r1),))])
    painted = changed(image, out)
    s = np.linspace(0.05, 0.95, 30)[:, None]
    axis, depth = camera.project(p0 + s * (p1 - p0))
    columns, rows = np.rint(axis).astype(int).T
    assert painted[rows, columns].all()
    v, u = np.nonzero(painted)
    distance = np.min(np.hypot(u[:, None] - axis[:, 0], v[:, None] - axis[:, 1]), axis=1)
    assert distance.max() < 1.25 * r0 * camera.K[0, 0] / depth.min() + MARGIN_PX
    middle = out[rows[15], columns[15]].astype(float)
    assert middle[2] > middle[0]  # left is blue


def test_body_agrees_with_balls_along_the_same_cones(camera, image, scene):
    _, parts, masks, _ = scene
    painted = changed(image, draw_body(image, camera, parts))
    mask = masks[1]
    overlap = (painted & mask).sum() / (painted | mask).sum()
    assert overlap > 0.85  # balls round off the ends that a truncated cone has not


def test_ball_is_round(camera, image):
    center = np.array([0.1, 0.2, 1.0])
    out = draw_body(image, camera, [BodyPart("head", "middle", ((center, center, 0.2, 0.2),))])
    v, u = np.nonzero(changed(image, out))
    uv, _ = camera.project(center)
    assert np.hypot(u.mean() - uv[0], v.mean() - uv[1]) < 1.5
    assert abs(np.ptp(u) - np.ptp(v)) <= 4


def test_far_limb_is_drawn_before_the_near_one(camera, image):
    towards = camera.rays(np.array([160.0, 120.0]))
    near, far = (camera.center + d * towards for d in (1.5, 3.0))
    parts = [
        BodyPart("near", "left", ((near, near, 0.1, 0.1),)),
        BodyPart("far", "right", ((far, far, 0.4, 0.4),)),
    ]
    out = draw_body(image, camera, parts, alpha=1.0)
    assert tuple(out[120, 160]) == SIDE_COLOURS["left"]
    assert np.array_equal(out, draw_body(image, camera, parts[::-1], alpha=1.0))


@pytest.mark.parametrize(
    "cone",
    [
        (np.full(3, np.nan), np.zeros(3), 0.1, 0.1),
        (np.zeros(3), np.ones(3), np.nan, 0.1),
        (np.zeros(3), np.ones(3), 0.0, 0.0),
        (np.zeros(3), np.ones(3), -0.1, 0.1),
    ],
    ids=["nan point", "nan radius", "no thickness", "negative radius"],
)
def test_useless_cones_draw_nothing(camera, image, cone):
    assert np.array_equal(draw_body(image, camera, [BodyPart("x", "left", (cone,))]), image)


def test_side_of_a_part_is_checked():
    with pytest.raises(ValueError, match="side"):
        BodyPart("arm", "lefft", ())  # type: ignore[arg-type]


def test_things_behind_the_camera_and_across_its_plane_are_safe(camera, image, scene):
    landmarks, _, _, hull = scene
    behind = camera.center - 2.0 * camera.R[2]
    part = BodyPart("x", "left", ((behind, behind + 0.1, 0.1, 0.1),))
    assert np.array_equal(draw_body(image, camera, [part]), image)
    assert np.array_equal(draw_skeleton(image, camera, landmarks * 0 + behind), image)
    across = BodyPart("x", "left", ((behind, camera.center + 1.0 * camera.R[2], 0.2, 0.2),))
    assert draw_body(image, camera, [across]).shape == image.shape
    at_eye = BodyPart("x", "left", ((camera.center, camera.center, 0.1, 0.1),))
    assert draw_body(image, camera, [at_eye]).shape == image.shape
    turned = Camera(
        "away", camera.size, camera.K, camera.dist, np.diag([-1.0, 1, -1]) @ camera.R, camera.t * 0 + 50
    )
    assert draw_hull(image, turned, hull).shape == image.shape


def test_empty_input_draws_nothing(camera, image, scene):
    nothing = scene[3].select(np.zeros(len(scene[3]), bool))
    assert np.array_equal(draw_hull(image, camera, nothing), image)
    assert np.array_equal(draw_body(image, camera, []), image)
    assert np.array_equal(draw_body(image, camera, [BodyPart("x", "left", ())]), image)
    assert np.array_equal(draw_mask(image, np.zeros(image.shape[:2], bool)), image)
    assert np.array_equal(draw_skeleton(image, camera, np.full((15, 3), np.nan), label="person 1"), image)
    assert np.array_equal(draw_label(image, "", (10, 10)), image)
    assert contact_sheet([], [], 3, 300).shape[1] == 300


def test_joints_lie_on_the_projection_and_unobserved_ones_are_hollow(camera, image, scene):
    landmarks = scene[0]
    observed = np.ones(15, bool)
    wrist = LANDMARKS.index("left_wrist")
    observed[wrist] = False
    seen = draw_skeleton(image, camera, landmarks)
    partly = draw_skeleton(image, camera, landmarks, observed)
    uv, _ = camera.project(landmarks)
    for j in (LANDMARKS.index("right_ankle"), LANDMARKS.index("head")):
        u, v = np.rint(uv[j]).astype(int)
        side = "right" if LANDMARKS[j].startswith("right") else "middle"
        assert np.abs(seen[v, u].astype(int) - SIDE_COLOURS[side]).max() < 40
    u, v = np.rint(uv[wrist]).astype(int)
    assert np.abs(seen[v, u].astype(int) - SIDE_COLOURS["left"]).max() < 40
    assert partly[v, u].max() < 80


def test_one_unknown_joint_leaves_the_others(camera, image, scene):
    landmarks = scene[0].copy()
    landmarks[LANDMARKS.index("left_elbow")] = np.nan
    full, part = (changed(image, draw_skeleton(image, camera, x)) for x in (scene[0], landmarks))
    assert 0 < part.sum() < full.sum()
    with pytest.raises(ValueError, match="3 landmarks, expected 15"):
        draw_skeleton(image, camera, landmarks[:3])


def test_floor_grid_follows_the_distorted_lines(camera, image):
    out = draw_floor_grid(image, camera, ((-2.0, -1.5, 0), (2.0, 1.5, 2)))
    painted = changed(image, out)
    for x in (-1.0, 0.0, 1.0):
        line = np.column_stack([np.full(40, x), np.linspace(-1.4, 1.4, 40), np.zeros(40)])
        uv, _ = camera.project(line)
        u, v = np.rint(uv[camera.contains(uv)]).astype(int).T
        assert len(u) > 10
        assert painted[v, u].all()
    with pytest.raises(ValueError, match="empty"):
        draw_floor_grid(image, camera, ((1.0, 0.0, 0.0), (1.0, 2.0, 2.0)))


def test_labels_stay_inside_the_picture(image):
    for at in ((-500.0, -500.0), (5000.0, 5000.0), (310.0, 5.0)):
        out = draw_label(image, "person 1 \N{GREEK SMALL LETTER ALPHA}", at, centred=True)
        assert changed(image, out).sum() > 50
    assert np.array_equal(draw_label(image, "x", (np.nan, 3.0)), image)


def test_contact_sheet_places_images_in_rows():
    images = [np.full((30 + i, 40, 3), 40 * i + 60, np.uint8) for i in range(4)]
    sheet = contact_sheet(images, [], 3, 306, gap=6)
    cell = (306 - 4 * 6) // 3
    assert sheet.shape[1] == 306
    for i, image in enumerate(images):
        x = 6 + (i % 3) * (cell + 6) + cell // 2
        y = 6 + 20 if i < 3 else sheet.shape[0] - 6 - 20
        assert tuple(sheet[y, x]) == tuple(image[0, 0])
    with pytest.raises(ValueError, match="labels"):
        contact_sheet(images, ["one"], 3, 306)
    with pytest.raises(ValueError, match="columns"):
        contact_sheet(images, [], 0, 306)


def test_window_shows_the_person_and_stays_in_the_picture(camera, scene):
    landmarks = scene[0]
    left, top, right, bottom = person_window(camera, landmarks)
    w, h = camera.size
    assert 0 <= left < right <= w
    assert 0 <= top < bottom <= h
    uv, _ = camera.project(landmarks)
    assert np.all((uv >= (left, top)) & (uv < (right, bottom)))
    assert person_window(camera, np.full((3, 3), np.nan)) == (0, 0, w, h)
    with pytest.raises(ValueError, match="outside"):
        crop(np.zeros((9, 9, 3), np.uint8), (20, 20, 30, 30))


def test_crop_scales():
    image = np.arange(10 * 12 * 3, dtype=np.uint8).reshape(10, 12, 3)
    assert np.array_equal(crop(image, (2, 3, 8, 7)), image[3:7, 2:8])
    assert crop(image, (2, 3, 8, 7), scale=2.5).shape == (10, 15, 3)


def test_colours_of_persons_repeat_but_neighbours_differ():
    colours = [person_colour(i) for i in range(1, 15)]
    assert all(a != b for a, b in pairwise(colours))

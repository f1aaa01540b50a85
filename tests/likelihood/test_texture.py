"""Texture: the colours of places of a body, learnt from pictures and poses, and how they pull a pose that is off."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from flesh_voxels import make_flesh
from painted_body import cameras_around, crops_of, painted

from mocap.body import cones_of, joint_transforms, neutral_state
from mocap.body.flesh import cone_distances
from mocap.data import Camera
from mocap.filters.refine import RefineSettings, refine
from mocap.likelihood.residuals import (
    ColourCounts,
    Crops,
    Texture,
    TextureProblem,
    TextureSettings,
    person_crops,
    pinhole_view,
    places_of,
)

FLESH, RIG = make_flesh("anthropometric", 1.74, 0.04), cameras_around()
SETTINGS = TextureSettings()
PLACES = places_of(FLESH.body, FLESH.table, 500)
Frame = tuple[Crops, np.ndarray]


def counts_of(frames: list[Frame], settings: TextureSettings = SETTINGS) -> ColourCounts:
    counts = ColourCounts(FLESH.body, PLACES, np.zeros((len(PLACES.joint), 3, 256), np.int64), settings)
    for crops, state in frames:
        counts.see(crops, state)
    return counts


def poses(n: int) -> list[np.ndarray]:
    """Arms away from the trunk, all limbs and the direction a little different every time."""
    rng = np.random.default_rng(4)
    names = FLESH.body.layout.names
    found = []
    for _ in range(n):
        state = neutral_state(FLESH.body) + 0.1 * rng.normal(size=len(names)) * ~FLESH.body.is_position
        state[2] = 1.0
        state[names.index("right_shoulder_x")] = 0.6
        state[names.index("left_shoulder_x")] = -0.6
        state[FLESH.body.yaw_column] = rng.uniform(-3, 3)
        found.append(np.clip(state, FLESH.body.layout.lower, FLESH.body.layout.upper))
    return found


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return [(crops_of(FLESH, state, RIG, painted(FLESH, state, RIG)), state) for state in poses(9)]


@pytest.fixture(scope="module")
def texture(frames: list[Frame]) -> Texture:
    return counts_of(frames[:-1], replace(SETTINGS, least_seen=4)).texture


def in_world(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places and normals (M, 3) of the body in a pose."""
    R, t = joint_transforms(FLESH.body, state[None])
    R, t = R[0, PLACES.joint], t[0, PLACES.joint]
    return np.einsum("mij,mj->mi", R, PLACES.points) + t, np.einsum("mij,mj->mi", R, PLACES.normals)


def test_places_lie_on_the_flesh_and_normals_point_out_of_it() -> None:
    state = poses(1)[0]
    points, normals = in_world(state)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-9)
    start, end = cones_of(FLESH.body, state)
    cones = FLESH.body.cones
    for m in range(0, len(points), 5):
        own = np.flatnonzero(cones.joint == PLACES.joint[m])
        at = points[m] + np.array([0.0, 0.01, -0.01])[:, None] * normals[m]
        distance = cone_distances(at, start[own], end[own], cones.radii[own], True)
        k = np.abs(distance[0]).argmin()
        np.testing.assert_allclose(distance[:, k], [0.0, 0.01, -0.01], atol=3e-3)


def test_a_place_is_seen_where_it_faces_a_camera_and_nothing_is_before_it(frames: list[Frame]) -> None:
    crops, state = frames[0]
    seen = TextureProblem.about(counts_of([]).texture, crops, state).seen
    points, normals = in_world(state)
    start, end = cones_of(FLESH.body, state)
    radii, wrong = FLESH.body.cones.radii, 0
    for c, camera in enumerate(RIG):
        away = points - camera.center
        distance = np.linalg.norm(away, axis=1)
        away /= distance[:, None]
        faces = -(away * normals).sum(axis=1) > SETTINGS.least_cosine
        for m in range(len(points)):
            steps = np.arange(1.5, distance[m] - SETTINGS.slack_m, 0.01)
            before = camera.center + steps[:, None] * away[m]
            is_free = not (cone_distances(before, start, end, radii, True) <= 0).any()
            wrong += bool(seen[c, m]) != bool(faces[m] and is_free)
    # Cones taper, which where a ray enters leaves out.
    assert wrong < 0.01 * seen.size
    assert 0.1 < seen.mean() < 0.5


def at_pixel(crops: Crops, c: int, point: np.ndarray) -> tuple[float, float]:
    """Column and row in the crop of a camera where a point lies."""
    x = crops.R[c] @ point + crops.t[c]
    u, v = crops.focal[c] * x[:2] / x[2] + crops.middle[c]
    return float(u), float(v)


def piece(crops: Crops, c: int) -> np.ndarray:
    """The crop (H, W, 3) of a camera."""
    height, width = crops.shape[c]
    return crops.colours[crops.first[c] : crops.first[c] + height * width].reshape(height, width, 3)


def test_the_cost_is_that_of_the_colours_where_places_lie(frames: list[Frame], texture: Texture) -> None:
    crops, state = frames[-1]
    problem = TextureProblem.about(texture, crops, state, 3.0)
    moved = state.copy()
    moved[FLESH.body.yaw_column] += 0.1
    points, _ = in_world(moved)
    terms, expected = texture.terms, 0.0
    for c, m in zip(*np.nonzero(problem.seen), strict=True):
        if terms.inverse[m, 0] > 0:
            u, v = at_pixel(crops, c, points[m])
            colour = cv2.remap(
                piece(crops, c).astype(np.float32), np.float32([[u]]), np.float32([[v]]), cv2.INTER_LINEAR
            )[0, 0]
            q = (colour - terms.mean[m]) * terms.inverse[m] / terms.scale
            expected += float((0.5 * terms.scale**2 * q**2 / (1 + q**2)).sum())
    cost, _, _ = problem.normal_equations(moved)
    # cv2 weighs neighbours in steps of 1/32 of a pixel.
    assert cost == pytest.approx(3.0 * expected / problem.seen.sum(), rel=0.005)


def test_a_place_that_has_left_the_picture_costs_what_a_colour_can_at_most(
    frames: list[Frame], texture: Texture
) -> None:
    crops, state = frames[-1]
    problem = TextureProblem.about(texture, crops, state)
    gone = state.copy()
    gone[2] += 50.0
    cost, H, g = problem.normal_equations(gone)
    known = problem.seen[:, texture.terms.inverse[:, 0] > 0].sum()
    assert cost == pytest.approx(3 * 0.5 * SETTINGS.scale**2 * known / problem.seen.sum())
    assert not H.any()
    assert not g.any()


def test_the_gradient_is_that_of_the_cost(frames: list[Frame], texture: Texture) -> None:
    crops, state = frames[-1]
    whole = TextureProblem.about(texture, crops, state, 50.0)
    rng = np.random.default_rng(2)
    along = rng.normal(size=len(state)) * np.where(FLESH.body.is_position, 0.1, 0.3)
    at = state + 0.02 * rng.normal(size=len(state))
    H, g = np.zeros((len(state),) * 2), np.zeros(len(state))
    slopes, pulls = [], []
    for c, m in zip(*np.nonzero(whole.seen), strict=True):
        alone = np.zeros_like(whole.seen)
        alone[c, m] = True
        problem = replace(whole, seen=alone)
        _, own_H, own_g = problem.normal_equations(at)
        H, g = H + own_H, g + own_g
        if texture.terms.inverse[m, 0] > 0:
            ends = (problem.normal_equations(at + sign * 1e-5 * along)[0] for sign in (1, -1))
            slopes.append(float(np.subtract(*ends)) / 2e-5)
            pulls.append(float(own_g @ along))
    # A place that crosses from one pixel to the next has two slopes.
    near = np.isclose(slopes, pulls, rtol=1e-3, atol=1e-3 * np.abs(pulls).max())
    assert len(near) > 300
    assert near.mean() > 0.99
    _, whole_H, whole_g = whole.normal_equations(at)
    n = whole.seen.sum()
    np.testing.assert_allclose(H / n, whole_H, atol=1e-9 * np.abs(H).max())
    np.testing.assert_allclose(g / n, whole_g, atol=1e-9 * np.abs(g).max())


def test_a_body_that_is_turned_inside_its_outlines_is_turned_back(
    frames: list[Frame], texture: Texture
) -> None:
    crops, state = frames[-1]
    off = state.copy()
    off[FLESH.body.yaw_column] += 0.1
    off[2] += 0.02
    prior = np.where(FLESH.body.is_position, 0.1, 0.5)
    found = refine(
        TextureProblem.about(texture, crops, off, 1e4),
        off,
        RefineSettings(prior, residual_std_m=1.0, n_iterations=20),
    )[0]
    assert abs(found[FLESH.body.yaw_column] - state[FLESH.body.yaw_column]) < 0.02
    assert abs(found[2] - state[2]) < 0.005


def test_a_part_is_compared_where_two_cameras_see_a_place_of_known_colour(
    frames: list[Frame], texture: Texture
) -> None:
    crops, state = frames[-1]
    problem = TextureProblem.about(texture, crops, state)
    part, known = FLESH.body.part_of_joint[PLACES.joint], texture.terms.inverse.any(axis=1)
    alone = np.zeros_like(problem.seen)
    alone[0] = problem.seen[0]
    seen_twice, arm = alone.copy(), FLESH.body.layout.parts.index("left_upper_arm")
    seen_twice[1, part == arm] = True
    assert problem.compared.all()
    assert not replace(problem, seen=alone).compared.any(), "one camera does not tell how far away"
    assert seen_twice[0, (part == arm) & known].any()
    assert np.flatnonzero(replace(problem, seen=seen_twice).compared).tolist() == [arm]
    unknown = replace(texture, terms=texture.terms._replace(inverse=0 * texture.terms.inverse))
    assert not replace(problem, texture=unknown).compared.any()


def test_median_colours_and_what_differs_from_them() -> None:
    rng = np.random.default_rng(1)
    counts = counts_of([])
    seen = rng.integers(0, 256, (len(PLACES.joint), 3, 11))
    seen[5] = 255  # at the end of the scale
    seen[6, 1] = 0
    for k in range(11):
        np.add.at(counts.counts, (*np.indices(seen.shape[:2]), seen[..., k]), 1)
    counts.counts[9] = 0
    np.add.at(counts.counts, (9, [0, 1, 2], 7), SETTINGS.least_seen - 1)
    terms = counts.texture.terms
    median = np.median(seen, axis=2)
    spread = 1.4826 * np.median(np.abs(seen - median[..., None]), axis=2)
    expected = 1 / np.sqrt(spread**2 + np.square(SETTINGS.least_std))
    known = np.arange(len(median)) != 9
    np.testing.assert_array_equal(terms.mean[known], median[known])
    np.testing.assert_allclose(terms.inverse[known], expected[known])
    assert not terms.inverse[9].any()


def test_what_is_seen_by_mistake_is_not_learnt(frames: list[Frame]) -> None:
    crops, state = frames[0]
    white = crops._replace(colours=np.full_like(crops.colours, 255))
    clean = counts_of([(crops, state)] * 12).texture
    dirty = counts_of([*[(crops, state)] * 12, *[(white, state)] * 3]).texture
    known = clean.terms.inverse[:, 0] > 0
    assert known.sum() > 150
    assert np.median(np.abs(clean.terms.mean - dirty.terms.mean)[known]) < 3


def test_what_is_not_known_does_not_pull(frames: list[Frame]) -> None:
    crops, state = frames[0]
    cost, H, g = TextureProblem.about(counts_of([]).texture, crops, state).normal_equations(state)
    assert cost == 0.0
    assert not H.any()
    assert not g.any()


# What is kept of pictures.


def one_camera(dist: tuple[float, ...] = (0.0,) * 5, zoom: int = 1) -> Camera:
    """Pictures of 320 x 240 pixels, each of which `zoom` has as many more of either way."""
    K = np.array([[200.0 * zoom, 0, 160.0 * zoom - 0.5], [0, 200.0 * zoom, 120.0 * zoom - 0.5], [0, 0, 1]])
    return Camera("c", (320 * zoom, 240 * zoom), K, np.array(dist), np.eye(3), np.zeros(3))


ZOOMS = {1: 1, 4: 2, 12: 8}  # and every how many pixels of a picture are left in a crop


HULL = np.array([[x, y, 4.0] for x in (-0.3, 0.0, 0.3) for y in (-0.8, 0.0, 0.8)])


def crops_in(camera: Camera, picture: np.ndarray, **options: object) -> Crops:
    given: dict[str, object] = {"is_used": [True], "hidden": [None]} | options
    others = given.pop("others", np.zeros((0, 3)))
    return person_crops([pinhole_view(camera)], [picture], HULL, others, **given)  # type: ignore[arg-type]


@pytest.mark.parametrize("zoom", ZOOMS)
@pytest.mark.parametrize("dist", [(0.0,) * 5, (-0.25, 0.08, 0.003, -0.002, 0.0)])
def test_a_bright_spot_lies_in_the_crop_where_a_pinhole_sees_it(dist: tuple[float, ...], zoom: int) -> None:
    camera = one_camera(dist, zoom)
    spot = np.array([0.31, -0.77, 4.1])
    picture = np.zeros((240 * zoom, 320 * zoom, 3), dtype=np.uint8)
    u, v = camera.project(spot)[0]
    cv2.circle(picture, (round(u), round(v)), 3 * zoom, (255, 255, 255), -1)
    crops = crops_in(camera, picture)
    luma = piece(crops, 0)[..., 0].astype(float)
    rows, columns = np.indices(luma.shape)
    middle = np.array([(columns * luma).sum(), (rows * luma).sum()]) / luma.sum()
    np.testing.assert_allclose(middle, at_pixel(crops, 0, spot), atol=0.8 / ZOOMS[zoom])
    # The hull with 20 cm around it, 50 px per m.
    expected = np.array([100, 50]) * zoom / ZOOMS[zoom]
    np.testing.assert_allclose(crops.shape[0], expected, atol=4 * zoom / ZOOMS[zoom])


@pytest.mark.parametrize("zoom", ZOOMS)
def test_pictures_are_smoothed_by_as_much_as_is_set_at_the_person(zoom: int) -> None:
    picture = np.zeros((240 * zoom, 320 * zoom, 3), dtype=np.uint8)
    picture[:, 160 * zoom :] = 200
    luma = piece(crops_in(one_camera(zoom=zoom), picture), 0)[..., 0].astype(float)
    rise = np.diff(luma[luma.shape[0] // 2])
    at = np.arange(len(rise))
    centre = (rise * at).sum() / rise.sum()
    std_px = np.sqrt((rise * (at - centre) ** 2).sum() / rise.sum())
    assert std_px == pytest.approx(SETTINGS.blur_m * 200 / 4.0 * zoom / ZOOMS[zoom], rel=0.25)


def test_where_others_or_furniture_may_be_nothing_is_clear() -> None:
    picture = np.zeros((240, 320, 3), dtype=np.uint8)
    hidden = np.zeros((240, 320), dtype=np.bool_)
    hidden[150:] = True
    crops = crops_in(one_camera(), picture, hidden=[hidden], others=np.array([[0.1, 0.0, 3.0]]))
    clear = crops.is_clear.reshape(crops.shape[0])
    low = at_pixel(crops, 0, np.array([0.0, 0.0, 1.0]))  # the middle of the picture
    row_150 = round(low[1] + 150 - 119.5)
    assert not clear[row_150:].any()
    other = [round(x) for x in at_pixel(crops, 0, np.array([0.1, 0.0, 3.0]))]
    reach = int(np.ceil(SETTINGS.apart_m * 200 / 4.0))
    near = np.zeros_like(clear)
    near[other[1] - reach : other[1] + reach + 1, other[0] - reach : other[0] + reach + 1] = True
    np.testing.assert_array_equal(~clear[:row_150], near[:row_150])


def test_a_camera_that_cannot_be_trusted_shows_nothing() -> None:
    picture = np.full((240, 320, 3), 99, dtype=np.uint8)
    crops = crops_in(one_camera(), picture, is_used=[False])
    assert not crops.shape.any()
    assert not len(crops.colours)

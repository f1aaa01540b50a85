"""Outline residuals: rays through true outlines touch the body, gradients, and refinement from silhouettes alone."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from flesh_voxels import Flesh
from outline_world import (
    ANGLES_DEG,
    FOCAL,
    N_POINTS,
    H,
    W,
    bent,
    landmark_cloud,
    make_rig,
    outlines_of,
    problem_of,
    silhouette,
)

from mocap.body import cones_of, joint_transforms, landmarks_of, neutral_state
from mocap.data import CameraRig
from mocap.filters.refine import RefineSettings, refine
from mocap.geometry._pixel_kernels import extent_of
from mocap.likelihood.residuals import (
    OutlineFitSettings,
    OutlineProblem,
    Outlines,
    SumProblem,
    person_outlines,
    pinhole_view,
)
from mocap.likelihood.residuals import _outline_kernels as kernels
from mocap.likelihood.residuals import outlines as outlines_module

STEP = 1e-6
# A pixel is 2 cm wide at the person: half of it is the most an exact outline may miss.
PIXEL_M = 0.021


@pytest.fixture(scope="module")
def rig() -> CameraRig:
    return make_rig()


@pytest.fixture(scope="module")
def seen(flesh: Flesh, rig: CameraRig) -> Outlines:
    return outlines_of(flesh, bent(flesh), rig)


def residuals(flesh: Flesh, outlines: Outlines, state: np.ndarray) -> np.ndarray:
    """Distances of all outline rays to the nearest cone, written plainly."""
    start, end = cones_of(flesh.body, state)
    found = np.empty(outlines.n_points)
    for i in range(outlines.n_points):
        s = np.linspace(0.0, 1.0, 401)
        axis = start[:, None] + s[None, :, None] * (end - start)[:, None] - outlines.origins[i]
        along = axis @ outlines.directions[i]
        away = along[..., None] * outlines.directions[i] - axis
        length = np.linalg.norm(away, axis=2)
        radii = flesh.body.cones.radii
        radius = radii[:, :1] + s * (radii[:, 1:] - radii[:, :1])
        nearest = length.argmin(axis=1)
        rows = np.arange(len(start))
        r = (length - radius)[rows, nearest]
        cosine = (away[rows, nearest] @ outlines.normals[i]) / length[rows, nearest]
        found[i] = r[np.argmin(r**2 + (0.06 * (1 - cosine)) ** 2)]
    return found


def test_rays_through_true_outlines_touch_the_flesh(flesh: Flesh, seen: Outlines) -> None:
    r = residuals(flesh, seen, bent(flesh))
    assert seen.n_points > 0.8 * N_POINTS * len(ANGLES_DEG)
    assert np.median(np.abs(r)) < 0.5 * PIXEL_M
    assert np.quantile(np.abs(r), 0.95) < 1.5 * PIXEL_M


def test_the_kernel_finds_the_same_distances_as_plain_numpy(flesh: Flesh, seen: Outlines) -> None:
    state = bent(flesh)
    state[:3] += (0.03, -0.02, 0.01)
    settings = OutlineFitSettings(flesh_gain=0.0)
    cost, _, _ = problem_of(flesh, seen, settings).normal_equations(state)
    q = residuals(flesh, seen, state) / settings.scale_m
    expected = (0.5 * settings.scale_m**2 * q**2 / (1 + q**2)).sum()
    assert cost == pytest.approx(expected, rel=2e-3)


def test_normals_point_out_of_the_body_and_across_the_ray(flesh: Flesh, seen: Outlines) -> None:
    assert np.abs(np.linalg.norm(seen.normals, axis=1) - 1).max() < 1e-9
    assert np.abs((seen.normals * seen.directions).sum(axis=1)).max() < 1e-9
    shrunk = residuals(flesh, replace(seen, origins=seen.origins - 0.03 * seen.normals), bent(flesh))
    grown = residuals(flesh, replace(seen, origins=seen.origins + 0.03 * seen.normals), bent(flesh))
    assert np.median(grown) - np.median(shrunk) == pytest.approx(0.06, abs=0.01)


def test_the_gradient_is_that_of_the_cost(flesh: Flesh, seen: Outlines) -> None:
    state = bent(flesh)
    rng = np.random.default_rng(3)
    state += 0.01 * rng.normal(size=len(state))
    # Without the factor of the normals' agreement, and with scales so wide that the weights are 1.
    settings = OutlineFitSettings(scale_m=50.0, normal_cost_m=0.0, flesh_scale_m=50.0)
    problem = problem_of(flesh, seen, settings)
    _, H, g = problem.normal_equations(state)
    assert np.allclose(H, H.T)
    assert np.linalg.eigvalsh(H).min() > -1e-9
    numeric = np.array(
        [
            (problem.normal_equations(state + e)[0] - problem.normal_equations(state - e)[0]) / (2 * STEP)
            for e in STEP * np.eye(len(state))
        ]
    )
    # Rays whose cone axis is turned away get no pull by design; the nearest pixel jumps: a few per cent.
    assert np.abs(numeric - g).max() < 0.08 * np.abs(g).max()


def test_a_silhouette_that_ends_at_furniture_neither_bounds_the_body_nor_pulls_it(
    flesh: Flesh, seen: Outlines, rig: CameraRig
) -> None:
    truth, row = bent(flesh), 95
    views, points = [pinhole_view(c) for c in rig], landmark_cloud(flesh, truth)
    masks, hidden = [], []
    for i, camera in enumerate(rig):
        behind = np.zeros((H, W), dtype=np.bool_)
        behind[row:] = i < 3
        masks.append(silhouette(flesh, truth, camera) & ~behind)
        hidden.append(behind if i < 3 else None)
    blind = person_outlines(views, rig, masks, points, n_points=N_POINTS)
    aware = person_outlines(views, rig, masks, points, n_points=N_POINTS, hidden=hidden)
    for c, camera in enumerate(list(rig)[:3]):
        own = aware.camera == c
        uv, _ = camera.project(camera.center + 2.9 * aware.directions[own])
        assert own.sum() > 0.5 * N_POINTS
        assert uv[:, 1].max() < row - 6
    costs = [
        problem_of(flesh, outlines).normal_equations(truth)[0] / outlines.n_points
        for outlines in (seen, aware, blind)
    ]
    assert costs[1] < 1.5 * costs[0]
    assert costs[2] > 3.0 * costs[0]


def test_silhouettes_alone_bring_a_disturbed_pose_back(flesh: Flesh, seen: Outlines) -> None:
    truth = bent(flesh)
    state = truth.copy()
    state[:3] += (0.05, -0.04, 0.02)
    state[3:] += 0.08 * np.random.default_rng(1).normal(size=len(state) - 3)
    settings = RefineSettings(prior_std=np.where(np.arange(len(state)) < 3, 0.1, 0.5), n_iterations=30)
    found, _ = refine(problem_of(flesh, seen), state, settings)

    def error(s: np.ndarray) -> float:
        d = landmarks_of(flesh.body, s[None])[0] - landmarks_of(flesh.body, truth[None])[0]
        return float(np.linalg.norm(d, axis=1).mean())

    assert error(state) > 0.05
    assert error(found) < 0.015


def test_a_lens_changes_the_masks_but_not_the_rays(flesh: Flesh) -> None:
    state = bent(flesh)
    bowed = outlines_of(flesh, state, make_rig((-0.18, 0.03, 0.0, 0.0)))
    r = residuals(flesh, bowed, state)
    assert np.median(np.abs(r)) < 0.5 * PIXEL_M


def test_the_order_of_cameras_is_irrelevant(flesh: Flesh, seen: Outlines, rig: CameraRig) -> None:
    turned = CameraRig(tuple(reversed(list(rig))))
    again = outlines_of(flesh, bent(flesh), turned)
    state = bent(flesh) + 0.02
    a, b = (problem_of(flesh, o).normal_equations(state) for o in (seen, again))
    assert a[0] == pytest.approx(b[0], rel=1e-9)
    assert np.allclose(a[1], b[1])


def test_flesh_outside_a_silhouette_costs_and_flesh_inside_does_not(flesh: Flesh, seen: Outlines) -> None:
    only = OutlineFitSettings(flesh_gain=1.0)
    without = OutlineFitSettings(flesh_gain=0.0)

    def outside(state: np.ndarray) -> float:
        a, b = (problem_of(flesh, seen, s).normal_equations(state)[0] for s in (only, without))
        return a - b

    away = bent(flesh)
    away[0] += 0.3
    assert outside(away) > 20 * outside(bent(flesh))


def test_flesh_beyond_a_straight_border_costs_its_distance_to_the_border(flesh: Flesh) -> None:
    """A silhouette of all columns up to one: its border lies half a pixel beyond the centres of the last column."""
    camera = next(iter(make_rig()))
    last = W // 2
    columns = np.minimum(np.arange(W), last)
    nearest = (np.arange(H)[:, None] * W + columns).astype(np.int32)
    ray = np.array([[1.0, 0.0, 0.0]])
    outlines = Outlines(
        rig=CameraRig((camera,)),
        origins=np.array([[0.0, 0.0, 50.0]]),
        directions=ray,
        normals=ray[:, [1, 2, 0]],
        camera=np.zeros(1, dtype=np.int64),
        nearest=nearest.ravel(),
        first=np.zeros(1, dtype=np.int64),
        shape=np.array([[H, W]]),
        corner=np.zeros((1, 2), dtype=np.int64),
    )
    state = bent(flesh)
    settings = OutlineFitSettings(flesh_scale_m=0.3)
    problem = problem_of(flesh, outlines, settings)
    without = problem_of(flesh, outlines, replace(settings, flesh_gain=0.0))
    cost = problem.normal_equations(state)[0] - without.normal_equations(state)[0]
    R, t = joint_transforms(flesh.body, state[None])
    local, joint = problem.terms.flesh
    points = np.einsum("nrc,nc->nr", R[0, joint], local) + t[0, joint]
    uv, depth = camera.project(points)
    # Nearest is the last column of the pixel's own row.
    off = np.hypot(uv[:, 0] - last, uv[:, 1] - np.floor(uv[:, 1] + 0.5))
    off = off[uv[:, 0] > last + 1.0], depth[uv[:, 0] > last + 1.0]
    assert len(off[0]) > 40
    q = (off[0] - 0.5) * off[1] / FOCAL / 0.3
    gain = problem.terms.pull.flesh_gain
    assert cost == pytest.approx((0.5 * gain * 0.3**2 * q**2 / (1 + q**2)).sum(), rel=0.01)


def test_outlines_beside_another_person_do_not_count(flesh: Flesh, seen: Outlines, rig: CameraRig) -> None:
    state = bent(flesh)
    elbow = landmarks_of(flesh.body, state[None])[0, 4]
    other = elbow + 0.02 * np.random.default_rng(0).normal(size=(40, 3))
    fewer = outlines_of(flesh, state, rig, other, scale=10_000)
    all_of_them = outlines_of(flesh, state, rig, scale=10_000)
    assert 0 < fewer.n_points < all_of_them.n_points
    # No ray that is left passes near the other person.
    away = np.cross(elbow - fewer.origins, fewer.directions)
    assert np.linalg.norm(away, axis=1).min() > 0.05


def test_no_silhouette_gives_no_outline_and_no_cost(flesh: Flesh, rig: CameraRig) -> None:
    state = bent(flesh)
    nothing = [np.zeros((H, W), dtype=np.bool_) for _ in rig]
    views = [pinhole_view(c) for c in rig]
    empty = person_outlines(views, rig, nothing, landmark_cloud(flesh, state), n_points=N_POINTS)
    cost, hessian, gradient = problem_of(flesh, empty).normal_equations(state)
    assert (empty.n_points, cost) == (0, 0.0)
    assert not hessian.any()
    assert not gradient.any()


def test_cameras_that_cannot_be_trusted_are_left_out(flesh: Flesh, rig: CameraRig) -> None:
    state = bent(flesh)
    masks = [silhouette(flesh, state, c) for c in rig]
    views = [pinhole_view(c) for c in rig]
    whole = [True, False, True, True, False]
    found = person_outlines(
        views, rig, masks, landmark_cloud(flesh, state), n_points=N_POINTS, is_whole=whole
    )
    assert set(found.camera) == {0, 2, 3}


def test_outlines_at_the_border_of_the_picture_do_not_count(flesh: Flesh, rig: CameraRig) -> None:
    state = bent(flesh)
    state[0] += 1.4  # partly out of some views
    found = outlines_of(flesh, state, rig)
    for v, camera in enumerate(rig):
        rows = found.camera == v
        if rows.any():
            uv, _ = camera.project(found.origins[rows] + found.directions[rows])
            assert uv.min() > 1.0
            assert (uv < [W - 2.0, H - 2.0]).all()


def test_compiled_and_plain_python_agree(
    flesh: Flesh, seen: Outlines, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = replace(seen, origins=seen.origins[:7], directions=seen.directions[:7], normals=seen.normals[:7])
    settings = OutlineFitSettings(n_flesh_points=30)
    state = bent(flesh) + 0.03
    fast = problem_of(flesh, few, settings).normal_equations(state)
    module = "mocap.likelihood.residuals.outlines."
    for name in ("add_pull", "spread_pulls", "outline_to_body", "body_to_silhouettes"):
        monkeypatch.setattr(kernels, name, getattr(kernels, name).py_func)
    monkeypatch.setattr(module + "outline_equations", kernels.outline_equations.py_func)
    slow = problem_of(flesh, few, settings).normal_equations(state)
    assert fast[0] == pytest.approx(slow[0], rel=1e-12)
    assert np.allclose(fast[1], slow[1], rtol=1e-9)
    assert np.allclose(fast[2], slow[2], rtol=1e-9)


def test_a_sum_of_problems_adds_costs_matrices_and_gradients(flesh: Flesh, seen: Outlines) -> None:
    problem = problem_of(flesh, seen)
    state = bent(flesh) + 0.01
    cost, hessian, gradient = problem.normal_equations(state)
    both = SumProblem(((0.5, problem), (2.0, problem), (0.0, problem)))
    assert both.layout is flesh.body.layout
    total = both.normal_equations(state)
    assert total[0] == pytest.approx(2.5 * cost)
    assert np.allclose(total[1], 2.5 * hessian)
    assert np.allclose(total[2], 2.5 * gradient)


def test_a_view_without_distortion_returns_the_mask_itself(rig: CameraRig) -> None:
    mask = np.zeros((H, W), dtype=np.bool_)
    cv2.circle(mask.view(np.uint8), (90, 70), 20, 1, -1)
    assert np.array_equal(pinhole_view(next(iter(rig))).undistort(mask), mask)


def test_the_gradient_knows_that_cones_taper(coarse_flesh: Flesh) -> None:
    """One ray beside a forearm whose radius falls from 12 cm to 2 cm: moved along it, the flesh comes and goes."""
    body = coarse_flesh.body
    cones = replace(body.cones, radii=np.where(np.arange(2) == 0, 0.12, 0.02) + 0.0 * body.cones.radii)
    body = replace(body, cones=cones)
    state = neutral_state(body)
    for name in ("right_shoulder_x", "left_shoulder_x", "right_elbow_z", "left_elbow_z"):
        state[body.layout.names.index(name)] = 0.0
    k = int(np.flatnonzero(cones.part == body.layout.parts.index("left_forearm"))[-1])
    start, end = (e[k] for e in cones_of(body, state))
    axis = (end - start) / np.linalg.norm(end - start)
    # A ray across the arm: there the derivative is exact.
    outwards = np.cross(axis, [1.0, 0.0, 0.0])
    outwards /= np.linalg.norm(outwards)
    ahead = np.cross(outwards, axis)
    touched = start + 0.5 * (end - start) + 0.10 * outwards
    empty = np.zeros(0, dtype=np.int64)
    pair = np.zeros((len(ANGLES_DEG), 2), dtype=np.int64)
    outlines = Outlines(
        rig=make_rig(),
        origins=(touched - 2.0 * ahead)[None],
        directions=ahead[None],
        normals=outwards[None],
        camera=np.zeros(1, dtype=np.int64),
        nearest=empty.astype(np.int32),
        first=pair[:, 0].copy(),
        shape=pair,
        corner=pair,
    )
    settings = OutlineFitSettings(scale_m=50.0, normal_cost_m=0.0)
    problem = OutlineProblem(body, coarse_flesh.table, outlines, settings)
    _, _, g = problem.normal_equations(state)
    numeric = np.array(
        [
            (problem.normal_equations(state + e)[0] - problem.normal_equations(state - e)[0]) / (2 * STEP)
            for e in STEP * np.eye(len(state))
        ]
    )
    along = g[:3] @ axis
    assert abs(along) > 0.2 * np.abs(g[:3]).max(), "the taper pulls along the arm"
    np.testing.assert_allclose(g, numeric, atol=0.03 * np.abs(numeric).max())


def test_slopes_at_pixels_are_those_of_the_blurred_picture() -> None:
    """Against OpenCV's blur and slopes of the whole picture, at its border too."""
    picture = np.zeros((60, 80), dtype=np.uint8)
    cv2.ellipse(picture, (40, 40), (22, 32), 25.0, 0.0, 360.0, 1, -1)
    rows, columns = np.mgrid[1:60:3, 1:80:4]
    at = np.column_stack([columns.ravel(), rows.ravel()]).astype(np.int64)
    found = kernels.slopes_at(picture, at, *outlines_module._SOFT_SLOPE)
    soft = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), outlines_module._SOFT_PX)
    right, down = cv2.Sobel(soft, cv2.CV_32F, 1, 0), cv2.Sobel(soft, cv2.CV_32F, 0, 1)
    expected = np.column_stack([right[at[:, 1], at[:, 0]], down[at[:, 1], at[:, 0]]])
    assert np.abs(expected).max() > 1.0
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_a_view_with_distortion_shows_what_opencv_does(rig: CameraRig) -> None:
    camera = replace(next(iter(rig)), dist=np.array([0.25, 0.12, 0.001, -0.002, 0.0]))
    mask = np.random.default_rng(4).random((H, W)) < 0.4
    view, window = pinhole_view(camera), (slice(7, H - 3), slice(0, W - 11))
    maps = cv2.initUndistortRectifyMap(camera.K, camera.dist, None, camera.K, camera.size, cv2.CV_32FC1)
    expected = cv2.remap(mask.view(np.uint8), *maps, cv2.INTER_NEAREST)
    np.testing.assert_array_equal(view.undistort(mask), expected)
    np.testing.assert_array_equal(view.undistort(mask, window), expected[window])
    covered = cv2.remap(np.ones((H, W), dtype=np.uint8), *maps, cv2.INTER_NEAREST)
    np.testing.assert_array_equal(view.inside, covered > 0)
    assert not view.inside.all()


def test_rays_and_places_of_outlines_equal_numpy(rig: CameraRig) -> None:
    rng, camera = np.random.default_rng(5), list(rig)[1]
    K, R = camera.K, camera.R
    uv, normals = rng.uniform(0, 90, (23, 2)), rng.normal(size=(23, 2))
    rays, outward = kernels.rays_through(uv, normals, K, R)
    u = np.linalg.solve(K, np.column_stack([uv, np.ones(23)]).T).T
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    n = np.column_stack([normals, np.zeros(23)])
    n -= (n * u).sum(axis=1, keepdims=True) * u
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    np.testing.assert_allclose(rays, u @ R, atol=1e-12)
    np.testing.assert_allclose(outward, n @ R, atol=1e-12)
    at, corner, shape, size, border = rng.integers(0, 40, (300, 2)), np.array([5, 30]), (33, 29), (31, 60), 3
    place = at + corner
    inside = ((at > 0) & (at < np.array(shape[::-1]) - 1)).all(axis=1)
    inside &= ((place >= border) & (place < np.array(size) - border)).all(axis=1)
    np.testing.assert_array_equal(kernels.are_inside(at, corner, shape, size, border), inside)
    low, high = extent_of(at)
    np.testing.assert_array_equal([low, high], [at.min(axis=0), at.max(axis=0)])

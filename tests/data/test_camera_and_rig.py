"""Cameras: validation, projection against itself, rigs by name."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap.data import Camera, CameraRig

K = np.array([[400.0, 0.0, 160.0], [0.0, 410.0, 118.0], [0.0, 0.0, 1.0]])


def camera(name: str = "cam", angle: float = 0.4, **changes: object) -> Camera:
    values: dict[str, object] = {
        "size": (320, 240),
        "K": K,
        "dist": np.array([-0.1, 0.02, 0.0, 0.0]),
        "R": Rotation.from_euler("xyz", [1.9, angle, 0.1]).as_matrix(),
        "t": np.array([0.1, 0.4, 3.0]),
    }
    return Camera(name, **{**values, **changes})  # type: ignore[arg-type]


def test_center_projects_nowhere_and_is_minus_rt_t() -> None:
    c = camera()
    np.testing.assert_allclose(c.R @ c.center + c.t, 0.0, atol=1e-12)
    uv, depth = c.project(c.center)
    assert np.isnan(uv).all()
    assert depth == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("is_fisheye", [False, True])
def test_unproject_is_the_inverse_of_project(is_fisheye: bool) -> None:
    c = camera(is_fisheye=is_fisheye)
    rng = np.random.default_rng(2)
    cam = np.column_stack([rng.uniform(-0.5, 0.5, (37, 2)), np.ones(37)]) * rng.uniform(1, 5, (37, 1))
    points = (cam - c.t) @ c.R
    uv, depth = c.project(points)
    # The residual of cv2's iterative undistortion, in metres.
    np.testing.assert_allclose(c.unproject(uv, depth), points, atol=1e-7)


def test_contains_knows_the_borders_of_the_picture() -> None:
    c = camera()
    uv = np.array([[0.0, 0.0], [319.0, 239.0], [320.6, 100.0], [100.0, -0.6], [np.nan, np.nan]])
    assert c.contains(uv).tolist() == [True, True, False, False, False]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"K": np.eye(4)}, "K has shape"),
        ({"t": np.array([0.0, np.nan, 1.0])}, "not finite"),
        ({"dist": np.array([np.inf])}, "not finite"),
        ({"K": np.diag([0.0, 400.0, 1.0])}, "focal"),
        ({"K": np.diag([-400.0, -400.0, 1.0])}, "focal"),
        ({"R": np.diag([1.0, 1.0, -1.0])}, "not a rotation"),
        ({"R": 2 * np.eye(3)}, "not a rotation"),
        ({"size": (0, 240)}, "not positive"),
    ],
)
def test_impossible_cameras_are_refused_by_name(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        camera("left wall", **changes)
    assert "left wall" in str(error.value)


def test_a_camera_cannot_be_changed_through_its_arrays() -> None:
    mine = K.copy()
    c = camera(K=mine)
    mine[0, 0] = 1.0
    assert c.K[0, 0] == 400.0
    with pytest.raises(ValueError, match="read-only"):
        c.K[0, 0] = 1.0


def test_rig_finds_cameras_by_name_and_index() -> None:
    rig = CameraRig((camera("b", 0.1), camera("a", 0.9), camera("10", -0.4)))
    assert len(rig) == 3
    assert rig.names == ("b", "a", "10")
    assert rig["a"] is rig[1]
    assert [c.name for c in rig] == ["b", "a", "10"]
    assert rig.subset(["10", "b"]).names == ("10", "b")
    with pytest.raises(KeyError, match="the rig has b, a, 10"):
        rig["zzz"]
    with pytest.raises(ValueError, match="not unique"):
        CameraRig((camera("a"), camera("a", 0.3)))
    with pytest.raises(ValueError, match="at least one"):
        CameraRig(())


def test_fundamental_matrix_of_the_rig() -> None:
    none = np.zeros(4)
    rig = CameraRig((camera("a", 0.1, dist=none), camera("b", 0.5, dist=none, t=np.array([0.0, 0.0, 4.0]))))
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (11, 3))
    F = rig.fundamental("a", "b")
    a, b = (np.column_stack([rig[n].project(points)[0], np.ones(11)]) for n in ("a", "b"))
    np.testing.assert_allclose(np.einsum("ni,ij,nj->n", b, F, a), 0.0, atol=1e-9)

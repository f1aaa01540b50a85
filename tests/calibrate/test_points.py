"""Cameras of known lenses are placed by points of known place alone; what does not go together is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_session import mocap

from eval.board_calibration import looking_rig
from mocap.calibrate import Lens, WorldPoints, resect
from mocap.calibrate.detect import Sighting
from mocap.data import Camera, CameraRig
from mocap.errors import MocapError
from mocap.io.calibration import read_calibration, write_calibration

# Marks on a floor and at some heights, m.
POINTS = np.array(
    [
        [0.5, 0.4, 0.0],
        [-0.4, 0.5, 0.0],
        [0.3, -0.6, 0.0],
        [-0.5, -0.4, 0.9],
        [0.2, 0.1, 1.2],
        [0.0, 0.6, 0.5],
        [-0.3, 0.0, 0.3],
        [0.4, -0.2, 0.7],
    ]
)
RIG = looking_rig()
LENSES = {camera.name: Lens.of(camera) for camera in RIG}
NOISE_PX = 0.3


def seen(points: np.ndarray = POINTS, seed: int = 0, noise_px: float = NOISE_PX) -> dict[str, Sighting]:
    rng = np.random.default_rng(seed)
    uv = {camera.name: camera.project(points)[0] for camera in RIG}
    return {name: Sighting(points, at + rng.normal(0, noise_px, at.shape)) for name, at in uv.items()}


def test_cameras_stand_where_the_points_say_and_as_surely() -> None:
    """Over repetitions a place lies within the deviation of its worst axis as often as it should."""
    within = []
    for seed in range(12):
        found = resect(WorldPoints(seen(seed=seed)), LENSES)
        assert not found.warnings
        for camera in RIG:
            off = np.linalg.norm(found.rig[camera.name].center - camera.center)
            assert off < 0.03
            within.append(off / found.center_deviation_m[camera.name])
            np.testing.assert_array_equal(found.rig[camera.name].K, camera.K)
    assert 0.4 < np.sqrt(np.mean(np.square(within))) < 1.7
    assert found.rms_px == pytest.approx(NOISE_PX * np.sqrt(2), rel=0.5)


def test_points_in_a_plane_and_four_of_them_are_enough() -> None:
    flat = POINTS[:4] * [1, 1, 0]
    found = resect(WorldPoints(seen(flat, noise_px=0.0)), LENSES)
    for camera in RIG:
        assert np.linalg.norm(found.rig[camera.name].center - camera.center) < 1e-4
    assert len([words for words in found.warnings if "4 points say little of their own errors" in words]) == 3


@pytest.mark.parametrize(
    "points",
    [POINTS[:3], np.linspace(POINTS[0], POINTS[4], 6), np.linspace(POINTS[0], POINTS[1], 6)],
    ids=["three", "in one line", "in one line on the floor"],
)
def test_what_does_not_place_a_camera_is_refused(points: np.ndarray) -> None:
    message = "3 points .* needed are 4" if len(points) == 3 else "do not determine the camera"
    with pytest.raises(MocapError, match=message) as caught:
        resect(WorldPoints(seen(points, noise_px=0.0)), LENSES)
    assert caught.value.camera == "left"


def test_a_camera_without_points_is_named() -> None:
    without = {name: sighting for name, sighting in seen().items() if name != "middle"}
    with pytest.raises(MocapError, match="0 points of known place"):
        resect(WorldPoints(without), LENSES)


def test_a_point_that_belongs_elsewhere_is_named() -> None:
    given = seen()
    uv = given["right"].uv.copy()
    uv[4] += [25.0, 0.0]
    with pytest.raises(
        MocapError, match=r"the point at \(0.2, 0.1, 1.2\) m, .* does not go with the other 7"
    ) as caught:
        resect(WorldPoints({**given, "right": Sighting(POINTS, uv)}), LENSES)
    assert caught.value.camera == "right"
    uv[4] = given["right"].uv[4] + [1.5, 0.0]  # a hand that shakes
    resect(WorldPoints({**given, "right": Sighting(POINTS, uv)}), LENSES)


def test_a_point_without_which_the_others_are_in_one_line_is_kept() -> None:
    line = np.vstack([np.linspace(POINTS[0], POINTS[1], 5), POINTS[4:5]])
    given = seen(line, noise_px=1.5)
    assert resect(WorldPoints(given), LENSES).rms_px > 1.0


def test_fisheye_lenses_are_kept_as_they_are() -> None:
    rig = CameraRig(
        tuple(
            Camera(c.name, c.size, c.K, np.array([0.05, -0.01, 0.002, 0.0]), c.R, c.t, is_fisheye=True)
            for c in RIG
        )
    )
    given = {camera.name: Sighting(POINTS, camera.project(POINTS)[0]) for camera in rig}
    found = resect(WorldPoints(given), {camera.name: Lens.of(camera) for camera in rig})
    for camera in rig:
        assert np.linalg.norm(found.rig[camera.name].center - camera.center) < 1e-4


def test_points_that_no_place_explains_are_refused() -> None:
    given = seen()
    shuffled = Sighting(POINTS, given["left"].uv[[3, 4, 5, 6, 7, 0, 1, 2]])
    with pytest.raises(MocapError, match="no place of the camera explains them"):
        resect(WorldPoints({**given, "left": shuffled}), LENSES)


def test_what_may_be_wrong_is_said() -> None:
    near = 0.1 * POINTS + [0.0, 0.0, 0.3]
    warnings = " ".join(resect(WorldPoints(seen(near, noise_px=1.0)), LENSES).warnings)
    assert "give more points, further apart" in warnings
    below = {name: Sighting(s.points - [0.0, 0.0, 5.0], s.uv) for name, s in seen().items()}
    assert "is z up, and 0 on the floor?" in " ".join(resect(WorldPoints(below), LENSES).warnings)
    assert "measure and point more exactly" in " ".join(
        resect(WorldPoints(seen(noise_px=2.8)), LENSES).warnings
    )


def write_points(path: Path, given: dict[str, Sighting]) -> Path:
    rows = ["camera,u_px,v_px,x_m,y_m,z_m"]
    for name, sighting in given.items():
        for uv, xyz in zip(sighting.uv, sighting.points, strict=True):
            rows.append(",".join([name, *map(str, (*uv, *xyz))]))
    path.write_text("\n".join(rows) + "\n")
    return path


def test_from_points_and_lenses_to_a_calibration_and_its_page(tmp_path: Path) -> None:
    points = write_points(tmp_path / "points.csv", seen())
    write_calibration(tmp_path / "lenses.toml", RIG)
    path = tmp_path / "calibration.toml"
    said = mocap("calibrate", "-o", path, "--points", points, "--lenses", tmp_path / "lenses.toml")
    assert said.code == 0, said.err
    assert "right: 8 points, off by" in said.out
    for camera in read_calibration(path).rig:
        assert np.linalg.norm(camera.center - RIG[camera.name].center) < 0.03
    page = (tmp_path / "calibration.html").read_text(encoding="utf-8")
    assert page.count("<img src=") == 2
    for words in (
        "<td>8</td>",
        "points of known place, 3 cameras",
        "Where the points were seen",
        '<th scope="col">points</th>',
    ):
        assert words in page


def test_mistakes_with_points_are_named_and_nothing_is_written(tmp_path: Path) -> None:
    points = write_points(tmp_path / "points.csv", {**seen(), "fourth": seen()["left"]})
    write_calibration(tmp_path / "lenses.toml", RIG)
    lenses = ("--lenses", tmp_path / "lenses.toml")
    for wrong, message in (
        ((), "--lenses must be given"),
        (("--lenses", tmp_path), "--board, --square-mm must be given"),
        (lenses, "there is no lens for camera fourth"),
        ((*lenses, "--floor-frame", 3), "--floor-frame has no meaning"),
        ((*lenses, "--height-m", 1.8), "--height-m has no meaning"),
        ((*lenses, "--lens", "fishy"), "did you mean 'fisheye'"),
    ):
        said = mocap("calibrate", "-o", tmp_path / "no.toml", "--points", points, *wrong)
        assert said.code == 2, (wrong, said.out)
        assert message in said.err, said.err
        assert "Remedy" in said.err
    assert not (tmp_path / "no.toml").exists()
    assert not (tmp_path / "no.html").exists()

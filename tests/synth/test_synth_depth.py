"""Simulated depth maps: noise, holes and mixed pixels as they were asked for."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mocap.errors import MocapError
from mocap.synth.depth import DepthConfig, TrueDepth, measured_depth
from mocap.synth.scene import scene_from_dict

SHAPE = (120, 160)
SCENE = {
    "name": "s",
    "seed": 21,
    "n_frames": 3,
    "masks_only": True,
    "rig": {"n_cameras": 3, "size_px": [160, 120]},
    "depth": {"cameras": ["cam_1"]},
    "persons": [{"seed": 5, "motion": {"kind": "stand"}}],
}


def flat(depth_m: float) -> TrueDepth:
    return TrueDepth(np.full(SHAPE, depth_m), np.ones(SHAPE), np.ones(SHAPE))


def config(**more: object) -> DepthConfig:
    return DepthConfig.model_validate({"cameras": ("cam_0",), **more})


def rng() -> np.random.Generator:
    return np.random.default_rng(4)


@pytest.mark.parametrize("depth_m", [1.0, 2.0, 4.0])
def test_noise_grows_with_the_square_of_the_distance(depth_m: float) -> None:
    numbers = measured_depth(flat(depth_m), config(noise_m=0.002, noise_per_m=0.002), rng=rng())
    # A chi-squared of some 19200 / (4 pi) independent values: 2 %, five of them; and 0.3 mm of rounding.
    assert numbers.std() == pytest.approx(2.0 + 2.0 * depth_m**2, rel=0.12)
    assert numbers.mean() == pytest.approx(1000 * depth_m, rel=0.003)


def test_without_noise_a_map_is_exact_and_what_is_out_of_range_is_lost() -> None:
    exact = config(noise_m=0, noise_per_m=0, range_m=(0.5, 5.0))
    assert (measured_depth(flat(2.5), exact, rng=rng()) == 2500).all()
    assert (measured_depth(flat(5.1), exact, rng=rng()) == 0).all()
    assert (measured_depth(flat(0.4), exact, rng=rng()) == 0).all()


def test_edges_lose_and_mix_pixels() -> None:
    true = flat(4.0)
    true.depth_m[:, :80] = 2.0
    numbers = measured_depth(true, config(noise_m=0, noise_per_m=0, edge_loss=0.5), rng=rng())
    edge = numbers[:, 79:81]
    assert (edge == 0).mean() == pytest.approx(0.5, abs=0.15)
    assert ((edge > 2001) & (edge < 3999)).mean() == pytest.approx(1 / 6, abs=0.1)
    assert (numbers[:, :78] == 2000).all()
    assert (numbers[:, 82:] == 4000).all()


def test_dark_and_grazing_surfaces_are_lost() -> None:
    true = flat(2.0)
    true.albedo[:60] = 0.02
    true.cosine[100:] = 0.1
    numbers = measured_depth(true, config(noise_m=0, noise_per_m=0, absorbed=0.7), rng=rng())
    assert (numbers[:60] == 0).mean() == pytest.approx(0.7, abs=0.15)
    assert (numbers[60:100] == 2000).all()
    assert (numbers[100:] == 0).all()


def test_a_session_has_the_maps_of_its_depth_cameras(tmp_path: Path) -> None:
    pytest.importorskip("embreex", reason="rendering needs the extra synth (embreex)")
    from mocap.io.session import open_session
    from mocap.io.session.reading import depth_of
    from mocap.synth import synthesise
    from mocap.volume import surface_voxels

    scene = scene_from_dict({**SCENE, "depth": {"cameras": ["cam_1"], "noise_m": 0, "noise_per_m": 0}})
    root = synthesise(scene, tmp_path / "s", workers=1)
    session = open_session(root)
    assert list(session.depth_sources) == ["cam_1"]
    with depth_of(session) as reader:
        maps = [depth for _, (depth,) in reader]
    assert len(maps) == 3
    # The person's readings lie on its true surface: within a voxel (2 cm) of the true body's.
    from scipy.spatial import cKDTree

    from mocap.io.truth import read_true_voxels

    packed = np.load(root / "truth" / "masks" / "cam_1.npz")["masks"]
    mask = np.unpackbits(packed, axis=2, count=160)[0] > 0
    inner = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    v, u = np.nonzero(inner & (maps[0] > 0))
    assert len(u) > 0.5 * inner.sum() > 50
    points = session.rig["cam_1"].unproject(np.column_stack([u, v]).astype(float), maps[0][v, u])
    true = read_true_voxels(root / "truth" / "voxels.npz")
    voxels = true.at(0)
    surface = true.grid.centers(voxels[surface_voxels(voxels, true.grid)])
    assert np.quantile(cKDTree(surface).query(points)[0], 0.95) < 0.03
    again = synthesise(scene, tmp_path / "t", workers=2)
    for a, b in zip(
        sorted((root / "depth").rglob("*.png")), sorted((again / "depth").rglob("*.png")), strict=True
    ):
        assert a.read_bytes() == b.read_bytes()


def test_a_depth_camera_that_is_not_there_is_named() -> None:
    with pytest.raises(MocapError, match="no camera kinect"):
        scene_from_dict({**SCENE, "depth": {"cameras": ["kinect"]}})

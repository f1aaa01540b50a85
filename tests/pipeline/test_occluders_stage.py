"""The stage that learns what stands in front of people: cameras that see nobody, and settings that switch it off."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_session import CAMERAS, FPS, N_FRAMES, PLAIN, SIZE, copy_session, small_session

from mocap.data import CameraRig, VoxelGrid
from mocap.io.store import StageStore
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session
from mocap.pipeline.stages import occluders as stage
from mocap.pipeline.stages.carve import _Carving
from mocap.pipeline.stages.occluders import idle_cameras
from mocap.products import hulls
from mocap.products.empty import stored_empty
from mocap.volume import OccluderLearner

CUBE_M = np.array([[0.9, 0.9, 0.4]])


def test_a_camera_that_sees_only_furniture_is_idle() -> None:
    share = np.full((20, 5), 0.02)
    share[:, 3] = 0.0
    share[4, 3] = 0.01  # once
    np.testing.assert_array_equal(idle_cameras(share), [False, False, False, True, False])


def test_nobody_is_idle_while_nobody_is_there() -> None:
    share = np.zeros((20, 5))
    share[:, 0] = 0.02  # one camera sees a curtain move
    assert not idle_cameras(share).any()


def test_who_is_hidden_for_a_while_is_not_idle() -> None:
    share = np.full((20, 5), 0.02)
    share[5:, 1] = 0.0
    assert not idle_cameras(share).any()
    assert not idle_cameras(share[:3]).any()


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[list[np.ndarray]]:
    """The empty scenes of which furniture is asked, which has always the same cube in it."""
    found: list[list[np.ndarray]] = []

    def things_on_floor(rig: CameraRig, grid: VoxelGrid, empty: list[np.ndarray]) -> np.ndarray:
        assert [(*camera.size[::-1], 4) for camera in rig] == [own.shape for own in empty]
        assert grid.voxel_size_m == 0.04
        found.append(list(empty))
        return CUBE_M

    monkeypatch.setattr(stage, "things_on_floor", things_on_floor)
    return found


def run(session: Path, out: Path, *more: str, n_threads: int = 1) -> dict[str, float]:
    config = load_config("default", (*PLAIN, *more))
    result = run_session(session, out, config=config, until="occluders", n_threads=n_threads, resume=True)
    return result.record.numbers["occluders"]["picture_share"]


@pytest.mark.parametrize("n_threads", [1, 2])
def test_furniture_is_told_from_the_scene_as_it_was_learnt(
    asked: list[list[np.ndarray]], tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, n_threads: int
) -> None:
    session, out = small_session(tmp_path_factory.getbasetemp()), tmp_path / "out"
    shares = run(session, out, n_threads=n_threads)
    assert np.median([*shares.values()]) > 0  # of one camera somebody passes there
    (first,) = asked
    assert len(first) == len(CAMERAS)
    for own in first:
        assert own.shape == (SIZE[1] // 2, SIZE[0] // 2, 4)
        assert own.dtype == np.uint8
        assert (own[..., 3] == 255).all()  # an empty clip shows all of it
        assert own[..., :3].std() > 5
    for own, stored in zip(first, stored_empty(StageStore(out / "store.zarr")), strict=True):
        np.testing.assert_array_equal(own, stored)
    # Masks are reused: the scene comes out of the store.
    again = run(session, out, "volume.voxel_size_m=0.04", "volume.n_faulty_views=1", n_threads=n_threads)
    assert again == shares
    assert len(asked) == 2
    for own, later in zip(*asked, strict=True):
        np.testing.assert_array_equal(own, later)


def test_nothing_is_asked_where_nothing_is_wanted_or_masks_are_given(
    asked: list[list[np.ndarray]],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path_factory: pytest.TempPathFactory,
    tmp_path: Path,
) -> None:
    session = small_session(tmp_path_factory.getbasetemp())
    assert max(run(session, tmp_path / "ignored", "volume.occluders=ignore").values()) == 0
    given = copy_session(session, tmp_path / "given", masks=True)
    assert max(run(given, tmp_path / "taken over").values()) == 0
    assert stored_empty(StageStore(tmp_path / "taken over" / "store.zarr")) == []
    # Hulls of more forgive one; of fewer, those of things reach too far.
    for told in (range(len(CAMERAS)), range(len(CAMERAS) + 1, 9)):
        monkeypatch.setattr(stage, "_FLOOR_TELLS", told)
        assert max(run(session, tmp_path / f"to {told}").values()) == 0
    assert asked == []


def test_others_do_not_go_on_once_something_stands_there(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = small_session(tmp_path_factory.getbasetemp())
    n_carved = []
    hull = _Carving.hull

    def counted(self: _Carving, *told: Any) -> Any:
        n_carved.append(len(told))
        return hull(self, *told)

    def carved(out: str) -> dict[int, list[int]]:
        n_carved.clear()
        config = load_config("default", PLAIN)
        run_session(session, tmp_path / out, config=config, until="carve", n_threads=1)
        rows = StageStore(tmp_path / out / "store.zarr").reader(hulls.PRODUCT)
        return {frame: arrays["voxels"].tolist() for frame, arrays in rows}

    monkeypatch.setattr(_Carving, "hull", counted)
    plain = carved("plain")
    assert len(n_carved) == N_FRAMES
    monkeypatch.setattr(stage, "_LOOKS_TO_ASK", 4)
    assert carved("nothing found") == plain
    assert len(n_carved) == N_FRAMES
    monkeypatch.setattr(OccluderLearner, "has_found", True)
    assert carved("found") == plain  # at the end there was nothing after all
    stride = max(1, round(FPS / stage._LOOKS_PER_S))
    assert len(n_carved) == 3 * stride + N_FRAMES

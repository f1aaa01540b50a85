"""Cameras that see no colours: where they see a person together, what each took for his shadow is his."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from test_occluders import ring_rig, standing_silhouettes

from mocap.io.calibration import write_calibration
from mocap.io.session import open_session
from mocap.io.store import StageStore
from mocap.pipeline.config import load_config
from mocap.pipeline.stage import Job
from mocap.pipeline.stages import segment
from mocap.pipeline.stages.segment import SEGMENT
from mocap.pipeline.walk import run_stage
from mocap.products.masks import masks_from_arrays

N_FRAMES, N_EMPTY = 8, 6
WALL, TROUSERS = 150.0, 50.0
# On its side away from the window it is as bright as the wall in shade.
SHIRT = (60.0, 60.0, 128.0, 128.0, 128.0, 128.0)


@pytest.fixture(scope="module")
def persons() -> list[np.ndarray]:
    return standing_silhouettes(np.array([0.1, -0.2]))


def write_session(root: Path, persons: list[np.ndarray], *, red: int = 0) -> None:
    """Pictures of one channel, or of three with people who are redder than the room by so many levels."""
    rig, rng = ring_rig(), np.random.default_rng(4)
    write_calibration(root / "calibration.toml", rig)
    (root / "session.toml").write_text("fps = 10\nroom_bounds_m = [[-1.5, -1.5, 0.0], [1.5, 1.5, 2.0]]\n")
    for camera, person, bright in zip(rig, persons, SHIRT, strict=True):
        rows = np.flatnonzero(person.any(axis=1))
        shirt, trousers = person.copy(), person.copy()
        shirt[rows[len(rows) // 2] :], trousers[: rows[len(rows) // 2]] = False, False
        for folder, n in (("background", N_EMPTY), ("images", N_FRAMES)):
            (root / folder / camera.name).mkdir(parents=True)
            for f in range(n):
                scene = np.full(person.shape, WALL)
                if folder == "images":
                    scene[shirt], scene[trousers] = bright, TROUSERS
                grey = np.clip(scene + rng.normal(0, 1.0, scene.shape), 0, 255).astype(np.uint8)
                picture = (
                    grey if red == 0 else np.dstack([grey, grey, grey + np.uint8(red) * (scene != WALL)])
                )
                assert cv2.imwrite(str(root / folder / camera.name / f"{f:03d}.png"), picture)


def masks_of(root: Path, *settings: str, n_threads: int = 2) -> tuple[np.ndarray, str]:
    """The masks (F, C, H, W) of a session, and what was warned of colours."""
    session, store = open_session(root), StageStore(root / "store.zarr")
    run_stage(SEGMENT, Job(session, load_config(settings=settings), store, "key", n_threads=n_threads))
    reader = store.reader("segment")
    words = [w for w in reader.attrs["warnings"] if "no colours" in w]
    return np.array([masks_from_arrays(arrays, session) for _, arrays in reader]), "".join(words)


def segmented(root: Path, persons: list[np.ndarray], *settings: str) -> tuple[float, float, str]:
    """Shares of the persons that masks have, and of the masks that are persons, and what was warned of colours."""
    found, words = masks_of(root, *settings)
    hits = np.count_nonzero(found & np.array(persons))
    return hits / (N_FRAMES * np.count_nonzero(persons)), hits / max(np.count_nonzero(found), 1), words


def test_a_shirt_in_the_shade_is_found_where_two_cameras_see_its_other_side(
    tmp_path: Path, persons: list[np.ndarray]
) -> None:
    write_session(tmp_path, persons)
    recall, precision, words = segmented(tmp_path, persons)
    assert recall > 0.95
    assert precision > 0.93
    assert "c0, c1, c2, c3, c4, c5" in words
    assert "where cameras see him together" in words
    assert "Remedy" in words


def test_every_camera_alone_takes_it_for_a_shadow(tmp_path: Path, persons: list[np.ndarray]) -> None:
    write_session(tmp_path, persons)
    recall, _, words = segmented(tmp_path, persons, "segmentation.second_look=false")
    assert recall < 0.8
    assert "soft edges alone" in words


def test_outlines_are_found_once_more_by_choice(
    tmp_path: Path, persons: list[np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_session(tmp_path, persons)
    monkeypatch.setattr(segment, "grey_outline", lambda brightness, empty, mask: mask & False)
    assert segmented(tmp_path, persons)[0] < 0.1
    assert segmented(tmp_path, persons, "segmentation.grey_outlines=false")[0] > 0.95
    assert not load_config("realtime").segmentation.grey_outlines
    assert not load_config("live").segmentation.grey_outlines


def test_outlines_do_not_depend_on_threads(tmp_path: Path, persons: list[np.ndarray]) -> None:
    """One half of the work has another process, which keeps the pictures and the empty scene to itself."""
    write_session(tmp_path, persons)
    one, two = (masks_of(tmp_path, n_threads=n)[0] for n in (1, 2))
    np.testing.assert_array_equal(one, two)
    plain = masks_of(tmp_path, "segmentation.grey_outlines=false")[0]
    assert np.any(one != plain)


def test_cameras_with_colours_are_not_spoken_of(tmp_path: Path, persons: list[np.ndarray]) -> None:
    write_session(tmp_path, persons, red=40)
    assert segmented(tmp_path, persons)[2] == ""

"""An empty clip of another day: pushed, in other light, of another place, through another lens, with somebody in it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mocap.data import Camera
from mocap.foreground import Background, Fit, Segmenter, fit_background, is_black, learn_background
from mocap.pipeline import empty_clips

H, W = 240, 320
SHIFT_PX = (2.3, -1.4)
OFF_PX = 0.2
N_PICTURES = 8
STANDS = (slice(90, 200), slice(140, 180))


def room(seed: int = 0) -> np.ndarray:
    """Walls with blotches and joints, (H + 40, W + 40, 3), so that it can be pushed and enlarged."""
    rng = np.random.default_rng(seed)
    picture = np.full((H + 40, W + 40, 3), (130.0, 120.0, 110.0))
    blotches = cv2.GaussianBlur(rng.normal(0, 1, picture.shape[:2]), (0, 0), 6)
    picture += (14 * blotches / blotches.std())[:, :, None]
    for k in range(10, H + 40, 45):
        picture[k : k + 2] -= 30
    for k in range(25, W + 40, 60):
        picture[:, k : k + 2] -= 30
    return picture


def seen(
    scene: np.ndarray, rng: np.random.Generator, *, push: tuple[float, float] = (0.0, 0.0), gain: float = 1.0
) -> np.ndarray:
    """What a camera shows of the scene that was pushed by so many pixels."""
    matrix = np.array([[1.0, 0.0, push[0] - 20], [0.0, 1.0, push[1] - 20]])
    picture = cv2.warpAffine(scene, matrix, (W, H)) * gain
    return np.clip(picture + rng.normal(0, 2.0, picture.shape), 0, 255).astype(np.uint8)


def recording(scene: np.ndarray, rng: np.random.Generator) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Pictures of somebody who walks by, and his silhouettes."""
    pictures, truth = [], []
    for k in range(N_PICTURES):
        picture, mask = seen(scene, rng), np.zeros((H, W), dtype=bool)
        mask[80:210, 20 + 30 * k : 55 + 30 * k] = True
        picture[mask] = np.clip(rng.normal((60, 70, 140), 3, (mask.sum(), 3)), 0, 255).astype(np.uint8)
        pictures.append(picture)
        truth.append(mask)
    return pictures, truth


def iou(background: Background, pictures: list[np.ndarray], truth: list[np.ndarray]) -> float:
    segmenter = Segmenter(background)
    masks = [segmenter.segment(picture).mask for picture in pictures]
    hit = sum(np.count_nonzero(m & t) for m, t in zip(masks, truth, strict=True))
    return hit / sum(np.count_nonzero(m | t) for m, t in zip(masks, truth, strict=True))


@pytest.mark.parametrize("n_pictures", [1, 20])
def test_a_clip_or_still_that_is_pushed_and_darker_is_put_right(n_pictures: int) -> None:
    rng = np.random.default_rng(1)
    pictures, truth = recording(room(), rng)
    pushed = learn_background(seen(room(), rng, push=SHIFT_PX, gain=0.7) for _ in range(n_pictures))
    fit = fit_background(pushed, pictures)
    assert not fit.is_elsewhere
    assert fit.likeness > 0.7
    assert fit.shift_px == pytest.approx((-SHIFT_PX[0], -SHIFT_PX[1]), abs=OFF_PX)
    assert not fit.gone.any()
    right = learn_background(seen(room(), rng) for _ in range(n_pictures))
    assert iou(pushed, pictures, truth) < 0.85
    assert iou(fit.background, pictures, truth) > iou(right, pictures, truth) - 0.03


def test_a_clip_that_fits_is_left_alone() -> None:
    rng = np.random.default_rng(2)
    pictures, _ = recording(room(), rng)
    background = learn_background(seen(room(), rng) for _ in range(20))
    fit = fit_background(background, pictures)
    assert fit.background is background
    assert (fit.shift_px, fit.is_elsewhere, fit.gone.any()) == ((0.0, 0.0), False, False)


def in_grey(picture: np.ndarray) -> np.ndarray:
    return np.dstack([picture[..., 0]] * 3)


@pytest.mark.parametrize("has_colour", [False, True])
def test_a_grey_room_with_people_in_colour_is_seen_in_colour(has_colour: bool) -> None:
    rng = np.random.default_rng(3)
    pictures, _ = recording(room(), rng)
    greys = [in_grey(picture) for picture in pictures]
    background = learn_background(in_grey(seen(room(), rng)) for _ in range(20))
    if has_colour:
        greys[3][100:130, 100:130] = (60, 70, 140)
    assert background.is_grey
    assert fit_background(background, greys).background.is_grey is not has_colour


def test_a_clip_in_colour_serves_a_recording_without() -> None:
    """A camera may have switched to infrared."""
    rng = np.random.default_rng(4)
    scene = room() + np.array([0.0, -30.0, -60.0])
    pictures, truth = recording(scene, rng)
    for picture, mask in zip(pictures, truth, strict=True):
        picture[mask] //= 3
    greys = [cv2.cvtColor(cv2.cvtColor(p, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB) for p in pictures]
    background = learn_background(seen(scene, rng) for _ in range(20))
    fit = fit_background(background, greys)
    assert not background.is_grey
    assert fit.background.is_grey
    assert not fit.is_elsewhere
    assert iou(fit.background, greys, truth) > iou(background, greys, truth) + 0.2


@pytest.mark.parametrize("what", ["another room", "another lens"])
def test_another_place_and_another_lens_are_told(what: str) -> None:
    rng = np.random.default_rng(3)
    pictures, _ = recording(room(), rng)
    other = room(7) if what == "another room" else cv2.resize(room(), None, fx=1.1, fy=1.1)
    background = learn_background(seen(other, rng) for _ in range(20))
    fit = fit_background(background, pictures)
    assert fit.is_elsewhere
    assert abs(fit.likeness) < 0.5
    assert fit.differing_share > 0.1
    assert fit.background is background


def test_people_who_stay_in_a_third_of_the_picture_are_no_other_place() -> None:
    rng = np.random.default_rng(10)
    pictures, _ = recording(room(), rng)
    for picture in pictures:
        for left in (10, 120, 230):
            shirt = rng.integers(0, 255, (15, 4, 3)).astype(
                np.uint8
            )  # stripes have more structure than a wall
            picture[60:210, left : left + 50] = cv2.resize(shirt, (50, 150), interpolation=cv2.INTER_NEAREST)
    background = learn_background(seen(room(), rng) for _ in range(20))
    fit = fit_background(background, pictures)
    assert not fit.is_elsewhere
    assert fit.likeness > 0.9
    assert not fit.gone.any()


def test_bare_walls_are_no_other_place() -> None:
    rng = np.random.default_rng(4)
    bare = np.full((H + 40, W + 40, 3), 120.0)
    pictures, _ = recording(bare, rng)
    for picture in pictures:
        picture[STANDS] = (50, 60, 90)
    assert not fit_background(learn_background(seen(bare, rng) for _ in range(20)), pictures).is_elsewhere


def test_who_stands_in_the_empty_clip_leaves_no_ghost() -> None:
    rng = np.random.default_rng(5)
    pictures, truth = recording(room(), rng)
    clip = [seen(room(), rng) for _ in range(20)]
    for picture in clip:
        picture[STANDS] = (150, 60, 50)
    background = learn_background(clip)
    fit = fit_background(background, pictures)
    assert fit.gone[STANDS].all()
    assert fit.gone.sum() < 2 * fit.gone[STANDS].size
    assert iou(background, pictures, truth) < 0.8 < 0.9 < iou(fit.background, pictures, truth)


@pytest.mark.parametrize(("apart_px", "is_his"), [(5, True), (40, False)])
def test_what_somebody_who_stays_hides_of_his_chair_has_not_gone(apart_px: int, is_his: bool) -> None:
    """A piece of it that touches nothing else that differs is near him; a thing further away stood there alone."""
    rng = np.random.default_rng(11)
    pictures, _ = recording(room(), rng)
    clip = [seen(room(), rng) for _ in range(20)]
    piece = (slice(150, 190), slice(180 + apart_px, 195 + apart_px))
    for picture in clip:
        picture[piece] = (40, 40, 45)
    for picture in pictures:
        picture[STANDS] = (30, 35, 60)
    fit = fit_background(learn_background(clip), pictures)
    assert not fit.gone[STANDS].any()
    assert fit.gone[piece].all() == (not is_his)
    assert fit.gone[piece].any() == (not is_his)


def test_a_shadow_takes_nothing_away() -> None:
    """It weakens the joints of the tiles in it, and has hardly any edges of its own."""
    rng = np.random.default_rng(12)
    lit, dark = 0.3 * room(), np.ones((H + 40, W + 40, 1))
    dark[140:220, 60:240] = 0.3
    shaded = lit * cv2.GaussianBlur(dark, (0, 0), 9)[..., None]
    pictures = [seen(shaded, rng) for _ in range(N_PICTURES)]
    background = learn_background(seen(lit, rng) for _ in range(20))
    fit = fit_background(background, pictures)
    assert fit.differing_share > 0.1
    assert not fit.gone.any()


@pytest.mark.parametrize("k", [0, 3, 6])
def test_who_walks_through_his_place_in_the_clip_leaves_no_ghost(k: int) -> None:
    """In the pictures in which he is there again nothing differs."""
    rng = np.random.default_rng(9)
    pictures, truth = recording(room(), rng)
    background = learn_background([pictures[k]] * 20)
    fit = fit_background(background, pictures)
    assert fit.gone[truth[k]].mean() > 0.95
    assert iou(background, pictures, truth) < 0.8 < 0.9 < iou(fit.background, pictures, truth)


def test_who_stands_in_the_recording_all_the_time_stays_a_person() -> None:
    rng = np.random.default_rng(6)
    pictures, truth = recording(room(), rng)
    for picture, mask in zip(pictures, truth, strict=True):
        picture[STANDS] = (150, 60, 50)
        mask[STANDS] = True
    fit = fit_background(learn_background(seen(room(), rng) for _ in range(20)), pictures)
    assert not fit.gone.any()
    assert iou(fit.background, pictures, truth) > 0.9


def test_mistakes_are_named() -> None:
    rng = np.random.default_rng(8)
    background = learn_background([seen(room(), rng)])
    with pytest.raises(ValueError, match="at least 3, got 2"):
        fit_background(background, [seen(room(), rng)] * 2)
    with pytest.raises(ValueError, match=r"shape \(240, 320, 3\)"):
        fit_background(background, [seen(room(), rng)[1:]] * 3)


@pytest.mark.parametrize(
    ("level", "spread", "is_off"), [(8, 2, True), (8, 20, False), (120, 2, False), (120, 20, False)]
)
def test_a_picture_of_a_camera_that_is_off_is_dark_and_shows_nothing(
    level: int, spread: int, is_off: bool
) -> None:
    picture = np.full((H, W, 3), level, dtype=np.float64)
    picture[:, ::2] += spread
    assert is_black(picture.astype(np.uint8)) == is_off


@pytest.mark.parametrize(("n_lit", "n_held"), [(3, [3]), (2, [])])
def test_pictures_of_a_camera_that_was_off_say_nothing_of_its_clip(
    n_lit: int, n_held: list[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A camera that was black from the middle on had the recording's background, and masks of all the room."""
    rng = np.random.default_rng(5)
    clip = tmp_path / "background" / "cam_0"
    clip.mkdir(parents=True)
    for k in range(3):
        cv2.imwrite(str(clip / f"{k:04d}.png"), seen(room(), rng))
    camera = Camera("cam_0", (W, H), np.eye(3), np.zeros(4), np.eye(3), np.zeros(3))
    pictures, _ = recording(room(), rng)
    black = [rng.integers(0, 6, (H, W, 3)).astype(np.uint8) for _ in range(N_PICTURES - n_lit)]
    held: list[int] = []

    def fit(background: Background, pictures: list[np.ndarray]) -> Fit:
        assert not any(map(is_black, pictures))
        held.append(len(pictures))
        return fit_background(background, pictures)

    monkeypatch.setattr(empty_clips, "fit_background", fit)
    found = empty_clips.fitted(clip, camera, [*pictures[:n_lit], *black])
    assert held == n_held
    assert not found.gone.any()

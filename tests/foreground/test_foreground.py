"""Background statistics and segmentation on pictures with a known person, shadow, gain and noise."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mocap.foreground import (
    Background,
    ForegroundMask,
    ForegroundSettings,
    Segmenter,
    clean_mask,
    learn_background,
    median_background,
    segment,
)
from mocap.foreground.segment import colour_step

H, W = 120, 160
NOISE = 1.5
# A person 20 x 70 px has an outline of 180 px: 10 % of its area. Measured 0.95-0.99 over 20 seeds.
MIN_IOU = 0.9
SETTINGS = ForegroundSettings(min_area_px=600.0)  # 40 px at this size


def wall(rng: np.random.Generator) -> np.ndarray:
    coarse = rng.uniform(90.0, 170.0, (5, 7, 1)) + rng.uniform(-8.0, 8.0, (5, 7, 3))
    return cv2.resize(coarse, (W, H), interpolation=cv2.INTER_CUBIC)


def photograph(
    scene: np.ndarray, rng: np.random.Generator, gain: float = 1.0, noise: float = NOISE
) -> np.ndarray:
    return np.clip(scene * gain + rng.normal(0.0, noise, scene.shape), 0, 255).astype(np.uint8)


def person_at(column: int) -> np.ndarray:
    mask = np.zeros((H, W), dtype=bool)
    mask[30:100, column : column + 20] = True
    return mask


def with_person(scene: np.ndarray, mask: np.ndarray, colour: tuple[float, float, float]) -> np.ndarray:
    out = scene.copy()
    shadow = np.roll(mask, 25, axis=1).astype(np.float64)
    out *= 1.0 - 0.25 * cv2.GaussianBlur(shadow, (0, 0), 2.0)[:, :, None] * ~mask[:, :, None]
    out[mask] = colour
    return out


def stored(picture: np.ndarray, quality: int) -> np.ndarray:
    """As JPEG leaves it."""
    code = cv2.imencode(".jpg", picture[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return cv2.cvtColor(cv2.imdecode(code, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


def floor(rng: np.random.Generator) -> np.ndarray:
    """640 x 480 pixels whose colour changes little by little."""
    coarse = 95.0 + rng.uniform(-15.0, 15.0, (4, 5, 1)) + rng.uniform(-9.0, 9.0, (4, 5, 3))
    return cv2.resize(coarse, (640, 480), interpolation=cv2.INTER_CUBIC)


def with_person_on_floor(
    scene: np.ndarray, colour: tuple[float, float, float], depth: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The scene with a person and a soft shadow beside him that takes a share of the light; both as masks."""
    mask, dark = np.zeros((2, *scene.shape[:2]), dtype=bool)
    mask[100:380, 150:230] = True
    dark[300:420, 260:520] = True
    out = scene * (1.0 - cv2.GaussianBlur(depth * dark, (0, 0), 6.0))[:, :, None]
    out[mask] = colour
    return out, mask, dark


def check_person_and_shadow(found: ForegroundMask, mask: np.ndarray, dark: np.ndarray) -> None:
    assert np.count_nonzero(found.mask & mask) > 0.97 * np.count_nonzero(mask)
    assert np.count_nonzero(found.mask[:, 250:]) < 0.02 * np.count_nonzero(dark)  # beyond his halo
    assert np.count_nonzero(found.shadow & dark) > 0.8 * np.count_nonzero(dark)


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return np.count_nonzero(a & b) / np.count_nonzero(a | b)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("gain", [1.0, 0.9, 1.12])
def test_person_is_found_and_the_shadow_is_not(seed, gain):
    rng = np.random.default_rng(seed)
    scene = wall(rng)
    segmenter = Segmenter(learn_background(photograph(scene, rng) for _ in range(12)), SETTINGS)
    mask = person_at(50)
    answer = segmenter.segment(photograph(with_person(scene, mask, (60.0, 80.0, 140.0)), rng, gain))
    assert iou(answer.mask, mask) > MIN_IOU
    assert not np.any(answer.mask & answer.shadow)
    shadow = np.roll(mask, 25, axis=1)
    assert np.count_nonzero(answer.shadow & shadow) > 0.8 * np.count_nonzero(shadow)
    assert answer.foreground_share == pytest.approx(np.count_nonzero(answer.mask) / (H * W))
    assert answer.is_usable


def test_grey_shirt_before_a_grey_wall_is_not_taken_for_shadow():
    """Four levels of tint, 0.8 of the brightness: each pixel could be shadow, the window says it is not."""
    rng = np.random.default_rng(2)
    scene = np.full((H, W, 3), (140.0, 138.0, 134.0))
    segmenter = Segmenter(learn_background(photograph(scene, rng) for _ in range(12)), SETTINGS)
    mask = person_at(40)
    shirt = with_person(scene, mask, (110.0, 111.0, 115.0))
    shirt[30:45, 40:60] = (40.0, 30.0, 25.0)  # the head: strong
    answer = segmenter.segment(photograph(shirt, rng))
    assert np.count_nonzero(answer.mask & mask) > 0.9 * np.count_nonzero(mask)


def test_empty_picture_gives_an_empty_mask_and_light_drift_is_followed():
    rng = np.random.default_rng(3)
    scene = wall(rng)
    segmenter = Segmenter(learn_background(photograph(scene, rng) for _ in range(12)), SETTINGS)
    for i in range(40):
        answer = segmenter.segment(photograph(scene, rng, 1.0 + 0.005 * i))
        assert answer.foreground_share == 0.0


def test_a_person_who_stands_still_is_never_absorbed_but_the_background_adapts():
    rng = np.random.default_rng(4)
    scene = wall(rng)
    settings = ForegroundSettings(min_area_px=600.0, adaptation=0.05, compensate_gain=False)
    segmenter = Segmenter(learn_background(photograph(scene, rng) for _ in range(12)), settings)
    mask = person_at(90)
    for i in range(150):
        # A corner of the picture drifts by 18 levels: far beyond the threshold if nothing adapted.
        drifted = scene.copy()
        drifted[:, :60] += 0.12 * i
        answer = segmenter.segment(photograph(with_person(drifted, mask, (60.0, 80.0, 140.0)), rng))
    assert iou(answer.mask, mask) > MIN_IOU
    fixed = Segmenter(learn_background(photograph(scene, rng) for _ in range(12)), ForegroundSettings(
        min_area_px=600.0, adaptation=0.0, compensate_gain=False, shadow_brightest=1.0))  # fmt: skip
    assert fixed.segment(photograph(drifted, rng)).foreground_share > 0.2


def test_background_statistics_are_those_of_the_scene():
    rng = np.random.default_rng(5)
    scene = np.clip(wall(rng), 0, 240)
    background = learn_background(photograph(scene, rng) for _ in range(31))
    # 31 truncated samples: mean half a level low, standard error 0.3.
    assert np.abs(background.mean + 0.5 - scene).mean() < 0.4
    assert background.std.mean() == pytest.approx(NOISE, abs=0.3)
    assert background.n_images == 31
    assert background.kind == "clip"
    assert background.warnings == ()


def test_somebody_who_crosses_the_clip_leaves_no_trace():
    rng = np.random.default_rng(6)
    scene = wall(rng)
    pictures = [
        photograph(with_person(scene, person_at(5 + 4 * i), (60.0, 80.0, 140.0)), rng) for i in range(30)
    ]
    background = median_background(pictures)
    assert background.kind == "median"
    assert background.warnings == ()
    assert np.abs(background.mean + 0.5 - scene).max() < 8.0
    assert background.std.max() < 8.0
    crossed = learn_background(pictures)
    assert "something moves" in crossed.warnings[0]


def test_a_person_who_never_moves_is_reported():
    rng = np.random.default_rng(7)
    still_scene = with_person(wall(rng), person_at(60), (60.0, 80.0, 140.0))
    background = median_background(photograph(still_scene, rng) for _ in range(9))
    assert "hardly anything moves" in background.warnings[0]


def test_long_clips_are_thinned_evenly_in_bounded_memory():
    values = []
    background = learn_background(
        np.full((4, 5, 3), i % 200, dtype=np.uint8) if values.append(i) is None else None for i in range(200)
    )
    assert len(values) == 200
    assert 16 <= background.n_images <= 31


@pytest.mark.parametrize("n_images", [1, 12])
@pytest.mark.parametrize("seed", range(3))
def test_noise_hides_nobody(seed, n_images):
    """Trousers that differ from the wall by 3 standard deviations of a picture taken with too little light."""
    rng = np.random.default_rng(seed)
    scene = wall(rng)
    background = learn_background(photograph(scene, rng, noise=14.0) for _ in range(n_images))
    assert background.is_noisy
    assert not background.warnings  # nothing moves there
    mask = person_at(50)
    shown = with_person(scene, mask, (60.0, 80.0, 140.0))
    shown[65:100, 50:70] = scene[65:100, 50:70] + (42.0, -42.0, -42.0)
    answer = Segmenter(background, SETTINGS).segment(photograph(shown, rng, noise=14.0))
    assert iou(answer.mask, mask) > MIN_IOU
    assert not learn_background(photograph(scene, rng) for _ in range(n_images)).is_noisy


def test_one_still_is_enough_but_not_none():
    rng = np.random.default_rng(8)
    scene = wall(rng)
    background = learn_background([photograph(scene, rng)])
    assert background.kind == "still"
    assert background.std.min() >= 1.5
    mask = person_at(70)
    answer = Segmenter(background, SETTINGS).segment(
        photograph(with_person(scene, mask, (60.0, 80.0, 140.0)), rng)
    )
    assert iou(answer.mask, mask) > MIN_IOU
    with pytest.raises(ValueError, match="at least one picture"):
        learn_background([])
    with pytest.raises(ValueError, match="expected shape"):
        learn_background([np.zeros((4, 5, 3), np.uint8), np.zeros((5, 4, 3), np.uint8)])


@pytest.mark.parametrize("method", ["mog2", "knn"])
def test_opencv_models_are_selectable(method):
    rng = np.random.default_rng(9)
    scene = wall(rng)
    settings = ForegroundSettings(method=method, min_area_px=600.0)
    segmenter = Segmenter(learn_background(photograph(scene, rng) for _ in range(12)), settings)
    mask = person_at(50)
    picture = photograph(with_person(scene, mask, (60.0, 80.0, 140.0)), rng)
    for _ in range(30):
        answer = segmenter.segment(picture)
    assert iou(answer.mask, mask) > 0.8


def test_a_picture_full_of_foreground_is_not_usable():
    rng = np.random.default_rng(10)
    scene = wall(rng)
    segmenter = Segmenter(learn_background(photograph(scene, rng) for _ in range(5)), SETTINGS)
    other = np.zeros_like(scene)
    other[:, :, 0] = 250.0 - scene[:, :, 0]
    answer = segmenter.segment(photograph(other, rng))
    assert not answer.is_usable


def test_mistakes_are_named():
    background = learn_background([np.full((6, 8, 3), 100, np.uint8)] * 3)
    with pytest.raises(ValueError, match="image: expected uint8 of shape"):
        Segmenter(background).segment(np.zeros((8, 6, 3), np.uint8))
    with pytest.raises(ValueError, match="method"):
        ForegroundSettings(method="magic")
    with pytest.raises(ValueError, match="adaptation"):
        ForegroundSettings(adaptation=1.0)
    with pytest.raises(ValueError, match="hold_frames"):
        ForegroundSettings(hold_frames=0)
    with pytest.raises(ValueError, match="roi: expected shape"):
        Segmenter(background, roi=np.ones((8, 6), bool))
    with pytest.raises(ValueError, match="protect: expected bool"):
        Segmenter(background).segment(np.zeros((6, 8, 3), np.uint8), protect=np.ones((6, 8), np.uint8))


def test_clean_mask_fills_small_holes_drops_specks_and_keeps_large_holes():
    mask = np.zeros((480, 640), dtype=bool)
    mask[100:300, 200:300] = True
    mask[140:144, 240:244] = False  # a pinhole
    mask[180:220, 230:260] = False  # the view between arm and body
    mask[20:25, 20:25] = True  # a speck
    cleaned = clean_mask(mask)
    assert cleaned.dtype == np.bool_
    assert cleaned[140:144, 240:244].all()
    assert not cleaned[185:215, 235:255].any()
    assert not cleaned[:60, :60].any()
    assert iou(clean_mask(cleaned), cleaned) == 1.0
    assert not clean_mask(np.zeros((48, 64), dtype=bool)).any()


@pytest.mark.parametrize(("levels", "is_found"), [(17, False), (20, True)])
def test_the_threshold_is_so_many_standard_deviations(levels, is_found):
    """Spread 6, threshold 3 sigma = 18 levels, no slope: a block 17 levels brighter is background, 20 is not."""
    background = Background(
        np.full((H, W, 3), 100.0, np.float32), np.full((H, W, 3), 6.0, np.float32), 9, "clip", 0.0
    )
    settings = ForegroundSettings(min_area_px=600.0, strong_difference=10.0, compensate_gain=False)
    image = np.full((H, W, 3), 100, np.uint8)
    image[30:70, 40:80] += np.uint8(levels)
    answer = Segmenter(background, settings).segment(image)
    # The median of 3 x 3 candidates takes the four corners.
    assert np.count_nonzero(answer.mask) == (40 * 40 - 4 if is_found else 0)


def test_a_gain_of_the_whole_picture_changes_nothing():
    rng = np.random.default_rng(12)
    scene = wall(rng)
    background = learn_background(photograph(scene, rng) for _ in range(12))
    mask = person_at(50)
    still = with_person(scene, mask, (60.0, 80.0, 140.0)) + rng.normal(0.0, NOISE, scene.shape)
    masks = [
        Segmenter(background, SETTINGS).segment(np.clip(still * gain, 0, 255).astype(np.uint8)).mask
        for gain in (1.0, 0.85, 1.2)
    ]
    # Rounding to grey levels moves a few pixels of the outline.
    assert iou(masks[0], masks[1]) > 0.98
    assert iou(masks[0], masks[2]) > 0.98


def test_a_moved_chair_is_absorbed_after_a_while_unless_it_is_protected():
    rng = np.random.default_rng(13)
    scene = wall(rng)
    background = learn_background(photograph(scene, rng) for _ in range(12))
    settings = ForegroundSettings(min_area_px=600.0, hold_frames=64, compensate_gain=False)
    chair = person_at(20)
    person = person_at(110)
    picture = with_person(with_person(scene, chair, (30.0, 40.0, 40.0)), person, (60.0, 80.0, 140.0))
    segmenter = Segmenter(background, settings)
    for i in range(140):
        answer = segmenter.segment(photograph(picture, rng), protect=person)
        assert np.count_nonzero(answer.mask & person) > MIN_IOU * np.count_nonzero(person)
        if i < 64:
            assert iou(answer.mask, person | chair) > MIN_IOU
        if i >= 64 + 16:  # one row in sixteen is absorbed per picture
            assert iou(answer.mask, person) > MIN_IOU
    assert not np.any(answer.mask & chair)
    free = Segmenter(background, settings)
    for _ in range(140):
        answer = free.segment(photograph(picture, rng))
    assert not answer.mask.any()


def test_a_person_who_stands_still_through_a_long_clip_keeps_his_mask():
    rng = np.random.default_rng(14)
    scene = wall(rng)
    background = learn_background(photograph(scene, rng) for _ in range(12))
    segmenter = Segmenter(background, ForegroundSettings(min_area_px=600.0, adaptation=0.02))
    mask = person_at(70)
    picture = with_person(scene, mask, (60.0, 80.0, 140.0))
    first = iou(segmenter.segment(photograph(picture, rng)).mask, mask)
    for _ in range(900):
        answer = segmenter.segment(photograph(picture, rng))
    assert iou(answer.mask, mask) > first - 0.02


@pytest.mark.parametrize("method", ["gaussian", "mog2", "knn"])
def test_nothing_is_foreground_outside_the_region_of_interest(method):
    rng = np.random.default_rng(15)
    scene = wall(rng)
    roi = np.zeros((H, W), dtype=bool)
    roi[:, 80:] = True
    inside, outside = person_at(110), person_at(30)
    picture = with_person(with_person(scene, inside, (60.0, 80.0, 140.0)), outside, (30.0, 60.0, 40.0))
    background = learn_background(photograph(scene, rng) for _ in range(12))
    settings = ForegroundSettings(method=method, min_area_px=600.0)
    answer = Segmenter(background, settings, roi=roi).segment(photograph(picture, rng))
    assert not np.any((answer.mask | answer.shadow) & ~roi)
    assert np.count_nonzero(answer.mask & inside) > 0.8 * np.count_nonzero(inside)


@pytest.mark.parametrize("quality", [30, 50])
def test_colour_that_compression_smears_is_nobody(quality):
    """A red person in pictures as cheap cameras store them; without the rule blocks of 16 x 16 pixels hang on him."""
    rng = np.random.default_rng(17)
    scene = np.full((H, W, 3), (140.0, 138.0, 134.0))
    mask = person_at(55)

    background = learn_background(stored(photograph(scene, rng), quality) for _ in range(12))
    dressed = np.where(mask[:, :, None], (200.0, 40.0, 50.0), scene)
    picture = stored(photograph(dressed, rng), quality)
    found = Segmenter(background, SETTINGS).segment(picture).mask
    far = cv2.dilate(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) == 0
    assert np.count_nonzero(found & mask) > 0.97 * np.count_nonzero(mask)
    assert np.count_nonzero(found & far) < 0.05 * np.count_nonzero(mask)
    blunt = (
        Segmenter(background, ForegroundSettings(min_area_px=600.0, smeared_share=0.0)).segment(picture).mask
    )
    assert np.count_nonzero(blunt & far) > 0.2 * np.count_nonzero(mask)


@pytest.mark.parametrize(("quality", "step"), [(95, 1), (50, 2), (35, 3), (20, 5)])
def test_the_step_in_which_compression_has_rounded_colours_is_read(quality, step):
    rng = np.random.default_rng(18)
    picture = stored(photograph(floor(rng), rng), quality)
    assert colour_step(picture) == step
    assert colour_step(cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)) == step


def flat(*stripes: tuple[int, int, int], width: int = 640) -> np.ndarray:
    """Stripes of so many pixels side by side, over and over."""
    columns = np.arange(640) // width % len(stripes)
    return np.broadcast_to(np.array(stripes, np.uint8)[columns], (480, 640, 3)).copy()


def uneven(picture: np.ndarray) -> np.ndarray:
    """With red and blue that rise by 3 levels from pixel to pixel, over 8 pixels again and again."""
    return picture + np.array([1, 0, 1], np.uint8) * (np.arange(640) % 8 * 3).astype(np.uint8)[:, None]


@pytest.mark.parametrize(
    ("picture", "step"),
    [
        (flat((90, 90, 90)), 1),
        (flat((90, 90, 90), (86, 90, 97), width=320), 1),  # one border of two things
        (flat((90, 90, 90), (86, 90, 97), width=32), 3),
        (flat((90, 90, 90), (60, 80, 140), width=32), 1),  # no compression is as coarse
        (flat((90, 90, 90), (89, 90, 92), (80, 88, 106), (92, 88, 86), width=32), 1),  # no two alike
        (uneven(flat((90, 90, 90), (86, 90, 97), width=32)), 1),
        (np.random.default_rng(19).integers(0, 255, (480, 640, 3), dtype=np.uint8), 1),
        (np.zeros((4, 4, 3), np.uint8), 1),
    ],
)
def test_a_step_is_read_where_many_even_blocks_are_one_apart(picture, step):
    assert colour_step(picture) == step


@pytest.mark.parametrize("gain", [1.0, 0.93])  # of the recording: dividing it out leaves no even steps
@pytest.mark.parametrize("quality", [20, 35])
def test_a_shadow_in_rounded_colours_is_nobody(monkeypatch, quality, gain):
    """A shadow on the floor takes colour with the light, and rounding gives each block more of it back, or less."""
    rng = np.random.default_rng(20)
    scene = floor(rng)
    dressed, mask, dark = with_person_on_floor(scene, (50.0, 75.0, 130.0), 0.25)
    background = learn_background(stored(photograph(scene, rng), quality) for _ in range(12))
    picture = stored(photograph(dressed, rng, gain), quality)
    found = Segmenter(background).segment(picture)
    check_person_and_shadow(found, mask, dark)
    monkeypatch.setattr(segment, "_COARSE", 0.0)
    blunt = Segmenter(background).segment(picture)
    assert np.count_nonzero(blunt.mask & dark) > 0.1 * np.count_nonzero(dark)


@pytest.mark.parametrize("exposure", [1.5, 1.55])
def test_a_shadow_on_an_overexposed_floor_is_nobody(exposure):
    """Its red is full, so that a shadow takes green and blue alone; skin is as red as that, but not of its colour."""
    rng = np.random.default_rng(21)
    scene = floor(rng) + np.array([75.0, 40.0, 35.0])
    dressed, mask, dark = with_person_on_floor(scene, (160.0, 110.0, 70.0), 0.3)
    background = learn_background(photograph(scene, rng, exposure) for _ in range(12))
    assert np.mean(background.mean[..., 0] > 250) > 0.5
    check_person_and_shadow(Segmenter(background).segment(photograph(dressed, rng, exposure)), mask, dark)


@pytest.mark.parametrize(
    ("floor", "red"),
    [((255, 255, 255), None), ((255, 190, 180), 255), ((255, 190, 180), 235), ((255, 190, 180), 201)],
)
def test_full_values_of_a_shadow_may_be_as_bright_as_recorded_and_some_more(floor, red):
    """A light of four fifths is left; red would be 204 by what was recorded."""
    scene = np.full((H, W, 3), floor, np.uint8)
    background = Background(scene.astype(np.float32), np.ones(scene.shape, np.float32), 9, "clip", 0.0)
    light = np.full((H, W), 1.0)
    light[30:90, 40:120] = 0.8
    light = cv2.GaussianBlur(light, (0, 0), 4.0)[:, :, None]
    picture = scene * light
    if red is not None:
        picture[..., 0] = 255 - (255 - red) * (1.0 - light[..., 0]) / 0.2
    answer = Segmenter(background, ForegroundSettings(compensate_gain=False)).segment(
        picture.round().astype(np.uint8)
    )
    is_shadow = red is None or red < 240
    inner = (slice(45, 75), slice(55, 105))
    assert answer.shadow[inner].mean() == pytest.approx(1.0 if is_shadow else 0.0, abs=0.05)
    assert answer.mask[inner].mean() == pytest.approx(0.0 if is_shadow else 1.0, abs=0.05)


@pytest.mark.parametrize("wall", [(255, 252, 240), (255, 254, 253), (255, 255, 255)])
@pytest.mark.parametrize("colour", [(205, 150, 140), (210, 175, 150), (170, 200, 190)])
def test_skin_and_pale_clothes_before_an_overexposed_wall_are_no_shadow(wall, colour):
    scene = np.full((H, W, 3), wall, np.uint8)
    background = Background(scene.astype(np.float32), np.ones(scene.shape, np.float32), 9, "clip", 0.0)
    mask = person_at(60)
    picture = scene.copy()
    picture[mask] = colour
    found = Segmenter(background, SETTINGS).segment(picture)
    assert np.count_nonzero(found.mask & mask) > 0.9 * np.count_nonzero(mask)


@pytest.mark.parametrize(
    ("colour", "beside_px", "is_found"),
    [
        ((100, 104, 124), 4, False),  # as bright as the room, and a tenth as blue as what is beside
        ((100, 104, 124), 40, True),  # the same where nothing else is in the block
        ((86, 92, 116), 4, True),  # eleven levels darker
        ((92, 98, 174), 4, True),  # as blue as a third of it
        ((104, 92, 165), 4, True),  # with no red more than the room
        ((160, 76, 104), 4, True),  # with no blue more than the room
    ],
)
def test_faint_colour_counts_unless_a_strong_one_is_in_its_block(colour, beside_px, is_found):
    scene = np.full((H, W, 3), 104, np.uint8)
    background = Background(scene.astype(np.float32), np.full((H, W, 3), 1.0, np.float32), 9, "clip", 0.0)
    picture = scene.copy()
    picture[30:90, 20:40] = (64, 72, 255)  # 23 levels darker
    faint = np.zeros((H, W), bool)
    faint[40:80, 40 + beside_px : 60 + beside_px] = True
    picture[faint] = colour
    settings = ForegroundSettings(min_area_px=600.0, strong_difference=10.0, compensate_gain=False)
    near = np.zeros((H, W), bool)
    near[:, : 40 + 14] = True  # a whole block from the strong colour on
    part = faint & (near if beside_px < 16 else True)
    found = Segmenter(background, settings).segment(picture).mask
    assert found[part].mean() == pytest.approx(1.0 if is_found else 0.0, abs=0.1)


@pytest.mark.parametrize("width", [6, 12])
def test_smeared_colour_closes_no_gap_and_fills_no_hole(width):
    """The view between an arm and the body, open or enclosed, tinted by both."""
    scene = np.full((480, 640, 3), 104, np.uint8)
    background = Background(scene.astype(np.float32), np.ones(scene.shape, np.float32), 9, "clip", 0.0)
    picture = scene.copy()
    picture[100:300, 200:300] = (64, 72, 255)
    gap, hole = (slice(140, 300), slice(240, 240 + width)), (slice(180, 200), slice(260, 260 + width))
    picture[gap] = picture[hole] = (100, 104, 124)
    masks = [
        Segmenter(background, ForegroundSettings(smeared_share=s)).segment(picture).mask for s in (0.0, 0.25)
    ]
    assert [mask[gap][20:-20].mean() for mask in masks] == [1.0, 0.0]
    assert masks[0][hole].all()
    assert masks[1][hole].mean() < 0.3


def test_an_answer_does_not_depend_on_other_persons_far_away():
    """Windows are looked at one by one: two persons together give the union of each alone."""
    rng = np.random.default_rng(16)
    scene = wall(rng)
    background = learn_background(photograph(scene, rng) for _ in range(12))
    settings = ForegroundSettings(min_area_px=600.0, compensate_gain=False)
    noise = rng.normal(0.0, NOISE, scene.shape)
    left, right = np.zeros((H, W), bool), np.zeros((H, W), bool)
    left[30:100, 8:28] = True
    right[30:100, 130:150] = True

    def masks_of(*who):
        picture = scene.copy()
        for mask in who:
            picture[mask] = (60.0, 80.0, 140.0)
        return Segmenter(background, settings).segment(np.clip(picture + noise, 0, 255).astype(np.uint8)).mask

    np.testing.assert_array_equal(masks_of(left, right), masks_of(left) | masks_of(right))


@pytest.mark.parametrize("change", [-0.3, 0.3])
def test_a_lamp_that_lights_half_of_the_room_is_no_person(change):
    rng = np.random.default_rng(12)
    scene = 0.75 * wall(rng)
    background = learn_background(photograph(scene, rng) for _ in range(12))
    light = 1 + change / (1 + np.exp(-(np.arange(W) - 80.0) / 20.0))
    mask = np.zeros((H, W), dtype=bool)
    mask[30:100, 22:36] = True
    lit = np.where(mask[:, :, None], (40.0, 60.0, 110.0), scene) * light[None, :, None]
    segmenter = Segmenter(background, SETTINGS)
    assert iou(segmenter.segment(photograph(lit, rng)).mask, mask) > MIN_IOU
    if change > 0:  # what becomes darker passes for a shadow
        blunt = Segmenter(background, ForegroundSettings(min_area_px=600.0, compensate_gain=False))
        assert iou(blunt.segment(photograph(lit, rng)).mask, mask) < 0.3


def test_a_large_person_is_no_change_of_the_light():
    rng = np.random.default_rng(13)
    scene = wall(rng)
    segmenter = Segmenter(learn_background(photograph(scene, rng) for _ in range(12)), SETTINGS)
    mask = np.zeros((H, W), dtype=bool)
    mask[20:110, 50:90] = True  # a fifth of the picture
    picture = photograph(with_person(scene, mask, (60.0, 80.0, 140.0)), rng)
    assert iou(segmenter.segment(picture).mask, mask) > MIN_IOU


@pytest.mark.parametrize("pictures_before", range(4))
def test_light_that_jumps_is_followed_at_once_whenever_it_does(pictures_before):
    """A lamp at one side; afterwards all is foreground for who does not divide it out, and he never gets free again."""
    rng = np.random.default_rng(14)
    scene = 0.6 * wall(rng)
    segmenter = Segmenter(learn_background(photograph(scene, rng) for _ in range(12)), SETTINGS)
    mask = person_at(30)
    lit = np.where(mask[:, :, None], (40.0, 60.0, 110.0), scene)
    for _ in range(pictures_before):
        segmenter.segment(photograph(lit, rng))
    light = np.linspace(1.0, 1.5, W)[None, :, None]
    assert iou(segmenter.segment(photograph(lit * light, rng)).mask, mask) > 0.8
    assert iou(segmenter.segment(photograph(lit * 1.6, rng)).mask, mask) > 0.8


def test_a_mask_of_everything_does_not_hide_the_light_for_good():
    rng = np.random.default_rng(15)
    scene = 0.6 * wall(rng)
    segmenter = Segmenter(learn_background(photograph(scene, rng) for _ in range(12)), SETTINGS)
    segmenter.segment(np.full((H, W, 3), 250, np.uint8))  # something stands before the lens
    mask = person_at(30)
    lit = np.where(mask[:, :, None], (40.0, 60.0, 110.0), scene)
    assert iou(segmenter.segment(photograph(1.3 * lit, rng)).mask, mask) > 0.85


def test_a_recording_that_is_noisier_than_the_empty_clip():
    rng = np.random.default_rng(16)
    scene = wall(rng)
    segmenter = Segmenter(learn_background(photograph(scene, rng) for _ in range(12)), SETTINGS)
    mask = person_at(60)
    picture = with_person(scene, mask, (40.0, 60.0, 140.0)) + rng.normal(0, 9, scene.shape)
    found = segmenter.segment(np.clip(picture, 0, 255).astype(np.uint8)).mask
    assert iou(found, mask) > 0.85
    clean = segmenter.segment(photograph(with_person(scene, mask, (40.0, 60.0, 140.0)), rng)).mask
    assert iou(clean, mask) > MIN_IOU  # and back


def test_strong_compression_makes_no_persons_of_shadows():
    """Compression moves the colour of whole blocks; an empty clip that was not compressed knows nothing of it."""
    rng = np.random.default_rng(17)
    scene = cv2.resize(wall(rng), (4 * W, 4 * H))
    noise = [rng.normal(0, NOISE, scene.shape) for _ in range(4)]
    segmenter = Segmenter(learn_background(np.clip(scene + n, 0, 255).astype(np.uint8) for n in noise))
    mask = np.zeros((4 * H, 4 * W), dtype=bool)
    mask[120:400, 240:320] = True
    picture = np.clip(with_person(scene, mask, (40.0, 60.0, 140.0)), 0, 255).astype(np.uint8)
    shadow = cv2.dilate(np.roll(mask, 25, axis=1).astype(np.uint8), np.ones((9, 9))) > 0
    data = cv2.imencode(".jpg", picture[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 12])[1]
    poor = np.ascontiguousarray(cv2.imdecode(data, cv2.IMREAD_COLOR)[:, :, ::-1])
    found = segmenter.segment(poor).mask
    assert iou(found, mask) > 0.85
    assert np.count_nonzero(found & shadow & ~mask) < 0.15 * np.count_nonzero(shadow & ~mask)


def grey(picture: np.ndarray) -> np.ndarray:
    return np.dstack([picture[..., 1]] * 3)


def test_a_camera_without_colours_is_told_by_its_pictures() -> None:
    """Also when compression has given them a tint, other in the empty clip than in the recording."""
    rng = np.random.default_rng(30)
    pictures = [photograph(np.full((H, W, 3), 120.0), rng) for _ in range(10)]
    tinted = [grey(picture) + np.array([7, 0, 3], np.uint8) for picture in pictures]
    background = learn_background(tinted)
    assert background.is_grey
    assert learn_background(tinted[:1]).is_grey
    assert median_background(tinted).is_grey
    found = Segmenter(background, SETTINGS).segment(grey(pictures[0]))
    assert not found.mask.any()
    # Half a per cent of colour in one of them, as a red lamp has, is no rounding.
    tinted[3][:8, :12, 0] = 250
    assert not learn_background(tinted).is_grey


def test_a_colour_camera_before_a_grey_wall_sees_colours() -> None:
    """Its noise differs from channel to channel."""
    rng = np.random.default_rng(31)
    scene = np.full((H, W, 3), 120.0)
    assert not learn_background(
        photograph(scene + rng.normal(0, 2, scene.shape), rng) for _ in range(10)
    ).is_grey


def test_folds_and_limbs_are_no_shadow_without_colours() -> None:
    """A person whose brightness changes by 0.04 of the wall's per pixel, as round a limb, has nothing else to tell him
    from a shadow; one that changes softly is taken for one."""
    rng = np.random.default_rng(31)
    scene = np.full((H, W, 3), 150.0)
    background = learn_background([photograph(scene, rng, 1.0)[..., :1].repeat(3, axis=2) for _ in range(20)])
    mask = person_at(70)
    across = np.abs(np.arange(W) - 79.5)[None, :, None]
    found = {}
    for name, slope in (("round", 0.04), ("soft", 0.005)):
        person = np.broadcast_to(150.0 * (0.95 - slope * across), scene.shape)
        picture = np.where(mask[..., None], person, scene)
        shown = photograph(picture, rng)[..., :1].repeat(3, axis=2)
        found[name] = Segmenter(background, SETTINGS).segment(shown)
    assert np.count_nonzero(found["round"].mask & mask) > 0.9 * mask.sum()
    assert np.count_nonzero(found["soft"].shadow & mask) > 0.5 * mask.sum()
    coloured = Segmenter(background, ForegroundSettings(min_area_px=600.0, grey_edge=0.07, grey_window_px=5))
    assert np.count_nonzero(coloured.segment(shown).mask & mask) < 0.5 * mask.sum()

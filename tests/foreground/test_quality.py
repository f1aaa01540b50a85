"""Quality of masks with known defects: numbers in closed form, advice for the right camera."""

from __future__ import annotations

import numpy as np
import pytest

from mocap.foreground import mask_quality, triples_of

H, W = 60, 90


def body(column: int) -> np.ndarray:
    mask = np.zeros((H, W), dtype=bool)
    mask[10:50, column : column + 20] = True
    return mask


def test_a_person_who_walks_does_not_flicker() -> None:
    frames = [[body(10 + 3 * i), body(12)] for i in range(12)]
    moving, still = mask_quality(["c1", "c2"], triples_of(frames))
    assert moving.flicker == 0.0
    assert still.flicker == 0.0
    assert moving.foreground_share == pytest.approx(800 / (H * W))
    assert moving.leakage == 0.0
    assert moving.border_share == 0.0
    assert np.isnan(moving.shadow_share)
    assert np.isnan(moving.residual)
    assert moving.advice == still.advice == ()


def test_flicker_and_leakage_are_counted() -> None:
    steady, hole, speck = body(30), body(30), body(30)
    hole[25:31, 36:42] = False  # 36 px inside, in every other frame
    speck[2:6, 70:75] = True  # 20 px apart, always
    frames = [[hole if i % 2 else steady, speck] for i in range(9)]
    flickering, leaking = mask_quality(["c1", "c2"], triples_of(frames))
    # Frames 1 to 7: in four the hole is there, 36 px that both neighbours lack. In three it is not; of the neighbours'
    # holes only the 2 x 2 px count whose 5 x 5 square lies in them.
    assert flickering.flicker == pytest.approx((4 * 36 + 3 * 4) / (4 * (800 - 36) + 3 * 800))
    assert "flicker" in flickering.advice[0]
    assert flickering.advice[0].startswith("camera c1:")
    assert "Remedy:" in flickering.advice[0]
    assert leaking.leakage == pytest.approx(20 / 820)
    assert leaking.flicker == 0.0


def with_arm(column: int, *, arm: int | None = None, hole: bool = False) -> np.ndarray:
    """A body at a column, with an arm of 24 x 6 px that hangs on it at a row, and with a hole of 8 x 8 px."""
    mask = body(column)
    if arm is not None:
        mask[arm : arm + 6, column + 20 : column + 44] = True
    if hole:
        mask[26:34, 16:24] = False
    return mask


@pytest.mark.parametrize(("step", "is_told"), [(8, False), (0, True), (1, True)])
def test_thin_parts_that_move_fast_are_no_flicker(step: int, is_told: bool) -> None:
    """An arm swings 12 rows a frame on somebody who walks; on somebody who stands it is there in one frame only."""
    frames = [[with_arm(10 + step * i, arm=14 + 12 * (i % 3))] for i in range(3)]
    if is_told:
        frames = [[with_arm(10 + step * (i // 2), arm=26 if i == 1 else None)] for i in range(3)]
    (found,) = mask_quality(["c"], triples_of(frames))
    n = 24 * 6 + 800
    assert found.flicker == (pytest.approx((24 - (step > 0)) * 6 / n, abs=15 / n) if is_told else 0.0)


def test_what_flickers_inside_somebody_who_moves_is_told() -> None:
    frames = [[with_arm(6 + 2 * i, hole=i % 2 == 1)] for i in range(5)]
    (found,) = mask_quality(["c"], triples_of(frames))
    holes = 2 * 64 + 1 * 16  # of a hole in both neighbours 4 x 4 px have a 5 x 5 square in it
    assert found.flicker == pytest.approx(holes / (2 * (800 - 64) + 800))


def test_tables_give_shares_and_advice() -> None:
    n = 8
    cut = body(0)
    shadows = np.tile([0.2, 0.01], (n, 1))
    usable = np.ones((n, 2), dtype=bool)
    usable[:3, 1] = False
    uncovered = np.full((n, 2), 0.03)
    uncovered[:, 0] = [0.3, np.nan] * 4
    first, second = mask_quality(
        ["c1", "c2"],
        triples_of([[cut, body(40)]] * 5),
        shadow_share=shadows,
        is_usable=usable,
        uncovered=uncovered,
    )
    assert first.shadow_share == pytest.approx(0.2)
    assert first.border_share == 1.0
    assert first.residual == pytest.approx(0.3)
    assert second.unusable_share == pytest.approx(3 / 8)
    assert [any(word in a for a in first.advice) for word in ("shadows", "border", "outside the volume")] == [
        True
    ] * 3
    assert len(second.advice) == 1
    assert "fills most of the picture" in second.advice[0]


def test_camera_order_does_not_matter() -> None:
    frames = [[body(10 + 2 * i), body(40 - i)] for i in range(6)]
    one = mask_quality(["a", "b"], triples_of(frames))
    other = mask_quality(["b", "a"], triples_of([[right, left] for left, right in frames]))
    assert [repr(q) for q in one] == [repr(q) for q in reversed(other)]


def test_empty_input_and_mistakes() -> None:
    (nothing,) = mask_quality(["c1"], [])
    assert np.isnan(nothing.flicker)
    assert nothing.advice == ()
    (empty,) = mask_quality(["c1"], triples_of([[np.zeros((H, W), bool)]] * 3))
    assert np.isnan(empty.leakage)
    assert "no foreground" in empty.advice[0]
    (full,) = mask_quality(["c1"], triples_of([[np.ones((H, W), bool)]] * 3))
    assert full.foreground_share == 1.0
    assert full.flicker == 0.0
    with pytest.raises(ValueError, match="expected 2 masks per frame"):
        mask_quality(["a", "b"], triples_of([[body(3)]] * 3))
    with pytest.raises(ValueError, match="uncovered: expected shape"):
        mask_quality(["a", "b"], [], uncovered=np.zeros((4, 3)))
    with pytest.raises(ValueError, match="three masks of shape"):
        mask_quality(["a"], [([body(3)], [body(3)[:-1]], [body(3)])])

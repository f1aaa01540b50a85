"""Depth maps beside their pictures: how they are turned about is told by what moves in both."""

from __future__ import annotations

import numpy as np
import pytest

from mocap.volume.depth_turns import find_turn

HEIGHT, WIDTH, N = 120, 200, 9
ROOM_M, NEAR_M = 4.0, 2.5


def box(frame: int) -> tuple[int, int, int, int]:
    """Columns and rows of somebody who walks through the upper right of the picture."""
    left = 100 + 8 * frame
    return left, left + 30, 10, 70


def maps() -> list[np.ndarray]:
    out = []
    for frame in range(N):
        depth = np.full((HEIGHT, WIDTH), ROOM_M, dtype=np.float32)
        left, right, top, bottom = box(frame)
        depth[top:bottom, left:right] = NEAR_M
        depth[:, :5] = 0.0  # no reading
        out.append(depth)
    return out


def hulls(shift: int = 0) -> list[np.ndarray]:
    out = []
    for frame in range(N):
        left, right, top, bottom = box(frame)
        corners = [[left, top], [right, top], [right, bottom], [left, bottom]]
        out.append(np.add(corners, [shift, 0.0]))
    return out


def test_maps_that_lie_on_their_pictures_agree() -> None:
    found = find_turn(maps(), hulls())
    assert found is not None
    assert (found.beside_share, found.turn, found.agrees) == (0.0, "", True)
    # What silhouettes lack in some frames says nothing.
    some = [np.zeros((0, 2)) if frame % 3 == 0 else hull for frame, hull in enumerate(hulls())]
    again = find_turn(maps(), some)
    assert again is not None
    assert again.beside_share == 0.0


@pytest.mark.parametrize(
    ("turn", "axes"),
    [
        ("mirrored, left for right", (1,)),
        ("mirrored, top for bottom", (0,)),
        ("turned by half a turn", (0, 1)),
    ],
)
def test_turned_maps_are_named(turn: str, axes: tuple[int, ...]) -> None:
    found = find_turn([np.flip(one, axes) for one in maps()], hulls())
    assert found is not None
    assert found.turn == turn
    assert not found.agrees
    assert found.beside_share > 0.5
    assert found.explained_share < 0.1  # the grain of four pixels


def test_maps_of_another_place_are_told_and_not_explained() -> None:
    found = find_turn(maps(), hulls(shift=-100))
    assert found is not None
    assert (found.turn, found.agrees) == ("", False)
    assert found.beside_share == 1.0


def test_maps_a_little_beside_their_pictures_are_not_blamed() -> None:
    """Maps of the frame before: 8 of 30 columns lie beside."""
    found = find_turn(maps(), [hulls()[0], *hulls()[:-1]])
    assert found is not None
    assert 0.1 < found.beside_share < 0.4
    assert found.agrees


def test_where_nothing_moves_nothing_is_said() -> None:
    still = [np.full((HEIGHT, WIDTH), ROOM_M, dtype=np.float32)] * N
    assert find_turn(still, hulls()) is None
    assert find_turn(maps(), [np.zeros((0, 2))] * N) is None

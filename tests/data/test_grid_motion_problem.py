"""Voxel grid, hull, motion, tracks, layout, skeleton: indices and shapes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocap.data import LANDMARKS, Hull, Motion, Skeleton, StateLayout, Tracks, VoxelGrid

GRID = VoxelGrid(np.array([-0.5, 0.25, 0.0]), (7, 5, 11), 0.05)


def test_linear_index_is_c_order() -> None:
    subs = np.array([[0, 0, 0], [0, 0, 1], [0, 1, 0], [1, 0, 0], [6, 4, 10]])
    np.testing.assert_array_equal(GRID.linear(subs), [0, 1, 11, 55, GRID.n_voxels - 1])
    np.testing.assert_array_equal(np.ravel_multi_index(tuple(subs.T), GRID.shape), GRID.linear(subs))
    assert GRID.linear(subs).dtype == np.int32


def test_subscripts_and_centers_are_those_of_numpy() -> None:
    voxels = np.random.default_rng(2).integers(0, GRID.n_voxels, 50).astype(np.int32)
    expected = np.column_stack(np.unravel_index(voxels, GRID.shape))
    np.testing.assert_array_equal(GRID.subscripts(voxels), expected)
    np.testing.assert_array_equal(GRID.centers(voxels), GRID.origin + (expected + 0.5) * GRID.voxel_size_m)
    assert GRID.centers(voxels[:0]).shape == GRID.subscripts(voxels[:0]).shape == (0, 3)


def test_subscripts_linear_centers_and_voxels_of_round_trip() -> None:
    every = np.arange(GRID.n_voxels, dtype=np.int32)
    np.testing.assert_array_equal(GRID.linear(GRID.subscripts(every)), every)
    np.testing.assert_array_equal(GRID.voxels_of(GRID.centers(every)), every)
    dense = GRID.dense(every[::3])
    assert dense.shape == (7, 5, 11)
    np.testing.assert_array_equal(np.flatnonzero(dense), every[::3])


def test_points_outside_or_nan_have_no_voxel() -> None:
    points = np.array([[-0.51, 0.3, 0.1], [0.0, 0.3, 0.56], [np.nan, 0.3, 0.1], [-0.5, 0.25, 0.0]])
    assert GRID.voxels_of(points).tolist() == [-1, -1, -1, 0]
    exact = VoxelGrid(np.zeros(3), (2, 3, 5), 0.5)
    walls = np.array([[1.0, 0.1, 0.1], [0.1, 1.5, 0.1], [0.1, 0.1, 2.5], [0.99, 1.49, 2.49]])
    assert exact.voxels_of(walls).tolist() == [-1, -1, -1, 29], "the upper walls are outside"


def test_voxels_at_walls_and_points_below_the_ceiling() -> None:
    subs = np.array([[0, 2, 5], [6, 2, 5], [3, 0, 5], [3, 4, 5], [3, 2, 10], [3, 2, 0], [6, 4, 10]])
    walls = np.vstack([np.eye(5), np.zeros((1, 5)), [[0, 1, 0, 1, 1]]])
    np.testing.assert_array_equal(GRID.at_walls(GRID.linear(subs)).T, walls > 0)
    points = np.array(
        [[-0.4, 0.3, -0.2], [-0.4, 0.3, 0.5], [-0.4, 0.3, 0.56], [-0.6, 0.3, 0.1], [-0.4, 0.51, 0.1]]
    )
    assert GRID.is_below_ceiling(points).tolist() == [True, True, False, False, False]
    assert points[0, 2] == -0.2, "what was asked about is not changed"


@given(
    lower=st.tuples(*[st.floats(-5, 5)] * 3),
    extent=st.tuples(*[st.floats(0.05, 3)] * 3),
    size=st.floats(0.02, 0.3),
)
def test_a_grid_covers_its_bounds_and_little_more(
    lower: tuple[float, ...], extent: tuple[float, ...], size: float
) -> None:
    low = np.array(lower)
    high = low + np.array(extent)
    grid = VoxelGrid.from_bounds(low, high, size)
    assert np.all(grid.upper >= high - 1e-6)
    assert np.all(grid.upper < high + size + 1e-6)


def test_whole_numbers_of_voxels_get_no_extra_layer() -> None:
    grid = VoxelGrid.from_bounds(np.array([-2.5, -2.0, 0.0]), np.array([2.5, 2.0, 2.2]), 0.02)
    assert grid.shape == (250, 200, 110)


def test_impossible_grids_are_refused() -> None:
    with pytest.raises(ValueError, match="empty grid"):
        VoxelGrid(np.zeros(3), (3, 0, 2), 0.1)
    with pytest.raises(ValueError, match="empty grid"):
        VoxelGrid(np.zeros(3), (3, 1, 2), float("nan"))
    with pytest.raises(ValueError, match="too large"):
        VoxelGrid(np.zeros(3), (2000, 2000, 600), 0.01)
    with pytest.raises(ValueError, match="origin"):
        VoxelGrid(np.array([0.0, np.inf, 0.0]), (3, 1, 2), 0.1)
    with pytest.raises(ValueError, match="room bounds are empty"):
        VoxelGrid.from_bounds(np.zeros(3), np.array([1.0, 0.0, 2.0]), 0.1)


def test_hull_volume_and_selection() -> None:
    voxels = np.array([3, 8, 20, 21], dtype=np.int32)
    hull = Hull(
        GRID,
        voxels,
        np.array([True, False, True, True]),
        np.arange(4, dtype=np.uint8),
        np.ones((4, 3), np.uint8),
    )
    assert hull.volume_litres == pytest.approx(4 * 0.05**3 * 1000)
    assert len(hull) == 4
    part = hull.select(np.array([False, True, True, False]))
    assert part.voxels.tolist() == [8, 20]
    assert part.n_views.tolist() == [1, 2]
    np.testing.assert_allclose(part.centers, GRID.centers(voxels[1:3]))


def test_motion_and_tracks() -> None:
    T = 4
    motion = Motion(1, np.arange(T), np.arange(T) / 25, np.zeros((T, len(LANDMARKS), 3)))
    assert len(motion) == T
    with pytest.raises(ValueError, match="landmarks has shape"):
        Motion(1, np.arange(T), np.arange(T) / 25, np.zeros((T, 14, 3)))
    tracks = Tracks(
        np.array([0, 0, 1]), np.array([2, 5, 5]), np.array([0.0, 0.0, 0.04]), np.arange(9.0).reshape(3, 3)
    )
    assert tracks.persons == (2, 5)
    assert tracks.of(5).frame.tolist() == [0, 1]
    np.testing.assert_array_equal(tracks.of(2).xyz, [[0.0, 1.0, 2.0]])
    assert len(tracks.of(77)) == 0


def layout(**changes: object) -> StateLayout:
    values: dict[str, object] = {
        "names": ("x", "a", "b", "c"),
        "lower": np.array([-np.inf, -1.0, -np.inf, 0.0]),
        "upper": np.array([np.inf, 1.0, np.inf, 2.0]),
        "is_circular": np.array([False, False, True, False]),
        "parts": ("root", "arm"),
        "part_of_column": np.array([0, 0, 1, 1]),
        "parent_of_part": np.array([-1, 0]),
    }
    return StateLayout(**{**values, **changes})  # type: ignore[arg-type]


def test_layout_names_columns_and_parts() -> None:
    assert layout().n_columns == 4
    assert layout().n_parts == 2
    assert layout().columns_of(1).tolist() == [2, 3]
    assert layout().columns_of([0, 1]).tolist() == [0, 1, 2, 3]
    assert layout().columns_of(()).tolist() == []
    for changes, message in (
        ({"lower": np.zeros(3)}, "lower has shape"),
        ({"upper": np.full(4, -2.0)}, "above its upper"),
        ({"lower": np.array([0.0, np.nan, 0.0, 0.0])}, "above its upper"),
        ({"parent_of_part": np.array([-1, 1])}, "tree"),
        ({"parent_of_part": np.array([0, 0])}, "tree"),
    ):
        with pytest.raises(ValueError, match=message):
            layout(**changes)


def test_skeleton_positions_follow_the_chain() -> None:
    """Closed form: two quarter turns about z fold a chain of two unit bones into a corner."""
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    skeleton = Skeleton(
        1,
        ("root", "a", "b"),
        np.array([-1, 0, 1]),
        np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]),
        {2: np.array([1.0, 0.0, 0.0])},
        np.stack([np.stack([quarter, quarter, np.eye(3)])]),
        np.array([[5.0, 6.0, 7.0]]),
    )
    expected = [[5.0, 6.0, 7.0], [5.0, 7.0, 7.0], [4.0, 7.0, 7.0]]
    np.testing.assert_allclose(skeleton.global_positions()[0], expected, atol=1e-12)

"""The comparison over the width of the filters' walk, and how the page counts its runs."""

import numpy as np

from eval.decomposition.cells import STEP_WIDTHS, WORLDS, SceneKey, scene_of
from eval.decomposition.tables import Seeds
from eval.decomposition_page import runs_of
from eval.decomposition_steps import steps_table

SEEDS = Seeds(scenes=(0, 1), runs=(0, 1, 2), n_workers=1, is_full=False, n_frames=5)


def test_only_the_filters_walk_changes_not_the_motion() -> None:
    base = WORLDS["sw"]
    truth = scene_of(SceneKey("sw", 2, 3, n_frames=5)).states
    for percent in STEP_WIDTHS:
        world = WORLDS[f"step_{percent}"]
        np.testing.assert_allclose(world.std_px, base.std_px * percent / 100)
        np.testing.assert_allclose(world.std_rad, base.std_rad * percent / 100)
        assert (world.scene, world.likelihood) == (base.scene, base.likelihood)
        np.testing.assert_array_equal(scene_of(SceneKey(f"step_{percent}", 2, 3, n_frames=5)).states, truth)


def test_every_order_compares_two_methods_of_its_cell() -> None:
    table = steps_table(SEEDS)
    found: dict[tuple[str, ...], dict[str, int]] = {}
    for cell in table.cells:
        row = cell.key()
        key = tuple(row[field] for field in table.cell_fields)
        names = found.setdefault(key, {})
        names[table.name_of(row)] = names.get(table.name_of(row), 0) + 1
    assert set(found) == {("3", "300")}
    for key, names in found.items():
        assert set(names.values()) == {6}, "each method has all scenes and runs"
        for better, worse, _ in table.pairs(key):
            assert {better, worse} <= set(names)
            assert better != worse


def test_runs_per_cell_are_a_number_or_a_range() -> None:
    assert runs_of([{"runs": "10"}, {"runs": "10"}]) == "10"
    assert runs_of([{"runs": "10"}, {"runs": "6"}, {"runs": "8"}]) == "6 to 10"

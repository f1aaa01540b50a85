"""The dancer as polygons: states say what the ends of the parts say, and a drawn person is followed."""

from __future__ import annotations

import cv2
import numpy as np

from eval.decomposition_video import PARTS, Film, ends_of, person_tree, states_of, track
from mocap.polygons.likelihood import colour_bins, mark_runs
from mocap.polygons.tree import corner_positions

_AT_REST = {
    "pelvis": (100, 110), "neck": (100, 60), "head": (101, 40),
    "left_shoulder": (115, 65), "left_elbow": (130, 85), "left_wrist": (140, 110),
    "right_shoulder": (85, 65), "right_elbow": (70, 85), "right_wrist": (60, 110),
    "left_hip": (108, 112), "left_knee": (112, 145), "left_ankle": (113, 175),
    "right_hip": (92, 112), "right_knee": (88, 145), "right_ankle": (87, 175),
}  # fmt: skip


def film(n_frames: int) -> Film:
    """A person in flat colours who leans and lifts an arm."""
    rest = np.array([[_AT_REST[a], _AT_REST[b]] for _, a, b, _, _ in PARTS], dtype=float)
    tree = person_tree(rest)
    states = np.repeat(states_of(tree, rest[None]), n_frames, axis=0)
    t = np.arange(n_frames)
    states[:, 0] += 1.5 * t
    states[:, tree.angle_column[2]] += 0.05 * t
    palette = np.random.default_rng(4).integers(0, 8, (len(PARTS), 3)) * 32 + 16
    bins = []
    for corners in corner_positions(tree, states):
        picture = np.full((200, 220, 3), 250, np.uint8)
        for own, colour in zip(corners.reshape(-1, 4, 2), palette.tolist(), strict=True):
            cv2.fillConvexPoly(picture, np.round(own).astype(np.int32), colour)
        bins.append(mark_runs(colour_bins(picture)))
    return Film(ends_of(tree, states), tuple(bins))


def test_ends_and_states_say_the_same() -> None:
    rng = np.random.default_rng(3)
    rest = np.array([[_AT_REST[a], _AT_REST[b]] for _, a, b, _, _ in PARTS], dtype=float)
    tree = person_tree(rest)
    assert tree.layout.n_columns == 3 * len(PARTS)
    np.testing.assert_allclose(ends_of(tree, states_of(tree, rest[None]))[0], rest, atol=1e-9)
    ends = rest + rng.normal(scale=6.0, size=(4, *rest.shape))
    again = ends_of(tree, states_of(tree, ends))
    np.testing.assert_allclose(again[:, :, 0], ends[:, :, 0], atol=1e-9)
    along, wanted = again[:, :, 1] - again[:, :, 0], ends[:, :, 1] - ends[:, :, 0]
    cosine = (along * wanted).sum(-1) / np.linalg.norm(along, axis=-1) / np.linalg.norm(wanted, axis=-1)
    np.testing.assert_allclose(cosine, 1.0, atol=1e-12)
    lengths = np.linalg.norm(rest[:, 1] - rest[:, 0], axis=1)
    np.testing.assert_allclose(np.linalg.norm(along, axis=-1), np.tile(lengths, (4, 1)))


def test_a_drawn_person_is_followed() -> None:
    clip = film(8)
    error, _ = track(clip, "ps", 200, 1, "residual", 0)
    lost = np.linalg.norm(clip.ends[1:] - clip.ends[:1], axis=-1).mean()
    assert error < 0.5 * lost, "a filter that stays where it was set"

"""When a hull holds much else than the person: a chair does so in silhouettes too, the room between few views not."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from flesh_voxels import make_flesh
from outline_world import make_rig, silhouette

from mocap.body import neutral_state
from mocap.likelihood.residuals import Outlines, person_outlines, pinhole_view
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import make_tools
from mocap.pose.volume import PersonHull, VolumeEvidence
from mocap.volume import surface_voxels

VOXEL_M = 0.04
FLESH = make_flesh("anthropometric", 1.74, VOXEL_M)
STATE = neutral_state(FLESH.body)
RIG = make_rig()


def thing() -> np.ndarray:
    """Voxels of a block as large as a chair, beside the body."""
    centers = FLESH.grid.centers(np.arange(FLESH.grid.n_voxels, dtype=np.int32))
    inside = np.all((centers > [0.2, -0.35, 0.0]) & (centers < [0.75, 0.35, 1.0]), axis=1)
    return np.flatnonzero(inside).astype(np.int32)


def outlines(*, with_thing: bool) -> Outlines:
    masks = []
    for camera in RIG:
        mask = silhouette(FLESH, STATE, camera)
        if with_thing:
            uv, _ = camera.project(FLESH.grid.centers(thing()))
            corners = cv2.convexHull(np.round(uv).astype(np.int32))
            mask = cv2.fillPoly(mask.astype(np.uint8), [corners], 1) > 0
        masks.append(mask)
    points = FLESH.grid.centers(np.union1d(FLESH.hull(STATE, margin_m=VOXEL_M).voxels, thing()))
    return person_outlines([pinhole_view(c) for c in RIG], RIG, masks, points, n_points=80)


def evidence(voxels: np.ndarray, seen: Outlines | None) -> VolumeEvidence:
    settings = PoseConfig(outline_weight=3.0)
    tools = make_tools(FLESH.grid, 30.0, 1.74, "anthropometric", settings, LikelihoodConfig(), 1)
    is_surface = surface_voxels(voxels, FLESH.grid)
    return tools.frame(PersonHull(voxels, is_surface, outlines=None if seen is None else lambda: seen))


@pytest.fixture(scope="module")
def crowded() -> np.ndarray:
    return np.union1d(FLESH.hull(STATE, margin_m=VOXEL_M).voxels, thing()).astype(np.int32)


def test_a_chair_is_in_the_silhouettes(crowded: np.ndarray) -> None:
    assert evidence(crowded, outlines(with_thing=True)).is_crowded(STATE)


def test_what_few_views_leave_of_the_room_is_not(crowded: np.ndarray) -> None:
    found = evidence(crowded, outlines(with_thing=False))
    assert found.unexplained_share(STATE) > 0.4
    assert not found.is_crowded(STATE)


def test_without_outlines_the_hull_decides(crowded: np.ndarray) -> None:
    assert evidence(crowded, None).is_crowded(STATE)
    own = FLESH.hull(STATE, margin_m=VOXEL_M).voxels
    assert not evidence(own, outlines(with_thing=True)).is_crowded(STATE)


def test_outlines_beside_the_body_are_counted() -> None:
    """All of a body's own outlines touch it; one that stands a metre beside them touches none."""
    own = FLESH.hull(STATE, margin_m=VOXEL_M).voxels
    problem = evidence(own, outlines(with_thing=False)).outlines
    assert problem is not None
    assert problem.unexplained_share(STATE, 0.05) == 0.0
    assert problem.unexplained_share(STATE, -1.0) == 1.0
    beside = STATE.copy()
    beside[:2] += 1.0
    assert problem.unexplained_share(beside, 0.05) > 0.9

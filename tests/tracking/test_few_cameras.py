"""Two and three cameras: exact silhouettes carved, and what the tracker makes of the little that they tell."""

import cv2
import numpy as np
import pytest

from mocap.data import Camera, CameraRig, Hull, VoxelGrid
from mocap.pipeline.tracking import tracker_input
from mocap.tracking import TRACKERS, TrackerSettings, TrackerState, track_step, tracks_from_history
from mocap.volume import Carver, surface_voxels

FPS = 20.0
GRID = VoxelGrid(np.array([-2.0, -2.0, 0.0]), (80, 80, 44), 0.05)
CORNERS = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1]), axis=-1).reshape(-1, 3)


def camera(name, place):
    forward = np.array([0, 0, 0.9]) - place
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    matrix = np.array([[260.0, 0, 160], [0, 260, 120], [0, 0, 1]])
    return Camera(name, (320, 240), matrix, np.zeros(5), rotation, -rotation @ np.array(place))


CAMERAS = tuple(
    camera(name, np.array(place))
    for name, place in (("a", (-3.5, -3.5, 2.4)), ("b", (3.5, -3.5, 2.4)), ("c", (0.0, 3.8, 2.4)))
)


def silhouette(view, places):
    mask = np.zeros((240, 320), dtype=np.uint8)
    for x, y in places:
        body = np.array([x - 0.15, y - 0.2, 0.0]) + CORNERS * [0.3, 0.4, 1.7]
        uv, depth = view.project(body)
        if (depth > 0.05).all():
            cv2.fillConvexPoly(mask, cv2.convexHull(np.round(uv).astype(np.int32)), 1)
    return mask.astype(bool)


def run(clip, n_cameras, **changes):
    """Confirmed persons after every step, and the tracks of the clip.  clip : places (x, y) of every frame."""
    rig = CameraRig(CAMERAS[:n_cameras])
    carver = Carver(rig, GRID)
    s = TrackerSettings(0.05, colour=False, fps=FPS, **changes)
    state, live, history = TrackerState(), [], []
    for frame, places in enumerate(clip):
        voxels = carver.carve([silhouette(c, places) for c in rig], n_faulty_views=0, min_views=n_cameras)
        nothing = np.zeros(len(voxels), dtype=np.uint8)
        is_surface = surface_voxels(voxels, GRID)
        seen = tracker_input(
            frame, Hull(GRID, voxels, is_surface, nothing, np.zeros((len(voxels), 3), np.uint8))
        )
        state, info = track_step(state, seen.voxels, s, rng=np.random.default_rng(frame))
        live.append([t.person for t in info.tracks if t.status != "tentative"])
        history.append((frame, info.tracks))
    return live, tracks_from_history(history, FPS, min_seen=s.confirm_frames)


WALK = [[(x, 0.3)] for x in np.linspace(-2.6, 2.6, 60)]


@pytest.mark.parametrize("n_cameras", [2, 3])
@pytest.mark.parametrize("tracker", TRACKERS)
def test_one_person_comes_and_goes_and_leaves_no_phantom(tracker, n_cameras):
    live, tracks = run([[]] * 5 + WALK + [[]] * 25, n_cameras, tracker=tracker)
    # Half a body wide and half a voxel more: then no part of him is in the volume.
    inside = np.flatnonzero([bool(p) and abs(p[0][0]) < 2.2 for p in [[]] * 5 + WALK])
    assert not any(live[: inside[0]])
    assert tracks.persons == (1,)
    # Written down are sightings alone; who watches live sees the track for lost_frames longer, and no more.
    assert inside[0] <= tracks.frame.min()
    assert tracks.frame.max() <= inside[-1]
    assert not any(live[inside[-1] + 1 + TrackerSettings(0.05).lost_frames :])
    assert len(tracks) > 40


def test_ghosts_of_two_cameras_are_no_persons_when_their_number_is_known():
    """Two lines of sight cross at four places; without the number the ghosts, as large as persons, are persons."""
    clip = [[(-1 + 0.02 * i, -0.6), (1 - 0.02 * i, 0.6)] for i in range(60)] + [[]] * 20
    live, tracks = run(clip, 2)
    assert max(len(p) for p in live) > 2
    live, tracks = run(clip, 2, expected_persons=2)
    assert max(len(p) for p in live) == 2
    assert len(tracks.persons) == 2
    assert tracks.frame.max() <= 59
    assert not any(live[60 + TrackerSettings(0.05).lost_frames :])


@pytest.mark.parametrize("tracker", TRACKERS)
def test_nobody_in_the_room_is_nobody(tracker):
    live, tracks = run([[]] * 10, 3, tracker=tracker)
    assert not any(live)
    assert len(tracks) == 0

"""Markers, what hides them, and the simulated detector of CF 6.6.1."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("embreex", reason="rendering needs the extra synth (embreex)")

from mocap.body import load_body_model, scale_body
from mocap.data import LANDMARKS
from mocap.errors import MocapError
from mocap.io.session import open_session
from mocap.io.tables import read_detections_csv, read_landmarks_csv
from mocap.synth import synthesise
from mocap.synth.figure import JOINT
from mocap.synth.markers import (
    Sight,
    make_detections,
    marker_spots,
    place_markers,
    simulate_detector,
    write_detections,
)
from mocap.synth.render import CameraView
from mocap.synth.scene import Scene, scene_from_dict
from mocap.synth.views import Witness
from mocap.synth.world import World, build_world

W, H, C, T, M = 160, 120, 4, 3, 20
N_SIGMA = 5.0  # a false alarm in millions


def _scene(**more: object) -> Scene:
    document: dict[str, object] = {
        "name": "marked",
        "seed": 41,
        "n_frames": T,
        "masks_only": True,
        "rig": {"n_cameras": C, "size_px": [W, H]},
        "persons": [{"seed": 5, "motion": {"kind": "walk", "radii_m": [0.8, 0.7], "start_deg": 50}}],
        "markers": {"detection_rate": 0.8, "false_positives": 6, "noise_variance_px2": 2.0},
    }
    return scene_from_dict({**document, **more})


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return synthesise(_scene(), tmp_path_factory.mktemp("markers") / "marked", workers=1)


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(_scene())


def _views(session: Path, camera: str) -> dict[str, np.ndarray]:
    with np.load(session / "truth" / "views" / f"{camera}.npz") as data:
        return dict(data)


def _masks(session: Path, camera: str) -> np.ndarray:
    return np.unpackbits(np.load(session / "truth" / "masks" / f"{camera}.npz")["masks"], axis=2).astype(bool)


def _grown(mask: np.ndarray, radius: int) -> np.ndarray:
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    return cv2.dilate(mask.astype(np.uint8), kernel).astype(bool)


def _is_hit(triangles: np.ndarray, start: np.ndarray, end: np.ndarray) -> bool:
    """Whether a segment meets a triangle: signed volumes of tetrahedra."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]

    def volume(p: np.ndarray, q: np.ndarray, r: np.ndarray, s: np.ndarray) -> np.ndarray:
        return np.einsum("fi,fi->f", np.cross(q - p, r - p), s - p)

    p, q = np.broadcast_to(start, a.shape), np.broadcast_to(end, a.shape)
    crosses = np.sign(volume(a, b, c, p)) != np.sign(volume(a, b, c, q))
    side = np.sign([volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)])
    return bool(np.any(crosses & (side[0] == side[1]) & (side[1] == side[2])))


# --- where they sit -----------------------------------------------------------------------------------------


def test_twenty_markers_sit_on_the_skin_near_their_joints(world: World) -> None:
    names = [s.name for s in marker_spots()]
    assert len(set(names)) == len(names) == M
    assert set(LANDMARKS) <= set(names)
    body = world.actors[0].body
    markers = place_markers(body, 0.01)
    at = markers.positions(body.vertices, body.normals)
    nearest = np.linalg.norm(at[:, None] - body.vertices[None], axis=2).min(axis=1)
    assert np.allclose(nearest, 0.01, atol=0.004)
    for spot, point in zip(markers.spots, at, strict=True):
        assert np.linalg.norm(point - body.rest_position[JOINT[spot.start]]) < 0.20


def test_offsets_are_those_of_the_filters_bodies(world: World) -> None:
    actor = world.actors[0]
    assert actor.markers is not None
    offset = dict(zip(actor.markers.names, actor.markers.offset, strict=True))
    model = scale_body(load_body_model("anthropometric"), actor.body.figure.stature_m)
    for spot in actor.markers.spots:
        assert spot.part in model.layout.parts
        assert spot.joint in model.joints
    figure = actor.body.figure
    for side, sign in (("left", 1.0), ("right", -1.0)):  # at rest the arms stretch along +-y
        assert abs(sign * offset[f"{side}_wrist"][1] - figure.forearm_m) < 0.02
        assert abs(sign * offset[f"{side}_elbow"][1] - figure.upper_arm_m) < 0.02
        assert abs(offset[f"{side}_knee"][2] + figure.thigh_m) < 0.02
        assert offset[f"{side}_wrist"][2] > 0.01  # the outer side of a hanging arm is up in the T
    # Either marker sits on a vertex of its side, half a diagonal of a 19 mm cell from the mirrored place at most.
    mirrored = offset["right_ankle"] * [1, -1, 1]
    assert np.linalg.norm(offset["left_ankle"] - mirrored) < 2 * 0.5 * np.sqrt(2) * 0.019


def test_truth_files_agree(session: Path, world: World) -> None:
    with (session / "truth" / "markers.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["frame", "time_s", "person", "marker", "x_m", "y_m", "z_m"]
    assert len(rows) == T * M
    with (session / "truth" / "marker_set.csv").open() as file:
        carried = list(csv.DictReader(file))
    assert [r["marker"] for r in carried] == [s.name for s in marker_spots()]
    rig = open_session(session).rig
    at = np.array([[float(r[k]) for k in ("x_m", "y_m", "z_m")] for r in rows]).reshape(T, M, 3)
    for camera in rig:
        uv, _ = camera.project(at)
        assert np.allclose(uv, _views(session, camera.name)["marker_uv"][:, 0], atol=0.01, equal_nan=True)
    (motion,) = read_landmarks_csv(session / "truth" / "landmarks.csv")
    top = [r["marker"] for r in carried].index("head")
    assert np.linalg.norm(at[:, top] - motion.landmarks[:, LANDMARKS.index("head")], axis=1).max() < 0.04


# --- visibility ---------------------------------------------------------------------------------------------


def test_marker_states_equal_a_brute_force_ray_test(world: World) -> None:
    actor = world.actors[0]
    assert actor.markers is not None
    vertices, normals = actor.posed(1)
    triangles = vertices[actor.body.faces]
    markers = actor.markers.positions(vertices, normals)
    posed = world.at(1, with_light=False)
    seen = 0
    for camera in world.rig:
        witness = Witness(world)
        witness.look(CameraView(camera, world.room), posed, 1, is_off=False)
        state = witness.marker_states[0][0]
        uv, _ = camera.project(markers)
        for k in np.flatnonzero(camera.contains(uv)):
            assert (state[k] == Sight.OWN_BODY) == _is_hit(triangles, camera.center, markers[k])
            seen += state[k] == Sight.VISIBLE
        assert (state[~camera.contains(uv)] == Sight.OUTSIDE).all()
    assert C * M / 3 < seen < C * M


def test_visible_points_lie_on_the_silhouette_and_landmarks_mostly_do(session: Path) -> None:
    for name in (f"cam_{i}" for i in range(C)):
        views, masks = _views(session, name), _masks(session, name)
        for frame in range(T):
            for kind, radius in (("landmark", 1), ("marker", 2)):
                state, uv = views[f"{kind}_state"][frame, 0], views[f"{kind}_uv"][frame, 0]
                column, row = np.rint(uv[state <= Sight.OWN_BODY]).astype(int).T
                assert _grown(masks[frame], radius)[row, column].all()
        u0, v0, u1, v1 = views["box_px"][0, 0]
        rows, columns = np.nonzero(masks[0])
        tight = (columns.min(), rows.min(), columns.max(), rows.max())
        assert np.abs(np.array([u0, v0, u1, v1]) - tight).max() <= 1.5


def _line_up(distances_m: tuple[float, ...], **more: object) -> World:
    """Persons who stand behind each other as one camera sees them, all looking at it."""
    camera = {"name": "front", "position_m": [3.0, 0.0, 1.3], "target_m": [0.0, 0.0, 1.0]}
    persons = [
        {
            "seed": 60 + i,
            "height_m": 1.75,
            "sex": "male",
            "motion": {"kind": "stand", "position_m": [3.0 - d, 0.0]},
        }
        for i, d in enumerate(distances_m)
    ]
    rig = {"kind": "given", "cameras": [camera], "size_px": [W, H]}
    return build_world(_scene(rig=rig, persons=persons, n_frames=1, **more))


def _states(world: World) -> tuple[np.ndarray, np.ndarray]:
    witness = Witness(world)
    witness.look(CameraView(world.rig[0], world.room), world.at(0, with_light=False), 0, is_off=False)
    return witness.landmark_states[0], witness.marker_states[0]


def test_who_stands_in_front_hides_who_stands_behind() -> None:
    landmarks, markers = _states(_line_up((2.0, 3.6)))
    name = [s.name for s in marker_spots()].index
    assert markers[0, name("chest")] == Sight.VISIBLE
    assert markers[0, name("pelvis")] == Sight.OWN_BODY  # on the back
    assert markers[1, name("chest")] == Sight.OTHER_PERSON
    front = [LANDMARKS.index(n) for n in ("left_shoulder", "left_elbow", "right_knee", "pelvis")]
    assert (landmarks[0, front] == Sight.VISIBLE).all()
    assert landmarks[1, LANDMARKS.index("pelvis")] == Sight.OTHER_PERSON


def test_joints_on_the_far_side_are_hidden() -> None:
    person = {"seed": 60, "sex": "male", "motion": {"kind": "stand", "heading_deg": 90}}
    camera = {"name": "side", "position_m": [3.0, 0.0, 1.0], "target_m": [0.0, 0.0, 0.9]}
    rig = {"kind": "given", "cameras": [camera], "size_px": [W, H]}
    landmarks, _ = _states(build_world(_scene(rig=rig, persons=[person], n_frames=1)))
    assert landmarks[0, LANDMARKS.index("right_shoulder")] == Sight.VISIBLE
    assert landmarks[0, LANDMARKS.index("left_shoulder")] == Sight.OWN_BODY
    assert landmarks[0, LANDMARKS.index("left_elbow")] == Sight.OWN_BODY


def test_furniture_hides_the_legs() -> None:
    table = {"kind": "table", "center_m": [1.3, 0.0], "heading_deg": 90, "height_m": 0.75, "solid": True}
    landmarks, markers = _states(_line_up((2.6,), room={"furniture": [table]}))
    for name in ("left_knee", "right_ankle"):
        assert landmarks[0, LANDMARKS.index(name)] == Sight.FURNITURE
    assert landmarks[0, LANDMARKS.index("head")] != Sight.FURNITURE
    assert (markers[0] == Sight.FURNITURE).any()


# --- the detector -------------------------------------------------------------------------------------------


def _synthetic(F: int = 400, P: int = 2, K: int = 5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(7)
    uv = rng.uniform([30, 20], [130, 90], size=(F, P, K, 2))
    visible = rng.uniform(size=(F, P, K)) < 0.7
    box = np.tile(np.array([20.0, 10.0, 60.0, 100.0]), (F, P, 1))
    box[:, 1] = np.nan  # the second person is outside the picture
    visible[:, 1] = False
    return uv, visible, box


def _detect(dr: float, fp: float, var: float, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    uv, visible, box = _synthetic()
    return simulate_detector(
        uv,
        visible,
        box,
        (W, H),
        detection_rate=dr,
        false_positives=fp,
        noise_variance_px2=var,
        rng=np.random.default_rng(seed),
    )


def test_a_perfect_detector_finds_what_is_visible_and_nothing_else() -> None:
    uv, visible, _ = _synthetic()
    frame, found = _detect(1.0, 0.0, 0.0)
    assert np.array_equal(np.bincount(frame, minlength=len(uv)), visible.sum(axis=(1, 2)))
    for f in (0, 17, 399):
        truth = uv[f][visible[f]]
        assert np.allclose(found[frame == f], truth[np.argsort(truth[:, 0])])


def test_detection_rate_and_false_positives_are_as_configured() -> None:
    _, visible, _ = _synthetic()
    n = visible.sum()
    frame, _ = _detect(0.6, 0.0, 0.0)
    assert abs(len(frame) - 0.6 * n) < N_SIGMA * np.sqrt(n * 0.6 * 0.4)
    frame, found = _detect(0.0, 20.0, 0.0)
    counts = np.bincount(frame, minlength=400)
    assert counts.min() == 0
    assert counts.max() == 40  # uniform on 0 .. 2 FP
    assert abs(counts.mean() - 20) < N_SIGMA * np.sqrt((41**2 - 1) / 12 / 400)
    low, high = np.array([20.0, 10.0]), np.array([60.0, 100.0])  # within the tight box of the one person
    assert np.all((found >= low) & (found <= high))
    spread = (high - low) / np.sqrt(12)
    assert np.allclose(found.std(axis=0), spread, rtol=0.03)
    assert np.abs(found.mean(axis=0) - (low + high) / 2).max() < N_SIGMA * spread.max() / np.sqrt(len(found))


def test_noise_has_the_given_variance_in_each_direction() -> None:
    uv, visible, _ = _synthetic()
    only = visible & (np.cumsum(visible, axis=2) == 1)  # one marker per frame, so that pairs are known
    box = np.full((len(uv), 2, 4), np.nan)
    frame, found = simulate_detector(
        uv,
        only,
        box,
        (W, H),
        detection_rate=1.0,
        false_positives=0.0,
        noise_variance_px2=4.0,
        rng=np.random.default_rng(1),
    )
    truth = uv[only][np.searchsorted(np.nonzero(only)[0], frame)]
    error = found - truth
    n = len(error)
    assert n > 300
    assert np.abs(error.var(axis=0) / 4.0 - 1).max() < N_SIGMA * np.sqrt(2 / n)
    assert np.abs(error.mean(axis=0)).max() < N_SIGMA * 2 / np.sqrt(n)


def test_detections_are_sorted_inside_the_picture_and_repeatable() -> None:
    frame, uv = _detect(0.9, 20.0, 100.0)
    assert (np.diff(frame) >= 0).all()
    same = np.diff(frame) == 0
    assert (np.diff(uv[:, 0])[same] >= 0).all()
    assert (uv >= -0.5).all()
    assert (uv < np.array([W, H]) - 0.5).all()
    assert np.array_equal(uv, _detect(0.9, 20.0, 100.0)[1])
    assert not np.array_equal(uv[:50], _detect(0.9, 20.0, 100.0, seed=4)[1][:50])


def test_detections_of_a_session_and_made_again_from_its_truth(session: Path, tmp_path: Path) -> None:
    found = open_session(session)
    assert set(found.detection_sources) == set(found.rig.names)
    perfect = make_detections(
        session,
        detection_rate=1.0,
        false_positives=0.0,
        noise_variance_px2=0.0,
        rng=np.random.default_rng(0),
    )
    write_detections(tmp_path, perfect)
    for name, (frame, uv) in perfect.items():
        views = _views(session, name)
        assert len(frame) == (views["marker_state"] == Sight.VISIBLE).sum()
        read_frame, read_uv = read_detections_csv(tmp_path / "detections" / f"{name}.csv")
        assert np.array_equal(read_frame, frame)
        assert np.allclose(read_uv, uv, atol=1e-5)


def test_a_session_without_markers_says_so(tmp_path: Path) -> None:
    folder = synthesise(_scene(markers=None, n_frames=1), tmp_path / "plain", workers=1)
    assert not (folder / "detections").exists()
    with pytest.raises(MocapError, match="no truth of markers"):
        make_detections(folder, rng=np.random.default_rng(0))


# --- yellow balls -------------------------------------------------------------------------------------------


def test_visible_balls_are_yellow(tmp_path: Path) -> None:
    scene = _scene(
        n_frames=1,
        masks_only=False,
        rig={"n_cameras": C, "size_px": [320, 240]},
        picture={"container": "png", "noise_levels": 0.0, "colour_cast": 0.0},
        markers={"balls": True, "radius_m": 0.025, "detections": False},
    )
    folder = synthesise(scene, tmp_path / "balls", workers=1)
    assert not (folder / "detections").exists()
    with (folder / "marker_labels.csv").open() as file:
        labels = list(csv.DictReader(file))
    n_visible, n_yellow = 0, 0
    for name in (f"cam_{i}" for i in range(C)):
        views = _views(folder, name)
        picture = cv2.imread(str(folder / "images" / name / "000000.png")).astype(float)
        mask = np.unpackbits(np.load(folder / "truth/masks" / f"{name}.npz")["masks"], axis=2)[0]
        seen = views["marker_uv"][0, 0][views["marker_state"][0, 0] == Sight.VISIBLE]
        n_visible += len(seen)
        column, row = np.rint(seen).astype(int).T
        blue, green, red = picture[row, column].T
        n_yellow += int((np.minimum(red, green) > 1.5 * blue).sum())
        assert mask[row, column].all()  # balls belong to the silhouette
        assert sum(r["camera"] == name for r in labels) == len(seen)
    assert n_visible > C * M / 3
    assert n_yellow > 0.95 * n_visible  # a pixel on the rim of a sleeve is half a sleeve

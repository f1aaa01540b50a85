"""Feet of synthetic people: they roll over heel and toe and do not slide while they bear weight."""

from pathlib import Path as FilePath

import numpy as np
import pytest

from mocap.compare.side import with_feet_and_hands
from mocap.data import ALL_LANDMARKS, FURTHER_LANDMARKS, LANDMARKS
from mocap.errors import MocapError
from mocap.io.formats.table import PoseFile, PoseTable
from mocap.io.tables import FeetAndHands, read_feet_and_hands_csv, write_feet_and_hands_csv
from mocap.synth.figure import feet_and_hands_of, forward_kinematics, make_figure
from mocap.synth.furniture import Stairs
from mocap.synth.motions import MOTIONS, Path
from mocap.synth.truth import CONTACT_HEIGHT_M, CONTACT_SPEED_M_S

FPS = 30.0
T = 120
MOST_SLIP_M = 0.001
FLOOR = [
    FURTHER_LANDMARKS.index(f"{side}_{point}") for side in ("left", "right") for point in ("heel", "toe")
]
GAITS = {"walk": 1.2, "jog": 2.4}


def feet(motion: str, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    figure = make_figure(rng.uniform(1.5, 1.95), "male" if seed % 2 else "female", 1.0, rng=rng)
    bend = (0.0, 0.0) if seed == 0 else (1.6, 1.2)
    path = Path((0.0, 0.0), bend, 0.3, False)
    pose = MOTIONS[motion](figure, T, FPS, rng=rng, path=path, speed_m_s=GAITS[motion])
    return feet_and_hands_of(figure, *forward_kinematics(figure.offsets, pose.rotations, pose.root_position))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("motion", GAITS)
def test_a_heel_or_toe_on_the_floor_does_not_slide(motion: str, seed: int) -> None:
    xyz = feet(motion, seed)
    speed = np.linalg.norm(np.gradient(xyz, axis=0), axis=2) * FPS
    rests = (speed < CONTACT_SPEED_M_S) & (xyz[..., 2] < CONTACT_HEIGHT_M)
    n_runs = 0
    for k in FLOOR:
        runs = np.split(np.arange(T), np.flatnonzero(np.diff(rests[:, k].astype(int))) + 1)
        for run in runs:
            inner = run[1:-1]  # the frames in which a foot lands and leaves
            if rests[run[0], k] and len(inner):
                n_runs += 1
                assert np.linalg.norm(xyz[inner, k] - xyz[inner[0], k], axis=1).max() < MOST_SLIP_M
    assert n_runs >= 12
    assert rests[:, FLOOR].any(axis=0).all()
    assert not rests[:, [2, 5]].any()  # hands


@pytest.mark.parametrize("seed", range(2))
def test_a_foot_lands_on_the_heel_and_leaves_with_the_toe(seed: int) -> None:
    z = feet("walk", seed)[..., 2]
    for heel, toe in ((0, 1), (3, 4)):
        down = z[:, [heel, toe]] < CONTACT_HEIGHT_M
        lands, leaves = ([np.flatnonzero(np.diff(d.astype(int)) == way) for d in down.T] for way in (1, -1))
        for at in lands[0][:-1]:
            assert (lands[1] >= at).any()
        # Between a toe's leaving and the frame before, its heel left long ago.
        for at in leaves[1]:
            before = leaves[0][leaves[0] < at]
            if len(before):
                assert at - before[-1] >= 3


@pytest.mark.parametrize("seed", range(3))
def test_toes_stay_where_they_are_while_the_heels_rise(seed: int) -> None:
    rng = np.random.default_rng(seed)
    figure = make_figure(rng.uniform(1.5, 1.95), "male", 1.0, rng=rng)
    pose = MOTIONS["squat"](figure, T, FPS, rng=rng, position=(0.3, -0.2), heading_rad=0.7)
    where = forward_kinematics(figure.offsets, pose.rotations, pose.root_position)
    xyz = feet_and_hands_of(figure, *where)
    toes, heels = xyz[:, [1, 4]], xyz[:, [0, 3], 2]
    assert np.linalg.norm(toes - toes[0], axis=2).max() < MOST_SLIP_M
    assert heels.max() > 0.04 * figure.stature_m
    assert heels.min() > -MOST_SLIP_M
    pelvis = where[0][:, 0, 2]
    assert pelvis.min() < 0.8 * pelvis[0]
    assert pelvis.max() > pelvis[0] + 0.02


@pytest.mark.parametrize("seed", range(4))
def test_feet_on_stairs_rest_on_them_and_do_not_go_through(seed: int) -> None:
    rng = np.random.default_rng(seed)
    figure = make_figure(rng.uniform(1.5, 1.9), "male" if seed % 2 else "female", 1.0, rng=rng)
    pose = MOTIONS["stairs"](figure, T, FPS, rng=rng, position=(0.0, 0.0), heading_rad=0.0)
    where = forward_kinematics(figure.offsets, pose.rotations, pose.root_position)
    xyz = feet_and_hands_of(figure, *where)[:, FLOOR]  # left heel, left toe, right heel, right toe
    assert pose.ground_m is not None
    speed = np.linalg.norm(np.gradient(xyz, axis=0), axis=2) * FPS
    rests = (speed < CONTACT_SPEED_M_S) & (
        xyz[..., 2] - np.repeat(pose.ground_m, 2, axis=1) < CONTACT_HEIGHT_M
    )
    for k in range(4):
        flat = pose.contact[:, k // 2]
        assert rests[flat, k].mean() > 0.95  # all but the frames in which it lands
        for run in np.split(np.arange(T), np.flatnonzero(np.diff(flat.astype(int))) + 1):
            if flat[run[0]]:
                assert np.linalg.norm(xyz[run, k] - xyz[run[0], k], axis=1).max() < MOST_SLIP_M
    stairs = Stairs(kind="stairs", position_m=(0.0, 0.0))
    for corners in stairs.boxes():
        low, high = corners.min(axis=0), corners.max(axis=0)
        inside = ((xyz > low + 0.01) & (xyz < high - 0.01)).all(axis=2)
        assert not inside.any()
    heights = {round(float(h), 2) for h in np.unique(pose.ground_m[rests[:, ::2]])}
    assert {0.0, 0.48} <= heights
    assert len(heights) >= 3
    assert pose.root_position[-1, 2] - pose.root_position[0, 2] == pytest.approx(0.48, abs=0.01)


def person(n_frames: int = 4) -> FeetAndHands:
    rng = np.random.default_rng(3)
    xyz = rng.uniform(0, 2, (n_frames, len(FURTHER_LANDMARKS), 3))
    return FeetAndHands(1, np.arange(n_frames), xyz, rng.uniform(size=xyz.shape[:2]) > 0.5)


def test_the_table_gives_back_what_was_written_and_knows_its_mistakes(tmp_path: FilePath) -> None:
    path, written = tmp_path / "extra.csv", person()
    write_feet_and_hands_csv(path, [written])
    with path.open("a") as file:
        file.write("0,1,left_toe_joint,0,0,0,0\n")
    (read,) = read_feet_and_hands_csv(path)
    np.testing.assert_allclose(read.xyz, written.xyz, atol=1e-6)
    np.testing.assert_array_equal(read.in_contact, written.in_contact)
    path.write_text(path.read_text() + "0,1,left_toe,0,0,0,0\n")
    with pytest.raises(MocapError, match="left_toe of person 1 in frame 0 is there twice"):
        read_feet_and_hands_csv(path)


def test_they_join_the_fifteen_of_the_same_person_and_frame(tmp_path: FilePath) -> None:
    write_feet_and_hands_csv(tmp_path / "extra.csv", [person()])
    frames = np.arange(2, 6)
    tables = tuple(PoseTable(p, LANDMARKS, frames, frames / FPS, np.zeros((4, 15, 3))) for p in (1, 2))
    found = with_feet_and_hands(
        PoseFile(tmp_path, "landmarks.csv", tables, FPS, "m", "z"), tmp_path / "extra.csv"
    )
    first, second = found.people
    assert (first.names, second.names) == (ALL_LANDMARKS, LANDMARKS)
    np.testing.assert_allclose(first.xyz[:2, len(LANDMARKS) :], person().xyz[2:], atol=1e-6)
    assert np.isnan(first.xyz[2:, len(LANDMARKS) :]).all()

"""Jumps and squats: what counts as one, how high and how deep, and what does not."""

import numpy as np
import pytest

from mocap.data.motion import ALL_LANDMARKS
from mocap.pose.contacts import SOLE_POINTS, contacts_of
from mocap.pose.method import ContactSettings
from mocap.pose.moves import find_moves, move_numbers
from mocap.synth.figure import feet_and_hands_of, forward_kinematics, landmarks_of, make_figure
from mocap.synth.motions import MOTIONS
from mocap.synth.motions import Path as Way

FPS = 30.0
LEVEL = 0.95  # m, of the pelvis in standing


def moves_in(kind: str, seconds: float = 4.0, fps: float = FPS, **options: object) -> tuple:
    """Moves of a synthetic person, with his pelvis' heights."""
    rng = np.random.default_rng(3)
    figure = make_figure(1.8, "male", 1.0, rng=rng)
    if not options:
        options = {"position": (0.3, -0.2), "heading_rad": 0.7}
    pose = MOTIONS[kind](figure, int(seconds * fps), fps, rng=rng, **options)
    where = forward_kinematics(figure.offsets, pose.rotations, pose.root_position)
    points = np.concatenate([landmarks_of(figure, *where), feet_and_hands_of(figure, *where)], axis=1)
    sole = points[:, list(SOLE_POINTS)]
    rests = contacts_of(sole, np.zeros(sole.shape[:2]), fps, ContactSettings()).probability > 0.5
    pelvis = points[:, ALL_LANDMARKS.index("pelvis"), 2]
    return find_moves(pelvis, rests, np.linspace(0, 1, len(pelvis)), fps), pelvis


def clip(pelvis: np.ndarray, left: np.ndarray, right: np.ndarray) -> tuple:
    """Moves of a pelvis and of feet that rest or do not."""
    rests = np.stack([left, left, right, right], axis=1)
    return find_moves(pelvis, rests, np.linspace(0, 1, len(pelvis)), FPS)


@pytest.mark.parametrize("fps", [30.0, 60.0])
def test_a_jump_is_as_high_as_it_was_made(fps: float) -> None:
    (jump,), pelvis = moves_in("jump", 3.0, fps)
    assert jump.kind == "jump"
    # To a tenth of a frame's way: the pelvis' highest frame lies up to a millimetre under the top.
    assert jump.height_m == pytest.approx(pelvis.max() - pelvis[0], abs=0.005)
    assert jump.extreme == pelvis.argmax()
    # Feet take two frames to be told from feet that rest.
    assert jump.flight_s == pytest.approx(np.sqrt(8 * 0.24 / 9.81), abs=2.5 / 30)
    assert jump.flight_height_m == pytest.approx(9.81 * jump.flight_s**2 / 8)


def test_heights_that_are_off_by_a_frame_or_by_noise_leave_the_top() -> None:
    t = (np.arange(12) + 0.4) / FPS
    air = LEVEL + 2.0 * t - 0.5 * 9.81 * t**2 + 0.004 * np.random.default_rng(0).standard_normal(12)
    pelvis = np.concatenate([np.full(20, LEVEL), air, np.full(20, LEVEL)])
    down = np.ones(52, dtype=bool)
    down[20:32] = False
    (jump,) = clip(pelvis, down, down)
    assert jump.height_m == pytest.approx(2.0**2 / (2 * 9.81), abs=0.004)
    assert (jump.begin, jump.end) == (20, 32)


def test_steps_of_a_run_are_no_jumps() -> None:
    path = Way((-2.0, 0.0), (0.0, 0.0), 0.4, False)
    moves, _ = moves_in("jog", path=path, speed_m_s=2.4)
    assert moves == ()
    # One foot leaves long before the other one.
    pelvis, left, right = np.full(60, LEVEL), np.ones(60, dtype=bool), np.ones(60, dtype=bool)
    left[20:38], right[28:38] = False, False
    assert clip(pelvis, left, right) == ()
    left[:28] = True
    assert [move.kind for move in clip(pelvis, left, right)] == ["jump"]


def test_a_squat_is_as_deep_as_it_was_made() -> None:
    (squat,), pelvis = moves_in("squat")
    assert squat.kind == "squat"
    assert squat.extreme == pelvis.argmin()
    assert squat.height_m == pytest.approx(pelvis.min() - pelvis[0], abs=0.004)
    assert squat.knee_flexion_rad == pytest.approx(np.linspace(0, 1, len(pelvis))[squat.extreme])
    inside = pelvis[0] - pelvis > 0.25 * (pelvis[0] - pelvis.min()) + 0.005
    assert squat.begin <= np.flatnonzero(inside)[0]
    assert squat.end > np.flatnonzero(inside)[-1]


def test_two_dips_without_standing_up_are_one_squat() -> None:
    t = np.arange(90)
    pelvis = LEVEL - 0.3 * np.clip(np.sin(np.pi * t / 90), 0, None) + 0.06 * np.sin(6 * np.pi * t / 90)
    down = np.ones(90, dtype=bool)
    pelvis = np.concatenate([np.full(30, LEVEL), pelvis, np.full(30, LEVEL)])
    down = np.ones(len(pelvis), dtype=bool)
    assert [move.kind for move in clip(pelvis, down, down)] == ["squat"]


def test_what_is_sunk_for_a_jump_is_no_squat_even_when_the_clip_ends_in_the_air() -> None:
    moves, _ = moves_in("jump", 4.0)  # the second jump does not land
    assert [move.kind for move in moves] == ["jump"]


def test_a_walk_has_neither_and_nobody_who_never_stands_has_any() -> None:
    moves, _ = moves_in("walk", path=Way((-2.0, 0.0), (0.0, 0.0), 0.4, False), speed_m_s=1.3)
    assert moves == ()
    nothing = np.zeros(30, dtype=bool)
    assert clip(np.full(30, LEVEL), nothing, nothing) == ()


def test_numbers_name_the_highest_and_the_deepest() -> None:
    (jump,), _ = moves_in("jump", 3.0)
    (squat,), _ = moves_in("squat")
    numbers = move_numbers((jump, squat))
    assert numbers == {
        "jumps": 1.0,
        "highest_jump_m": jump.height_m,
        "squats": 1.0,
        "deepest_squat_m": -squat.height_m,
    }
    assert move_numbers(()) == {}

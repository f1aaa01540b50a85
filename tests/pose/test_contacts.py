"""Contacts of heels and toes, what is held on the floor, steps, and what is said of the floor."""

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest

from mocap.body import landmarks_of, load_body_model, neutral_state, scale_body
from mocap.body.initial import HeightEstimate
from mocap.data.motion import ALL_LANDMARKS, FURTHER_LANDMARKS
from mocap.io.formats import write_c3d
from mocap.pipeline.outputs import (
    CONTACT_COLUMNS,
    MOVE_COLUMNS,
    STEP_COLUMNS,
    foot_events,
    write_contacts_csv,
    write_moves_csv,
    write_steps_csv,
)
from mocap.pose.contacts import SOLE_POINTS, Contacts, contacts_of, held, lowest_level, slips_m, unbroken_runs
from mocap.pose.deviation import FrameSeries
from mocap.pose.kinematics import Kinematics
from mocap.pose.method import ContactSettings, Method
from mocap.pose.moves import moves_of
from mocap.pose.result import PersonPoses, motion_of
from mocap.pose.smooth import smooth_motion
from mocap.pose.steps import check_floor, gait_numbers, gait_of, stances_of, warnings_of_gait
from mocap.synth.figure import (
    feet_and_hands_of,
    forward_kinematics,
    make_figure,
)
from mocap.synth.figure import (
    landmarks_of as figure_landmarks,
)
from mocap.synth.motions import MOTIONS, Path

FPS = 30.0
T = 120
SETTINGS = ContactSettings()
SOLE = list(SOLE_POINTS)
OWN = [FURTHER_LANDMARKS.index(ALL_LANDMARKS[k]) for k in SOLE]


def walk(*, noise_m: float = 0.0, motion: str = "walk", speed_m_s: float = 1.3) -> np.ndarray:
    """Landmarks (T, 21, 3) of somebody who walks straight ahead."""
    rng = np.random.default_rng(4)
    figure = make_figure(1.75, "male", 1.0, rng=rng)
    path = Path((-2.0, 0.0), (0.0, 0.0), 0.4, False)
    pose = MOTIONS[motion](figure, T, FPS, rng=rng, path=path, speed_m_s=speed_m_s)
    where = forward_kinematics(figure.offsets, pose.rotations, pose.root_position)
    out = np.concatenate([figure_landmarks(figure, *where), feet_and_hands_of(figure, *where)], axis=1)
    return out + noise_m * rng.standard_normal(out.shape)


def true_contacts(landmarks: np.ndarray) -> np.ndarray:
    sole = landmarks[:, SOLE]
    speed = np.linalg.norm(np.gradient(sole, axis=0), axis=2) * FPS
    return (speed < 0.35) & (sole[..., 2] < 0.025)


def poses_of(landmarks: np.ndarray) -> PersonPoses:
    body = scale_body(load_body_model("whole"), 1.75)
    n = len(landmarks)
    return PersonPoses(
        person=1,
        body=body,
        height=HeightEstimate(1.75, True),
        frames=np.arange(n),
        states=np.zeros((n, body.layout.n_columns)),
        landmarks=landmarks,
        landmark_covariance=np.tile(1e-4 * np.eye(3), (n, len(ALL_LANDMARKS), 1, 1)),
        observed=np.ones((n, len(ALL_LANDMARKS)), dtype=np.bool_),
        log_likelihood=np.zeros(n),
        ess_share=np.ones(n),
        start_frame=0,
        first_pose="stand",
    )


@pytest.mark.parametrize("noise_m", [0.0, 0.002])
def test_strikes_and_offs_are_told_to_a_frame(noise_m: float) -> None:
    landmarks, truth = walk(noise_m=noise_m), true_contacts(walk())
    gait = gait_of(poses_of(landmarks), FPS, SETTINGS)
    for k, side in enumerate(("left", "right")):
        either = truth[:, 2 * k] | truth[:, 2 * k + 1]
        runs = [r for r in unbroken_runs(either) if len(r) > 2]
        strikes = [r[0] for r in runs if r[0] > 0]
        offs = [r[-1] + 1 for r in runs if r[-1] + 1 < T]
        own = [s for s in gait.stances if s.side == side]
        np.testing.assert_allclose([s.strike for s in own if s.strike is not None], strikes, atol=1)
        np.testing.assert_allclose([s.off for s in own if s.off is not None], offs, atol=1)


def test_the_numbers_of_a_walk_are_those_of_its_feet() -> None:
    landmarks = walk()
    numbers = gait_numbers(gait_of(poses_of(landmarks), FPS, SETTINGS))
    pelvis = landmarks[:, 0, :2]
    speed = np.linalg.norm(pelvis[-1] - pelvis[0]) / ((T - 1) / FPS)
    assert numbers["speed_m_s"] == pytest.approx(speed, rel=0.05)
    assert numbers["step_length_m"] == pytest.approx(speed * 60.0 / numbers["cadence_per_min"], rel=0.05)
    assert 0.03 < numbers["step_width_m"] < 0.2
    assert 55.0 < numbers["stance_percent"] < 68.0
    assert numbers["step_length_asymmetry_percent"] < 5.0


def test_a_foot_that_is_down_for_a_moment_has_not_stood() -> None:
    down = np.zeros((30, 4))
    down[4:6, 0] = down[10:20, 0] = down[28:, 0] = 1.0
    contacts = Contacts(down, np.zeros(4), down)
    stances = stances_of(np.zeros((30, 4, 3)), contacts, SETTINGS.least_stance_s * FPS)
    assert [(s.strike, s.off) for s in stances] == [(10, 20), (28, None)]


def test_a_jog_has_frames_in_which_no_foot_is_down() -> None:
    gait = gait_of(poses_of(walk(motion="jog", speed_m_s=2.6)), FPS, SETTINGS)
    assert gait.contacts is not None
    flight = (gait.contacts.probability < 0.5).all(axis=1)
    assert flight.mean() > 0.1
    assert len(gait.steps) >= 6
    assert gait_numbers(gait)["stance_percent"] < 50.0


def test_held_points_rest_and_others_stay() -> None:
    drift = 0.012 * np.sin(2 * np.pi * np.arange(T) / 25.0)  # slow, as what a smoother leaves
    shaky = walk()[:, SOLE] + drift[:, None, None] * np.array([1.0, 0.0, 0.0])
    contacts = contacts_of(shaky, np.full(shaky.shape[:2], 1e-4), FPS, SETTINGS)
    calm = held(shaky, contacts, SETTINGS.hold_s * FPS)
    before, after = slips_m(shaky, contacts.runs), slips_m(calm, contacts.runs)
    assert np.median(before) > 0.005
    assert np.median(after) < 0.001
    assert after.max() < 0.005
    away = contacts.probability < 0.5
    np.testing.assert_array_equal(calm[away], shaky[away])
    assert away.any()


def test_no_contact_is_invented_in_the_air() -> None:
    flying = walk()[:, SOLE] + np.array([0.0, 0.0, 0.5])
    np.testing.assert_array_equal(lowest_level(flying, SETTINGS), np.zeros(4))
    assert (contacts_of(flying, np.zeros(flying.shape[:2]), FPS, SETTINGS).probability < 0.5).all()


# --------------------------------------------------------------------------------------------------- bad recordings


def test_a_hidden_foot_is_said_in_words() -> None:
    poses = poses_of(walk())
    observed = poses.observed.copy()
    observed[20:, ALL_LANDMARKS.index("left_toe")] = False
    poses = replace(poses, observed=observed)
    gait = gait_of(poses, FPS, SETTINGS)
    assert gait.contacts is None
    assert not gait.steps
    (warning,) = warnings_of_gait(poses, gait, FPS, SETTINGS)
    assert "the left foot was observed in 17 % of the frames only" in warning
    assert gait_numbers(gait) == {}


@pytest.mark.parametrize(("frames", "is_told"), [(1, False), (3, False), (4, True)])
def test_an_instant_tells_no_contacts(frames: int, is_told: bool) -> None:
    poses = poses_of(walk()[:frames])
    gait = gait_of(poses, 30.0, SETTINGS)
    assert (gait.contacts is not None) == is_told
    if not is_told:
        (warning,) = warnings_of_gait(poses, gait, 30.0, SETTINGS)
        assert "followed for less time than a foot stands" in warning


def test_a_floor_that_is_not_there_is_said_in_words() -> None:
    poses = poses_of(walk() + np.array([0.0, 0.0, 0.3]))
    (warning,) = warnings_of_gait(poses, gait_of(poses, FPS, SETTINGS), FPS, SETTINGS)
    assert "there is no floor at z = 0" in warning


def test_a_treadmill_is_said_in_words() -> None:
    on_belt = walk() - 1.3 * (np.arange(T) / FPS)[:, None, None] * np.array([np.cos(0.4), np.sin(0.4), 0.0])
    poses = poses_of(on_belt)
    warnings = warnings_of_gait(poses, gait_of(poses, FPS, SETTINGS), FPS, SETTINGS)
    assert any("treadmill" in w for w in warnings)
    still = poses_of(walk())
    assert warnings_of_gait(still, gait_of(still, FPS, SETTINGS), FPS, SETTINGS) == []


def test_a_body_without_feet_has_no_contacts_and_no_warning() -> None:
    poses = poses_of(walk())
    poses = replace(poses, landmarks=poses.landmarks[:, :15], observed=poses.observed[:, :15])
    gait = gait_of(poses, FPS, SETTINGS)
    assert gait.contacts is None
    assert warnings_of_gait(poses, gait, FPS, SETTINGS) == []


def test_who_was_away_has_the_steps_of_every_stretch() -> None:
    poses = poses_of(walk())
    frames = np.where(np.arange(T) < 60, np.arange(T), np.arange(T) + 30)
    away = replace(poses, frames=frames)
    gait, whole = gait_of(away, FPS, SETTINGS), gait_of(poses, FPS, SETTINGS)
    assert warnings_of_gait(away, gait, FPS, SETTINGS) == []
    strikes, before = ([s.strike for s in g.stances if s.strike is not None] for g in (gait, whole))
    assert set(strikes) <= set(before)  # rows; the stance that the absence cuts has no strike
    assert min(strikes) < 60 < max(strikes)
    assert not any(s.stance.strike - round(s.time_s * FPS) < 60 <= s.stance.strike for s in gait.steps)
    assert len(gait.steps) == sum(
        not s.stance.strike - round(s.time_s * FPS) < 60 <= s.stance.strike for s in whole.steps
    )
    person = Kinematics(away, FPS, Method(contact=SETTINGS))
    told = sorted(round(e.time_s * FPS) for e in foot_events(person) if e.label == "Foot Strike")
    assert told == sorted(frames[row] for row in strikes)
    assert all(np.ptp(frames[list(r)]) == r[1] - r[0] for c in person.cycles for r in c.rows)


def test_feet_on_stairs_are_said_in_words() -> None:
    landmarks = np.repeat(walk()[:1], T, axis=0)
    landmarks[:, SOLE, 2] = 0.0
    landmarks[40:100, SOLE[:2], 2] = 0.17
    poses = poses_of(landmarks)
    words = warnings_of_gait(poses, gait_of(poses, FPS, SETTINGS), FPS, SETTINGS)
    assert any("rests 17 cm over the floor" in text for text in words)


def test_a_floor_just_out_of_reach_is_not_passed_over_in_silence() -> None:
    """Between 6 cm, where a lowest place of all soles is, and 8, where each of them is: nothing rests."""
    for shift in np.arange(0.0, 0.2, 0.01):
        poses = poses_of(walk() + np.array([0.0, 0.0, shift]))
        gait = gait_of(poses, FPS, SETTINGS)
        assert gait.steps or warnings_of_gait(poses, gait, FPS, SETTINGS), shift


def test_a_pause_is_no_slow_step() -> None:
    landmarks = walk()
    paused = poses_of(
        np.concatenate([landmarks[:60], np.repeat(landmarks[60:61], 150, axis=0), landmarks[60:]])
    )
    told, plain = (gait_numbers(gait_of(p, FPS, SETTINGS)) for p in (paused, poses_of(landmarks)))
    for name in ("cadence_per_min", "speed_m_s", "stance_s", "step_length_m"):
        assert told[name] == pytest.approx(plain[name], rel=0.06), name


def test_a_stance_that_was_not_seen_counts_in_no_mean() -> None:
    poses = poses_of(walk())
    gait = gait_of(poses, FPS, SETTINGS)
    hidden = gait.steps[2].stance
    observed = poses.observed.copy()
    observed[hidden.strike : hidden.off, ALL_LANDMARKS.index(f"{hidden.side}_heel")] = False
    again = gait_of(replace(poses, observed=observed), FPS, SETTINGS)
    assert [s.is_observed for s in again.stances].count(False) == 1
    assert next(s for s in again.stances if not s.is_observed).strike == hidden.strike
    assert gait_numbers(again)["steps"] == gait_numbers(gait)["steps"]
    assert gait_numbers(again)["step_length_m"] != gait_numbers(gait)["step_length_m"]


# ------------------------------------------------------------------------------------------------------------ floor


@pytest.mark.parametrize(("shift_m", "tilt_deg"), [(0.0, 0.0), (0.04, 0.0), (0.0, 2.5)])
def test_the_floor_of_the_feet_is_measured(shift_m: float, tilt_deg: float) -> None:
    rng = np.random.default_rng(4)
    figure = make_figure(1.75, "male", 1.0, rng=rng)
    pose = MOTIONS["walk"](
        figure, 300, FPS, rng=rng, path=Path((0.0, 0.0), (1.6, 1.2), 0.0, False), speed_m_s=1.2
    )
    points = feet_and_hands_of(
        figure, *forward_kinematics(figure.offsets, pose.rotations, pose.root_position)
    )[:, OWN]
    contacts = contacts_of(points, np.zeros(points.shape[:2]), FPS, SETTINGS)
    points[..., 2] += shift_m - np.tan(np.deg2rad(tilt_deg)) * points[..., 0]
    check = check_floor(points, contacts, SETTINGS)
    assert check is not None
    assert check.tilt_deg is not None
    assert check.tilt_deg == pytest.approx(tilt_deg, abs=0.3)
    if tilt_deg:
        assert check.downhill_deg == pytest.approx(0.0, abs=8.0)
    else:
        assert check.height_m == pytest.approx(shift_m, abs=0.004)


@pytest.mark.parametrize("tilt_deg", [2.0, 4.0, 8.0])
def test_steps_are_told_on_a_floor_that_falls(tilt_deg: float) -> None:
    """Half of the steps were missed on a floor of two degrees, and all, without a word of a slope, on one of four."""
    figure = make_figure(1.75, "male", 1.0, rng=np.random.default_rng(4))
    pose = MOTIONS["walk"](
        figure,
        240,
        FPS,
        rng=np.random.default_rng(4),
        path=Path((0.0, 0.0), (1.6, 1.2), 0.0, False),
        speed_m_s=1.2,
    )
    where = forward_kinematics(figure.offsets, pose.rotations, pose.root_position)
    level = np.concatenate([figure_landmarks(figure, *where), feet_and_hands_of(figure, *where)], axis=1)
    a = np.deg2rad(tilt_deg)
    falls = level @ np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]).T
    plain, tilted = (gait_of(poses_of(p), FPS, SETTINGS) for p in (level, falls))
    assert plain.slope is None
    assert [s.side for s in tilted.stances] == [s.side for s in plain.stances]
    for own, true in zip(tilted.stances, plain.stances, strict=True):
        assert (own.strike is None) == (true.strike is None)
        assert own.strike is None or abs(own.strike - true.strike) <= 1
    (words,) = warnings_of_gait(poses_of(falls), tilted, FPS, SETTINGS)
    assert f"falls by {tilt_deg:.1f} degrees" in words


def test_whole_is_girdle_until_its_chest_feet_and_hands_move() -> None:
    whole, girdle = (scale_body(load_body_model(name), 1.7) for name in ("whole", "girdle"))
    rng = np.random.default_rng(1)
    state = np.zeros(whole.layout.n_columns)
    common = [whole.layout.names.index(name) for name in girdle.layout.names]
    state[common] = rng.uniform(-0.3, 0.3, len(common))
    of_whole, of_girdle = landmarks_of(whole, state[None]), landmarks_of(girdle, state[common][None])
    np.testing.assert_allclose(of_whole[:, :15], of_girdle, atol=1e-12)
    new = [name for name in whole.layout.names if name not in girdle.layout.names]
    assert len(new) == 15
    ankle = whole.layout.names.index("left_ankle_y")
    up = state.copy()
    up[ankle] -= 0.3  # dorsiflexion lifts the toe
    toe = ALL_LANDMARKS.index("left_toe")
    rest, lifted = (landmarks_of(whole, np.zeros(len(state))[None] + s)[0, toe, 2] for s in (0, up - state))
    assert lifted > rest + 0.03


def test_strikes_and_offs_are_events_of_a_c3d_file(tmp_path: FilePath) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    poses = poses_of(walk())
    poses = replace(poses, frames=poses.frames + 30)
    events = foot_events(Kinematics(poses, FPS, Method(contact=SETTINGS)))
    assert {event.side for event in events} == {"Left", "Right"}
    write_c3d(tmp_path / "walk.c3d", motion_of(poses, FPS), FPS, events)
    group = ezc3d.c3d(str(tmp_path / "walk.c3d"))["parameters"]["EVENT"]
    assert group["USED"]["value"][0] == len(events)
    assert list(group["LABELS"]["value"]) == [event.label for event in events]
    assert list(group["CONTEXTS"]["value"]) == [event.side for event in events]
    minutes, seconds = group["TIMES"]["value"]
    np.testing.assert_allclose(60 * minutes + seconds, [event.time_s for event in events], atol=1e-5)
    strikes = [s.strike + 30 for s in gait_of(poses, FPS, SETTINGS).stances if s.strike is not None]
    told = [event.time_s * FPS for event in events if event.label == "Foot Strike"]
    np.testing.assert_allclose(sorted(told), sorted(strikes))


# ------------------------------------------------------------------------------------------------------- smoother


def standing_series(n: int, sway_m: float) -> FrameSeries:
    """Somebody who stands; the whole body, soles too, is found swaying slowly."""
    body = scale_body(load_body_model("whole"), 1.75)
    states = np.tile(neutral_state(body), (n, 1))
    states[:, 0] += sway_m * np.sin(2 * np.pi * np.arange(n) / 24.0)
    series = FrameSeries.of_length(n, body)
    return replace(series, states=states, misfit=np.ones_like(series.misfit))


def test_contacts_and_steps_are_tables(tmp_path: FilePath) -> None:
    poses = poses_of(walk())
    observed = poses.observed.copy()
    observed[3, ALL_LANDMARKS.index("right_toe")] = False
    poses = replace(poses, frames=poses.frames + 30, observed=observed)
    person = Kinematics(poses, FPS, Method(contact=SETTINGS))
    write_contacts_csv(tmp_path / "contacts.csv", [person])
    head, *rows = (tmp_path / "contacts.csv").read_text().splitlines()
    assert tuple(head.split(",")) == CONTACT_COLUMNS
    assert len(rows) == 4 * T
    assert [row.split(",")[3] for row in rows[:4]] == ["left_heel", "left_toe", "right_heel", "right_toe"]
    told = np.array([float(row.split(",")[4]) for row in rows]).reshape(T, 4)
    np.testing.assert_allclose(told, person.gait.contacts.probability, atol=1e-4)
    assert [row for row in rows if row.endswith(",0")] == [rows[4 * 3 + 3]]
    assert rows[0].split(",")[:3] == ["30", "1.000000", "1"]
    write_steps_csv(tmp_path / "steps.csv", [person])
    head, *rows = (tmp_path / "steps.csv").read_text().splitlines()
    assert tuple(head.split(",")) == STEP_COLUMNS
    assert len(rows) == len(person.gait.stances)
    strikes = [row.split(",")[2] for row in rows]
    assert strikes == [str(s.strike + 30) if s.strike is not None else "" for s in person.gait.stances]
    write_contacts_csv(tmp_path / "contacts.csv", [])
    assert (tmp_path / "contacts.csv").read_text() == ",".join(CONTACT_COLUMNS) + "\n"


def test_jumps_and_squats_are_a_table(tmp_path: FilePath) -> None:
    rng = np.random.default_rng(3)
    figure = make_figure(1.75, "male", 1.0, rng=rng)
    pose = MOTIONS["jump"](figure, 90, FPS, rng=rng, position=(0.0, 0.0), heading_rad=0.0)
    where = forward_kinematics(figure.offsets, pose.rotations, pose.root_position)
    poses = poses_of(
        np.concatenate([figure_landmarks(figure, *where), feet_and_hands_of(figure, *where)], axis=1)
    )
    person = Kinematics(poses, FPS, Method(contact=SETTINGS))
    path = tmp_path / "moves.csv"
    write_moves_csv(path, [person])
    head, row = path.read_text().splitlines()
    move = dict(zip(head.split(","), row.split(","), strict=True))
    assert tuple(move) == MOVE_COLUMNS
    assert (move["person"], move["move"], move["knee_flexion_deg"]) == ("1", "jump", "")
    pelvis = poses.landmarks[:, 0, 2]
    assert int(move["extreme_frame"]) == int(poses.frames[0]) + pelvis.argmax()
    assert float(move["height_m"]) == pytest.approx(pelvis.max() - pelvis[0], abs=0.005)
    assert moves_of(poses, replace(person.gait, contacts=None), FPS) == ()
    write_moves_csv(path, [])
    assert path.read_text() == ",".join(MOVE_COLUMNS) + "\n"


def test_the_smoother_holds_a_planted_foot_and_lets_the_trunk_sway() -> None:
    body, n = scale_body(load_body_model("whole"), 1.75), 60
    series = standing_series(n, sway_m=0.012)
    moved = {}
    for hold in (0.0, 30.0):
        method = replace(Method(), contact=ContactSettings(hold=hold))
        landmarks = landmarks_of(body, smooth_motion(body, series, FPS, 8, method))
        moved[hold] = np.ptp(landmarks[..., 0], axis=0)
    free, held_on = moved[0.0], moved[30.0]
    assert free[SOLE].min() > 0.015
    assert held_on[SOLE].max() < 0.4 * free[SOLE].min()
    neck = ALL_LANDMARKS.index("neck")
    assert held_on[neck] > 0.8 * free[neck]

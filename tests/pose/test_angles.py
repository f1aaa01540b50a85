"""Anatomical angles of poses: deviations against drawn poses, what is observed, the table and OpenSim's motion file."""

import numpy as np
import pytest
from marker_world import marching

from mocap.body import Body, joint_transforms, landmarks_of, load_body_model, neutral_state, scale_body
from mocap.body.initial import HeightEstimate
from mocap.body.kinematics import point_jacobian
from mocap.data import LANDMARKS
from mocap.errors import MocapError
from mocap.io.angle_table import read_angles_csv, write_angles_csv
from mocap.io.formats import write_mot
from mocap.pose.angles import anatomical_states, angles_of, angles_of_states, body_angles
from mocap.pose.method import AngleSettings
from mocap.pose.opensim import GROUND_FROM_WORLD, coordinates_of_states
from mocap.pose.result import PersonPoses

BODY = scale_body(load_body_model("girdle"), 1.75)
NAMES = body_angles(BODY)
FPS = 30.0
BARE = AngleSettings(of_angle={}, of_others=(0.0, 1.0), spine_std_deg=1e6)  # what the landmarks say alone


def poses_of(
    states: np.ndarray, std_m: float = 0.01, observed: np.ndarray | None = None, body: Body = BODY
) -> PersonPoses:
    T, L = len(states), len(body.landmarks)
    return PersonPoses(
        person=1,
        body=body,
        height=HeightEstimate(body.height_m, True),
        frames=np.arange(3, 3 + T),
        states=states,
        landmarks=landmarks_of(body, states),
        landmark_covariance=np.tile(std_m**2 * np.eye(3), (T, L, 1, 1)),
        observed=np.ones((T, L), dtype=bool) if observed is None else observed,
        log_likelihood=np.zeros(T),
        ess_share=np.ones(T),
        start_frame=3,
        first_pose="",
    )


def posed(**columns: float) -> np.ndarray:
    state = neutral_state(BODY)
    for name, value in columns.items():
        state[BODY.layout.names.index(name)] = value
    return state[None]


def test_a_body_has_the_angles_that_its_joints_allow() -> None:
    assert {"pelvis_tilt", "trunk_rotation", "left_hip_rotation", "right_knee_flexion"} <= set(NAMES)
    # The neck of this body does not turn, its knees and elbows are hinges, hands and feet do not move.
    for missing in ("neck_rotation", "left_knee_rotation", "right_elbow_pronation", "left_wrist_flexion"):
        assert missing not in NAMES
    dog = scale_body(load_body_model("docs/examples/dog.toml"), 0.75)
    assert angles_of_states(dog, np.zeros((2, dog.layout.n_columns))).shape == (2, len(body_angles(dog)))


@pytest.mark.parametrize(
    ("column", "turn", "angle", "value"),
    [
        ("left_ankle_y", -0.2, "left_ankle_dorsiflexion", 0.2),  # toes up
        ("right_ankle_y", -0.2, "right_ankle_dorsiflexion", 0.2),
        ("right_ankle_x", 0.2, "right_ankle_inversion", 0.2),  # the sole to the left
        ("left_mtp_y", -0.2, "left_mtp_extension", 0.2),  # toes up
        (
            "left_wrist_x",
            -0.2,
            "left_wrist_flexion",
            0.2,
        ),  # of an arm to the side: the palm, which is below, down
        ("right_wrist_x", 0.2, "right_wrist_flexion", 0.2),
        ("left_wrist_z", 0.2, "left_wrist_deviation", 0.2),  # of an arm to the side: the hand to the back
        ("right_wrist_z", -0.2, "right_wrist_deviation", 0.2),
    ],
)
def test_feet_and_hands_have_angles_where_they_move(
    column: str, turn: float, angle: str, value: float
) -> None:
    body = scale_body(load_body_model("whole"), 1.75)
    states = np.tile(neutral_state(body), (2, 1))
    states[1, body.layout.names.index(column)] += turn
    at = body_angles(body).index(angle)
    found = angles_of_states(body, states)[:, at]
    assert found[1] - found[0] == pytest.approx(value, abs=1e-6)


def test_what_nothing_shows_is_inferred_and_never_observed() -> None:
    """Pronation and how the spine shares a bend; the bend itself, and the hand, are observed."""
    body = scale_body(load_body_model("whole"), 1.75)
    state = neutral_state(body)
    for column, angle in (("waist_y", 0.45), ("thorax_y", 0.15), ("left_forearm_y", 0.5)):
        state[body.layout.names.index(column)] = angle
    found = angles_of(poses_of(state[None], body=body), FPS, BARE)
    inferred = {n for n, o in zip(found.names, found.observed[0], strict=True) if not o}
    spine = {f"{j}_{a}" for j in ("lumbar", "thoracic") for a in ("flexion", "bending", "rotation")}
    # A straight limb does not show how it is turned either.
    straight = {n for n in inferred if n.endswith("_rotation")} - spine
    assert inferred - straight == spine | {"left_elbow_pronation", "right_elbow_pronation"}
    value = dict(zip(found.names, found.values[0], strict=True))
    assert value["lumbar_flexion"] == pytest.approx(0.45, abs=1e-9)
    # The thorax of somebody upright lies further back than its flesh at rest.
    upright = body.standing_pitch[body.joints.index("thorax")]
    assert upright < -0.02
    assert value["thoracic_flexion"] == pytest.approx(0.15 - upright, abs=1e-6)
    assert value["trunk_flexion"] == pytest.approx(0.6 - upright, abs=1e-6)
    assert abs(value["left_elbow_pronation"]) == pytest.approx(0.5, abs=1e-9)
    # Nothing but what is usual says how a forearm is turned.
    usual = body.usual_std[body.layout.names.index("left_forearm_y")]
    std = found.std[0, found.names.index("left_elbow_pronation")]
    assert std == pytest.approx(usual, rel=0.05)


def test_deviations_are_those_of_poses_whose_landmarks_scatter() -> None:
    """A bent leg: landmarks are shaken, the body is fitted to them, and the angles scatter as was claimed."""
    state = posed(left_hip_y=-0.7, left_knee_y=1.1, right_hip_y=-0.4, right_knee_y=0.8)
    std_m = 0.003  # small, so that the fit is nearly linear
    claimed = np.rad2deg(angles_of(poses_of(state, std_m), FPS, BARE).std[0])
    rng = np.random.default_rng(0)
    _, J, _ = point_jacobian(BODY, state[0], BODY.landmark_joint, BODY.landmark_offset)
    J = J.reshape(-1, J.shape[-1])
    weak = np.where(BODY.is_position, 1.0, BARE.weak_std_rad) ** -2.0 * std_m**2
    noise = std_m * rng.standard_normal((4000, len(J)))
    # The weak knowledge is an observation too: it has its own error.
    own = std_m * rng.standard_normal((4000, len(weak)))
    shift = np.linalg.solve(J.T @ J + np.diag(weak), (noise @ J + own * np.sqrt(weak)).T).T
    drawn = np.rad2deg(angles_of_states(BODY, state + shift))
    for name in (
        "left_hip_flexion",
        "left_knee_flexion",
        "right_knee_flexion",
        "pelvis_rotation",
        "trunk_flexion",
    ):
        a = NAMES.index(name)
        assert drawn[:, a].std() == pytest.approx(claimed[a], rel=0.1), name


def test_surer_landmarks_make_surer_angles_and_the_floor_stays() -> None:
    state = posed(left_knee_y=0.8, left_hip_y=-0.4)
    a = NAMES.index("left_knee_flexion")
    few, many = (angles_of(poses_of(state, s), FPS, BARE).std[0, a] for s in (0.005, 0.02))
    assert many > 3.0 * few
    floor = AngleSettings(of_angle={"knee_flexion": (4.0, 1.0)}, of_others=(0.0, 1.0))
    sure = angles_of(poses_of(state, 1e-6), FPS, floor).std[0, a]
    assert np.rad2deg(sure) == pytest.approx(4.0, abs=0.01)


def test_the_turn_of_a_straight_leg_is_not_observed_that_of_a_bent_one_is() -> None:
    turn = NAMES.index("left_hip_rotation")
    series = angles_of(poses_of(np.concatenate([posed(), posed(left_knee_y=0.9)])), FPS, BARE)
    assert series.observed[:, turn].tolist() == [False, True]
    assert series.std[0, turn] > 3.0 * series.std[1, turn]
    assert series.observed[:, NAMES.index("left_hip_flexion")].all()


def test_an_angle_is_observed_when_its_landmarks_are() -> None:
    observed = np.ones((1, len(LANDMARKS)), dtype=bool)
    observed[0, LANDMARKS.index("left_ankle")] = False
    series = angles_of(poses_of(posed(), observed=observed), FPS, BARE)
    assert not series.observed[0, NAMES.index("left_knee_flexion")]
    assert series.observed[0, NAMES.index("right_knee_flexion")]
    assert series.observed[0, NAMES.index("left_hip_flexion")]


def test_where_angles_cannot_be_told_apart_nothing_is_claimed() -> None:
    """An arm straight to the side: flexion and rotation turn about one axis."""
    state = posed(left_shoulder_x=0.0, right_shoulder_x=0.0)
    series = angles_of(poses_of(state), FPS, BARE)
    assert np.isfinite(series.std).all()
    a = NAMES.index("left_shoulder_flexion")
    assert series.std[0, a] > 0.5
    assert series.std.max() <= np.pi / np.sqrt(3.0)


def test_the_table_comes_back(tmp_path) -> None:
    series = angles_of(poses_of(marching(BODY, 5, FPS)), FPS, AngleSettings())
    write_angles_csv(tmp_path / "angles.csv", [series])
    (again,) = read_angles_csv(tmp_path / "angles.csv")
    assert again.names == series.names
    assert again.frames.tolist() == series.frames.tolist()
    assert again.time_s == pytest.approx(series.time_s, abs=1e-6)
    assert again.values == pytest.approx(series.values, abs=1e-5)
    assert again.std == pytest.approx(series.std, abs=1e-5)
    assert (again.observed == series.observed).all()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("0,0.0,1,left_knee_flexion,x,1.0,1", "line 3: value_deg is 'x'"),
        ("0,0.0,1,pelvis_tilt,2.0,1.0,1", "there twice"),
        ("-1,0.0,1,left_knee_flexion,2.0,1.0,1", "frame is '-1'"),
        ("0,0.0,1,left_knee_flexion,inf,1.0,1", "infinite"),
    ],
)
def test_a_bad_line_is_named(tmp_path, line: str, message: str) -> None:
    path = tmp_path / "angles.csv"
    path.write_text(
        f"frame,time_s,person,angle,value_deg,std_deg,observed\n0,0.0,1,pelvis_tilt,2.0,1.0,1\n{line}\n"
    )
    with pytest.raises(MocapError, match=message):
        read_angles_csv(path)


def test_nobody_gives_an_empty_table(tmp_path) -> None:
    write_angles_csv(tmp_path / "angles.csv", [])
    assert read_angles_csv(tmp_path / "angles.csv") == []


def test_opensim_has_the_pelvis_where_the_markers_are_and_the_angles_that_the_table_has() -> None:
    states = np.concatenate([posed(root_yaw=2.5, root_pitch=0.2, root_roll=-0.1, left_knee_y=0.7)] * 2)
    states[1, BODY.layout.names.index("root_yaw")] += 1.0  # beyond half a turn: no jump by a whole one
    found = coordinates_of_states(BODY, states)
    R, t = joint_transforms(BODY, states)
    place = np.stack([found[n] for n in ("pelvis_tx", "pelvis_ty", "pelvis_tz")], axis=1)
    assert place == pytest.approx(t[:, 0] @ GROUND_FROM_WORLD.T)
    turns = np.deg2rad(
        [[found[n][i] for n in ("pelvis_tilt", "pelvis_list", "pelvis_rotation")] for i in (0, 1)]
    )
    for i in (0, 1):
        c, s = np.cos(turns[i]), np.sin(turns[i])
        about_z = np.array([[c[0], -s[0], 0], [s[0], c[0], 0], [0, 0, 1]])
        about_x = np.array([[1, 0, 0], [0, c[1], -s[1]], [0, s[1], c[1]]])
        about_y = np.array([[c[2], 0, s[2]], [0, 1, 0], [-s[2], 0, c[2]]])
        forward = about_z @ about_x @ about_y @ [1.0, 0.0, 0.0]
        assert forward == pytest.approx(GROUND_FROM_WORLD @ R[i, 0] @ [1.0, 0.0, 0.0])
    assert np.abs(np.diff(turns, axis=0)).max() < 2.0
    assert found["knee_angle_l"] == pytest.approx(np.rad2deg([0.7, 0.7]))
    assert set(found) >= {"hip_flexion_r", "lumbar_extension", "arm_flex_l", "elbow_flex_r"}


def test_a_motion_file_says_how_large_it_is_and_refuses_gaps(tmp_path) -> None:
    path = tmp_path / "walk.mot"
    write_mot(
        path, np.array([0.0, 0.1]), {"knee_angle_r": np.array([1.0, 2.0]), "pelvis_ty": np.array([0.9, 0.9])}
    )
    lines = path.read_text().splitlines()
    assert lines[:6] == ["walk", "version=1", "nRows=2", "nColumns=3", "inDegrees=yes", "endheader"]
    assert lines[6].split("\t") == ["time", "knee_angle_r", "pelvis_ty"]
    assert [float(x) for x in lines[8].split("\t")] == [0.1, 2.0, 0.9]
    with pytest.raises(ValueError, match="knee_angle_r is not known"):
        write_mot(path, np.array([0.0]), {"knee_angle_r": np.array([np.nan])})


def test_a_spine_moves_the_pelvis_under_a_trunk_and_thighs_that_stay() -> None:
    """The pelvis is tipped backwards under an upright trunk, which the landmarks hardly show."""
    states = posed(root_pitch=-0.25, waist_y=0.25, left_hip_y=0.25 - 0.4, right_hip_y=0.25)
    before, after = angles_of(poses_of(states), FPS, BARE), angles_of(poses_of(states), FPS, AngleSettings())

    def degrees(series, *names):
        return sum(np.rad2deg(series.of(name)[0]) for name in names)

    assert abs(degrees(after, "pelvis_tilt")) < 0.4 * abs(degrees(before, "pelvis_tilt"))
    assert degrees(after, "pelvis_tilt", "trunk_flexion") == pytest.approx(0.0, abs=1.5)
    assert degrees(after, "left_hip_flexion") - degrees(after, "pelvis_tilt") == pytest.approx(
        np.rad2deg(0.4), abs=1.5
    )
    moved, _ = anatomical_states(poses_of(states), AngleSettings())
    assert np.linalg.norm(landmarks_of(BODY, moved) - landmarks_of(BODY, states), axis=2).max() < 0.01
    a = NAMES.index("left_hip_flexion")
    assert after.std[0, a] < 0.7 * before.std[0, a]

"""Motions: planted feet, natural joints, constant limbs."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap.data import LANDMARKS
from mocap.synth.body import Body, build_body, trunk_depth
from mocap.synth.figure import JOINT, Figure, forward_kinematics, landmarks_of, make_figure
from mocap.synth.motions import MOTIONS, Path, Pose, Stop
from mocap.synth.motions.anatomy import RANGES_DEG, joint_angles, pose_of, range_of
from mocap.synth.motions.kit import blend_rotations, solve_two_bones
from mocap.synth.motions.seat import place_before
from mocap.synth.motions.steps import Footsteps
from mocap.synth.motions.throw import PERIOD_S
from mocap.synth.motions.walk import walk

FPS = 50.0
N_FRAMES = 110
MAX_SLIDE_M = 0.005
FLOOR_M = -0.010  # the skin of a heel gives way
MAX_INTO_TRUNK_M = 0.030  # soft flesh; arms hang against stout people
MAX_TURN_DEG_S = 1500  # a fast punch or the ankle at push-off
MAX_ACCELERATION_M_S2 = (
    190.0  # of a joint; a foot that strikes or leaves the floor at 3 m/s within a frame or two
)
STANDING = ("stand", "gesture", "box", "pick_up", "sit")
N_SEEDS = 6  # bodies and variations over which ranges are tried

Array = NDArray[np.float64]


def _perform(figure: Figure, name: str, rng: np.random.Generator, n_frames: int = N_FRAMES) -> Pose:
    """Any motion somewhere in the room, with its parameters drawn."""
    at = (float(rng.uniform(-1, 1)), float(rng.uniform(-1, 1)))
    angle = float(rng.uniform(-3, 3))
    if name in ("walk", "jog"):
        radii = (float(rng.uniform(0.9, 1.4)), float(rng.uniform(0.9, 1.4)))
        speed = float(rng.uniform(0.6, 1.6)) if name == "walk" else float(rng.uniform(1.4, 2.8))
        path = Path(at, radii, angle, bool(rng.integers(2)))
        return MOTIONS[name](figure, n_frames, FPS, path=path, speed_m_s=speed, rng=rng)
    if name == "route":
        stops = (Stop(at), Stop((1.0, -1.2), 0.8, angle), Stop((-1.0, 0.5), 0.9, -angle, 0.42))
        start = float(rng.uniform(-6, 0))
        return MOTIONS[name](
            figure, n_frames, FPS, stops=stops, speed_m_s=1.1, start_s=start, repeat=True, rng=rng
        )
    extra = {"start_s": 0.5} if name == "fall" else {}
    return MOTIONS[name](figure, n_frames, FPS, position=at, heading_rad=angle, rng=rng, **extra)


@cache
def _example(name: str, seed: int) -> tuple[Figure, Pose]:
    """A person drawn from the seed who performs."""
    rng = np.random.default_rng(seed)
    sex = "male" if seed % 2 else "female"
    figure = make_figure(rng.uniform(1.5, 1.95), sex, rng.uniform(0.85, 1.2), rng=rng)
    return figure, _perform(figure, name, rng)


@cache
def _flesh(seed: int) -> Body:
    return build_body(_example("stand", seed)[0], cell_m=0.03)


def _joints(figure: Figure, pose: Pose) -> tuple[Array, Array]:
    return forward_kinematics(figure.offsets, pose.rotations, pose.root_position)


@pytest.fixture(scope="module")
def figure() -> Figure:
    return make_figure(1.72, "female", 1.0, rng=np.random.default_rng(8))


@pytest.fixture(params=sorted(set(MOTIONS) - {"capture"}))  # tests of its own
def name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.mark.parametrize("seed", range(3))
def test_standing_feet_do_not_slide(name: str, seed: int) -> None:
    figure, pose = _example(name, seed)
    position, _ = _joints(figure, pose)
    ground = np.zeros(pose.contact.shape) if pose.ground_m is None else pose.ground_m
    assert pose.contact.any()
    if name in STANDING:
        assert pose.contact.all()
    for i, side in enumerate(("left", "right")):
        for joint in ("ankle", "toe"):
            at = position[:, JOINT[f"{side}_{joint}"]]
            change = np.flatnonzero(np.diff(pose.contact[:, i].astype(int)) != 0) + 1
            for run in np.split(np.arange(len(at)), change):
                if pose.contact[run[0], i]:
                    assert np.linalg.norm(at[run] - at[run[0]], axis=1).max() < MAX_SLIDE_M
                    assert (
                        np.abs(
                            at[run, 2]
                            - (ground[run, i] + figure.ankle_height_m if joint == "ankle" else at[run[0], 2])
                        ).max()
                        < MAX_SLIDE_M
                    )


def test_one_foot_bears_unless_in_flight_or_lying(name: str) -> None:
    figure, pose = _example(name, 2)
    ankles = _joints(figure, pose)[0][:, [JOINT["left_ankle"], JOINT["right_ankle"]], 2]
    if name == "fall":
        return
    ankles = ankles if pose.ground_m is None else ankles - pose.ground_m
    lowest = -0.4 if name == "stairs" else 0.0  # a foot that comes to a stair starts two below it
    assert ankles.min() > 0.9 * figure.ankle_height_m + lowest
    # Toe-off is on the ball of the foot, flight is higher; a jump is one with both feet.
    highest_bearing = {"jog": 0.16, "jump": 0.36}.get(name, 0.09)
    assert ankles.min(axis=1).max() < figure.ankle_height_m + highest_bearing


def test_limb_lengths_are_constant(name: str) -> None:
    figure, pose = _example(name, 1)
    position, rotation = _joints(figure, pose)
    points = landmarks_of(figure, position, rotation)
    at = {n: points[:, i] for i, n in enumerate(LANDMARKS)}
    for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist")):
        for side in ("left", "right"):
            length = np.linalg.norm(at[f"{side}_{a}"] - at[f"{side}_{b}"], axis=1)
            assert np.ptp(length) < 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_rotations_are_rotations_and_nothing_jumps(name: str, seed: int) -> None:
    figure, pose = _example(name, seed)
    R = pose.rotations
    assert np.allclose(R @ R.swapaxes(-1, -2), np.eye(3), atol=1e-9)
    step = Rotation.from_matrix((R[1:] @ R[:-1].swapaxes(-1, -2)).reshape(-1, 3, 3)).magnitude()
    assert np.rad2deg(step.max()) * FPS < MAX_TURN_DEG_S
    position, _ = _joints(figure, pose)
    acceleration = np.linalg.norm(np.diff(position, 2, axis=0), axis=2) * FPS**2
    assert acceleration.max() < MAX_ACCELERATION_M_S2


@pytest.mark.parametrize("seed", range(N_SEEDS))
def test_joints_stay_within_the_ranges_of_people(name: str, seed: int) -> None:
    _, pose = _example(name, seed)
    for angle, degrees in joint_angles(pose.rotations).items():
        lower, upper = range_of(angle)
        assert lower <= degrees.min(), angle
        assert degrees.max() <= upper, angle


@pytest.mark.parametrize("seed", range(2))
def test_flesh_stays_above_the_floor_and_hands_outside_the_trunk(name: str, seed: int) -> None:
    figure, pose = _example(name, seed)
    body = _flesh(seed)
    position, rotation = _joints(figure, pose)
    for frame in range(0, len(position), 7):
        vertices, _ = body.pose(position[frame], rotation[frame])
        assert vertices[:, 2].min() > FLOOR_M
        assert trunk_depth(body, position[frame], rotation[frame]) < MAX_INTO_TRUNK_M


def test_walk_covers_the_ground_and_arms_oppose_legs(figure: Figure) -> None:
    path = Path((0.0, 0.0), (0.0, 0.0), 0.0, False)
    pose = walk(figure, 150, FPS, path=path, speed_m_s=1.2, rng=np.random.default_rng(1))
    travelled = pose.root_position[-1, 0] - pose.root_position[0, 0]
    assert abs(travelled - 1.2 * 149 / FPS) < 0.01
    position, _ = forward_kinematics(figure.offsets, pose.rotations, pose.root_position)
    root = position[:, 0, 0]
    foot = position[:, JOINT["left_ankle"], 0] - root
    same = position[:, JOINT["left_wrist"], 0] - root
    other = position[:, JOINT["right_wrist"], 0] - root
    assert np.corrcoef(foot, other)[0, 1] > 0.7
    assert np.corrcoef(foot, same)[0, 1] < -0.7
    rise = np.ptp(pose.root_position[:, 2])
    assert 0.02 < rise < 0.07  # normal gait: 3 to 5 cm
    knee = Rotation.from_matrix(pose.rotations[:, JOINT["left_knee"]]).as_rotvec()[:, 1]
    assert 45 < np.rad2deg(knee.max()) < 75  # swing flexion of normal gait: about 60 degrees
    assert np.rad2deg(knee.min()) < 15


def test_a_walk_backwards_is_a_walk_played_from_its_end(figure: Figure) -> None:
    path = Path((0.0, 0.0), (1.1, 1.0), 0.0, False)
    ahead, back = (
        walk(figure, 30, FPS, path=path, speed_m_s=1.0, backwards=backwards, rng=np.random.default_rng(1))
        for backwards in (False, True)
    )
    np.testing.assert_array_equal(back.root_position, ahead.root_position[::-1])
    np.testing.assert_array_equal(back.rotations, ahead.rotations[::-1])
    np.testing.assert_array_equal(back.contact, ahead.contact[::-1])
    way = np.diff(back.root_position[:, :2], axis=0)
    assert (
        np.einsum("tc,tc->t", way, back.rotations[:-1, 0, :2, 0]) < 0
    ).all()  # against where the pelvis faces


def test_jogging_has_a_flight_in_free_fall(figure: Figure) -> None:
    fps = 400.0
    path = Path((0.0, 0.0), (0.0, 0.0), 0.0, False)
    pose = MOTIONS["jog"](figure, 800, fps, path=path, speed_m_s=2.0, rng=np.random.default_rng(1))
    body = build_body(figure, cell_m=0.03)
    position, rotation = _joints(figure, pose)
    lowest = np.array(
        [body.pose(p, r)[0][:, 2].min() for p, r in zip(position[::4], rotation[::4], strict=True)]
    )
    flight = np.repeat(lowest > 0.002, 4)[: len(position)]
    assert 0.10 < flight.mean() < 0.28  # 28 % less the toes that trail
    assert not (pose.contact.any(axis=1) & flight).any()
    fall = np.diff(pose.root_position[:, 2], 2) * fps**2
    middle = flight[:-2] & flight[1:-1] & flight[2:]
    assert abs(np.median(fall[middle]) + 9.81) < 0.2
    assert abs(np.ptp(pose.root_position[:, 0]) - 2.0 * 799 / fps) < 0.01


def test_falls_end_lying_still_on_the_floor(figure: Figure) -> None:
    body = build_body(figure, cell_m=0.03)
    for direction in ("back", "front", "left", "right"):
        pose = MOTIONS["fall"](
            figure,
            150,
            30.0,
            position=(0.3, 0.1),
            heading_rad=0.4,
            direction=direction,
            rng=np.random.default_rng(4),
        )
        position, rotation = _joints(figure, pose)
        points = landmarks_of(figure, position, rotation)
        assert points[0, LANDMARKS.index("head"), 2] > 1.5
        assert points[-15:, :, 2].max() < 0.50  # lying on the side the upper shoulder is the highest
        assert np.abs(np.diff(points[-15:], axis=0)).max() * 30 < 0.08  # breathes and looks about
        assert not pose.contact[-1].any()
        trunk = points[-1, LANDMARKS.index("neck")] - points[-1, LANDMARKS.index("pelvis")]
        assert abs(trunk[2]) < 0.35 * np.linalg.norm(trunk)
        for frame in range(0, 150, 5):
            lowest = body.pose(position[frame], rotation[frame])[0][:, 2].min()
            assert FLOOR_M < lowest < 0.01  # on the floor, never through it, never above it
        # No faster than falling bodies: from 0.9 m 4.2 m/s.
        assert np.abs(np.diff(points[..., 2], axis=0)).max() * 30 < 4.5
    with pytest.raises(ValueError, match="direction"):
        MOTIONS["fall"](
            figure, 9, 30.0, position=(0, 0), heading_rad=0, direction="up", rng=np.random.default_rng(1)
        )


def test_sitting_is_on_the_seat(figure: Figure) -> None:
    at, heading, height = (0.4, -0.2), 1.1, 0.43
    pose = MOTIONS["sit"](
        figure,
        240,
        30.0,
        position=at,
        heading_rad=heading,
        seat_height_m=height,
        rng=np.random.default_rng(2),
    )
    low = np.flatnonzero(pose.root_position[:, 2] < pose.root_position[:, 2].min() + 0.005)
    assert len(low) > 20
    assert np.linalg.norm(pose.root_position[low, :2] - at, axis=1).max() < 0.05
    body = build_body(figure, cell_m=0.03)
    position, rotation = _joints(figure, pose)
    vertices, _ = body.pose(position[low[10]], rotation[low[10]])
    over = np.linalg.norm(vertices[:, :2] - at, axis=1) < 0.12
    assert abs(vertices[over, 2].min() - height) < 0.03
    # Calves and heels stay before the edge of a seat of 0.4 m.
    forward = np.array([np.cos(heading), np.sin(heading)])
    shin = vertices[:, 2] < height - 0.12
    assert ((vertices[shin, :2] - at) @ forward).min() > 0.2
    assert pose.root_position[:, 2].max() > 0.9 * figure.standing_height_m
    with pytest.raises(ValueError, match="seat_height_m"):
        MOTIONS["sit"](
            figure, 9, 30.0, position=at, heading_rad=0.0, seat_height_m=0.8, rng=np.random.default_rng(1)
        )


def test_route_passes_pauses_and_sits_where_it_is_told(figure: Figure) -> None:
    seat = Stop((-0.8, 1.0), 1.5, -1.2, 0.45)
    stops = (Stop((-1.5, -1.0)), Stop((1.2, -0.9)), Stop((1.0, 0.9), 1.0, 2.4), seat, Stop((-1.5, -1.0)))
    fps = 30.0
    pose = MOTIONS["route"](
        figure, 900, fps, stops=stops, speed_m_s=1.1, start_s=0.5, rng=np.random.default_rng(3)
    )
    root = pose.root_position
    before = np.array(place_before(figure, seat.at, -1.2))
    assert np.linalg.norm(root[0, :2] - stops[0].at) < 0.05
    assert np.linalg.norm(root[:, :2] - stops[1].at, axis=1).min() < 0.25  # corners are cut
    assert np.linalg.norm(root[:, :2] - before, axis=1).min() < 0.05
    assert np.linalg.norm(root[-1, :2] - stops[-1].at) < 0.05
    speed = np.linalg.norm(np.diff(root[:, :2], axis=0), axis=1) * fps
    assert speed[:10].max() < 0.1
    assert 0.9 < np.percentile(speed[(speed > 0.8)], 50) < 1.35
    heading = np.arctan2(pose.rotations[:, 0, 1, 0], pose.rotations[:, 0, 0, 0])
    here = np.linalg.norm(root[:, :2] - stops[2].at, axis=1) < 0.06
    looking = here & (np.abs(np.angle(np.exp(1j * (heading - 2.4)))) < 0.15)
    assert looking.sum() / fps > 0.9
    seated = root[:, 2] < root[:, 2].min() + 0.01
    assert 1.0 < seated.sum() / fps < 4.0
    assert np.linalg.norm(root[seated, :2] - seat.at, axis=1).max() < 0.05


def test_route_may_begin_seated_or_on_its_way(figure: Figure) -> None:
    seat = Stop((0.0, 0.0), 0.0, 0.5, 0.45)
    rng = np.random.default_rng
    pose = MOTIONS["route"](
        figure, 120, 30.0, stops=(seat, Stop((1.5, 0.5))), speed_m_s=1.0, start_s=1.0, rng=rng(1)
    )
    assert pose.root_position[0, 2] < 0.65
    assert pose.root_position[-1, 2] > 0.8
    stops = (Stop((-2.0, 0.0)), Stop((2.0, 0.0)))
    late = MOTIONS["route"](figure, 60, 30.0, stops=stops, speed_m_s=1.0, start_s=-2.0, rng=rng(1))
    assert late.root_position[0, 0] > -1.5
    ever = MOTIONS["route"](figure, 600, 30.0, stops=stops, speed_m_s=1.3, repeat=True, rng=rng(1))
    there = np.sign(ever.root_position[:, 0])
    assert (np.diff(there) != 0).sum() >= 3
    last = MOTIONS["route"](figure, 300, 30.0, stops=(Stop((-1.0, 0.0)), seat), speed_m_s=1.0, rng=rng(1))
    assert last.root_position[-1, 2] < 0.65
    with pytest.raises(ValueError, match="at least one stop"):
        MOTIONS["route"](figure, 9, 30.0, stops=(), speed_m_s=1.0, rng=rng(1))
    with pytest.raises(ValueError, match="heading_rad"):
        Stop((0.0, 0.0), seat_height_m=0.4)


def test_two_throwers_play_in_turn(figure: Figure) -> None:
    """The release is when the throwing hand is fastest."""
    fps = 50.0
    moments = []
    for is_second in (False, True):
        pose = MOTIONS["throw"](
            figure,
            600,
            fps,
            position=(0, 0),
            heading_rad=0,
            is_second=is_second,
            rng=np.random.default_rng(5),
        )
        wrists = _joints(figure, pose)[0][:, [JOINT["left_wrist"], JOINT["right_wrist"]]]
        speed = np.linalg.norm(np.diff(wrists, axis=0), axis=2).max(axis=1) * fps
        assert 3.0 < speed.max() < 15.0
        moments.append(float(np.argmax(speed[: int(PERIOD_S * fps)]) / fps))
    apart = (moments[1] - moments[0]) % PERIOD_S
    assert abs(apart - PERIOD_S / 2) < 0.15


def test_a_step_needs_the_foot_on_the_floor(figure: Figure) -> None:
    plan = Footsteps(figure, (0.0, 0.0), 0.0)
    plan.stand(0, 1.0, 1.5, (0.3, 0.0), 0.0)
    with pytest.raises(ValueError, match="lift"):
        plan.stand(0, 1.4, 1.9, (0.6, 0.0), 0.0)


def test_anatomical_angles_go_into_rotations_and_back() -> None:
    rng = np.random.default_rng(6)
    n = 7
    given: dict[str, Array] = {}
    for angle, (lower, upper) in RANGES_DEG.items():
        if "shoulder" in angle or angle.endswith("_other"):
            continue
        is_middle = angle.split("_")[0] in ("spine", "chest", "neck", "head")
        for side in ("",) if is_middle else ("left_", "right_"):
            given[side + angle] = rng.uniform(0.9 * lower, 0.9 * upper, n)
    found = joint_angles(pose_of(given, n))
    for angle, degrees in given.items():
        assert np.allclose(found[angle], degrees, atol=1e-6), angle
    raised = joint_angles(pose_of({"left_shoulder_abduction": 120.0, "right_shoulder_flexion": 75.0}, 2))
    assert np.allclose(raised["left_shoulder_elevation"], 120)
    assert np.allclose(raised["right_shoulder_elevation"], 75)
    with pytest.raises(ValueError, match="unknown angle"):
        pose_of({"left_tail_flexion": 3.0}, 1)


def test_positive_angles_mean_what_they_say(figure: Figure) -> None:
    """Flexion forward, abduction outward, left is left: seen in where the joints go."""

    def joint(angles: dict[str, float], which: str) -> Array:
        rotations = pose_of(angles, 1)
        return forward_kinematics(figure.offsets, rotations, np.zeros((1, 3)))[0][0, JOINT[which]]

    for side, sign in (("left", 1.0), ("right", -1.0)):
        assert joint({f"{side}_hip_flexion": 60}, f"{side}_knee")[0] > 0.2
        assert sign * joint({f"{side}_hip_abduction": 30}, f"{side}_knee")[1] > 0.2
        assert joint({f"{side}_knee_flexion": 60}, f"{side}_ankle")[0] < -0.2
        assert joint({f"{side}_elbow_flexion": 60}, f"{side}_wrist")[0] > 0.1
        assert sign * joint({f"{side}_shoulder_abduction": 60}, f"{side}_elbow")[1] > 0.3
        assert joint({f"{side}_shoulder_flexion": 60}, f"{side}_elbow")[0] > 0.2
        assert joint({f"{side}_ankle_flexion": 20}, f"{side}_toe")[2] > joint({}, f"{side}_toe")[2]
    assert joint({"spine_flexion": 30}, "head")[0] > 0.1
    assert joint({"spine_side": 20}, "head")[1] > 0.1


def test_other_seeds_give_other_variations(name: str) -> None:
    if name == "fall":
        return  # builds a mesh each time; the draws are those of the others
    figure, _ = _example(name, 0)
    a, again, b = (_perform(figure, name, np.random.default_rng(seed), 40) for seed in (2, 2, 3))
    assert np.array_equal(a.rotations, again.rotations)
    assert np.abs(a.rotations - b.rotations).max() > 0.01


def test_path_runs_at_constant_speed_and_heads_along_itself() -> None:
    path = Path((0.3, 0.1), (1.4, 0.8), 0.5, True)
    s = np.linspace(0, 9, 400)
    point, heading = path.at(s)
    step = np.diff(point, axis=0)
    assert np.allclose(np.linalg.norm(step, axis=1), s[1], rtol=2e-3)
    middle = 0.5 * (heading[1:] + heading[:-1])
    assert np.allclose(step / s[1], np.column_stack([np.cos(middle), np.sin(middle)]), atol=5e-3)


def test_two_bones_reach_their_target() -> None:
    rng = np.random.default_rng(4)
    root, pole = rng.normal(size=(17, 3)), rng.normal(size=(17, 3))
    direction = rng.normal(size=(17, 3))
    target = root + direction / np.linalg.norm(direction, axis=1, keepdims=True) * rng.uniform(
        0.2, 0.65, (17, 1)
    )
    for hinge in (1.0, -1.0):
        first, second = solve_two_bones(root, target, 0.4, 0.3, pole, hinge=hinge)
        assert np.allclose(root - 0.4 * first[:, :, 2] - 0.3 * second[:, :, 2], target)
        bend = Rotation.from_matrix(first.swapaxes(1, 2) @ second).as_rotvec()
        assert np.all(hinge * bend[:, 1] > 0)
        elbow = root - 0.4 * first[:, :, 2] - 0.5 * (root + target)
        assert np.all(np.sum(elbow * pole, axis=1) > -1e-9) or hinge < 0


def test_blending_rotations_goes_the_short_way() -> None:
    a = Rotation.random(5, random_state=1).as_matrix()
    b = a @ Rotation.from_rotvec([0.0, 0.8, 0.0]).as_matrix()
    assert np.allclose(blend_rotations(a, b, np.zeros(5)), a)
    assert np.allclose(blend_rotations(a, b, np.ones(5)), b)
    half = a @ Rotation.from_rotvec([0.0, 0.4, 0.0]).as_matrix()
    assert np.allclose(blend_rotations(a, b, np.full(5, 0.5)), half)

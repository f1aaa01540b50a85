"""The anatomical skeleton: joints, segment lengths from published anthropometry, forward kinematics.

Body frame: x forward, y left, z up; "left" is the subject's left. All joint frames are parallel to the body
frame in the neutral pose: upright, arms hanging, palms to the thighs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mocap.data import FURTHER_LANDMARKS, LANDMARKS, Skeleton

Array = NDArray[np.float64]

JOINTS: tuple[str, ...] = (
    "pelvis",
    "spine",
    "chest",
    "neck",
    "head",
    "left_clavicle",
    "left_shoulder",
    "left_elbow",
    "left_wrist",
    "right_clavicle",
    "right_shoulder",
    "right_elbow",
    "right_wrist",
    "left_hip",
    "left_knee",
    "left_ankle",
    "left_toe",
    "right_hip",
    "right_knee",
    "right_ankle",
    "right_toe",
)
JOINT: dict[str, int] = {name: i for i, name in enumerate(JOINTS)}
PARENTS: NDArray[np.int64] = np.array(
    [-1, 0, 1, 2, 3, 2, 5, 6, 7, 2, 9, 10, 11, 0, 13, 14, 15, 0, 17, 18, 19], dtype=np.int64
)
SIDES: tuple[tuple[str, float], ...] = (("left", 1.0), ("right", -1.0))
SOLE_M = 0.018  # shoe sole under the bare foot
HEEL_BACK = 0.038  # from the ankle back to where the heel strikes, of the stature
HAIR = (
    "usual",
    "short",
    "gathered",
    "long",
    "bun",
    "afro",
    "bald",
)  # usual: short for men, gathered for women
CLOTHES = ("fitted", "loose", "skirt")
ADULT_M, CHILD_M = (1.2, 2.2), (0.95, 1.6)  # statures that are accepted


@dataclass(frozen=True)
class TurningCentres:
    """Where segments of skinned people turn inside flesh that the tables of lengths and breadths place; of the stature.

    hip_half : half the distance of the hips.  hip_back : how far the hips lie behind those of the tables.
    shoulder_down : how far the shoulders lie below those of the tables.  neck_up : the base of the neck above it.
    """

    hip_half: float
    hip_back: float
    shoulder_down: float
    neck_up: float


# Means of 100 men and 100 women, MakeHuman shapes (`python -m eval.joint_centres`). How far back the hips lie is the
# mean of what the section through the hips and the trunk above them say. Children stand between the two.
TURNING_CENTRES: Mapping[str, TurningCentres] = {
    "male": TurningCentres(0.0655, 0.0213, 0.0178, 0.0098),
    "female": TurningCentres(0.0605, 0.0163, 0.0121, 0.0104),
    "child": TurningCentres(0.0630, 0.0188, 0.0150, 0.0101),
}
# Standard deviations between persons of the same sex: of half the hips' distance, shoulders and necks as measured, of
# the hips' depth what the two ways of telling it differ by.
TURNING_SPREAD = TurningCentres(0.0018, 0.0040, 0.0024, 0.0036)


@dataclass(frozen=True, eq=False)
class Figure:
    """Joint layout of one person.

    offsets : (J, 3) m, joint origin in the parent's frame, neutral pose.  stature_m : barefoot height.
    girth : (J,) relative thickness of the segment that starts at each joint (1 = average).
    surface : (J, 3) m, the point of the flesh that the tables call the joint, in the joint's frame; 0 = it turns there.
    head_top : (3,) m, top of the head in the head's frame (on the surface once the body is built).
    is_child : with the proportions of a child.  hair : one of HAIR.  clothes : one of CLOTHES.
    ankle_m : height of the ankle over the floor of bodies from elsewhere, None = of our own.
    """

    stature_m: float
    sex: str
    build: float
    offsets: Array
    girth: Array
    head_top: Array
    is_child: bool = False
    hair: str = "usual"
    clothes: str = "fitted"
    ankle_m: float | None = None
    surface: Array = field(default_factory=lambda: np.zeros((len(JOINTS), 3)))

    @property
    def ankle_height_m(self) -> float:
        """Height of the ankle joint over the floor when the shoe stands flat."""
        return 0.039 * self.stature_m + SOLE_M if self.ankle_m is None else self.ankle_m

    @property
    def thigh_m(self) -> float:
        return float(np.linalg.norm(self.offsets[JOINT["left_knee"]]))

    @property
    def shank_m(self) -> float:
        return float(np.linalg.norm(self.offsets[JOINT["left_ankle"]]))

    @property
    def upper_arm_m(self) -> float:
        return float(np.linalg.norm(self.offsets[JOINT["left_elbow"]]))

    @property
    def forearm_m(self) -> float:
        return float(np.linalg.norm(self.offsets[JOINT["left_wrist"]]))

    @property
    def standing_height_m(self) -> float:
        """Height of the pelvis over the floor in the neutral pose."""
        return self.thigh_m + self.shank_m + self.ankle_height_m


def check_person(stature_m: float, sex: str, build: float, is_child: bool) -> None:
    """Raises ValueError for an unknown sex or numbers out of range."""
    if sex not in ("male", "female"):
        raise ValueError(f"sex must be 'male' or 'female', got {sex!r}")
    lowest, highest = CHILD_M if is_child else ADULT_M
    if not lowest <= stature_m <= highest:
        raise ValueError(f"stature_m must lie in {lowest} .. {highest}, got {stature_m}")
    if not 0.7 <= build <= 1.5:
        raise ValueError(f"build must lie in 0.7 .. 1.5, got {build}")


_USUAL_VARIATION = 0.02


def make_figure(
    stature_m: float,
    sex: str,
    build: float,
    *,
    rng: np.random.Generator,
    variation: float = _USUAL_VARIATION,
    is_child: bool = False,
    hair: str = "usual",
    clothes: str = "fitted",
) -> Figure:
    """Skeleton of a person.

    stature_m : barefoot height, 1.2 .. 2.2, of a child 0.95 .. 1.6.  sex : "male" or "female".
    build : thickness, 1 = average, 0.85 slim, 1.2 stout.
    is_child : larger head, shorter legs and arms, the more the smaller (about 4 years at 1.0 m, 12 at 1.5 m).
    hair, clothes : one of HAIR, one of CLOTHES.
    Segment lengths vary by the relative standard deviation `variation`; left and right are equal and the
    stature is kept. Hips, shoulders and neck turn where those of skinned people do (`TURNING_CENTRES`), which varies by
    `TURNING_SPREAD` at the usual variation; the flesh stays where the tables have it. Raises ValueError for an
    unknown word or numbers out of range.
    Source: segment lengths as fractions of stature, Drillis and Contini 1966 as printed in Winter,
    Biomechanics and Motor Control of Human Movement, Fig. 4.1; joint-centre breadths from Dreyfuss,
    The Measure of Man (bi-iliac and biacromial breadth less the soft tissue). Children: rounded after Snyder et
    al., Anthropometry of Infants, Children, and Youths to Age 18, 1977.
    """
    check_person(stature_m, sex, build, is_child)
    for name, value, known in (("hair", hair, HAIR), ("clothes", clothes, CLOTHES)):
        if value not in known:
            raise ValueError(f"{name} must be one of {', '.join(known)}, got {value!r}")
    vary = 1.0 + variation * np.clip(rng.standard_normal(12), -2, 2)
    is_male = sex == "male"
    young = float(np.clip((1.6 - stature_m) / 0.6, 0.0, 1.1)) if is_child else 0.0  # 1 at 1.0 m
    ankle, knee = 0.039 + 0.004 * young, 0.285 - 0.020 * young
    hip, neck = 0.530 - 0.058 * young, 0.845 - 0.045 * young
    leg = (hip - ankle) * (1 + 0.4 * (vary[0] - 1))
    shank = (knee - ankle) / (hip - ankle) * leg * (1 + 0.5 * (vary[1] - 1))
    thigh = leg - shank
    trunk = (neck - hip) * (1 + 0.5 * (vary[2] - 1))
    skull = 1.0 - ankle - leg - trunk  # what is left, so that the stature holds
    upper_arm, forearm = (0.186 - 0.008 * young) * vary[3], (0.146 - 0.008 * young) * vary[4]
    shoulder = (0.099 if is_child else 0.105 if is_male else 0.097) * vary[5]
    hip_half = (0.0480 if is_male or is_child else 0.0515) * vary[6]
    ball = 0.068 * vary[7]
    turns = _turning_centres("child" if is_child else sex, (vary[8:] - 1.0) / _USUAL_VARIATION)
    spine, chest = 0.17 * trunk, 0.48 * trunk
    offsets, surface = np.zeros((2, len(JOINTS), 3))

    def put(name: str, x: float, y: float, z: float) -> None:
        offsets[JOINT[name]] = np.array([x, y, z]) * stature_m

    def flesh(name: str, x: float, y: float, z: float) -> None:
        surface[JOINT[name]] = np.array([x, y, z]) * stature_m

    # The pelvis is the middle of the hips.
    put("spine", turns.hip_back - 0.010, 0, spine)
    put("chest", -0.002, 0, chest - spine)
    put("neck", 0.002, 0, trunk - chest + turns.neck_up)
    put("head", 0.012, 0, 0.29 * skull - turns.neck_up)
    flesh("pelvis", turns.hip_back, 0, 0)
    flesh("neck", 0, 0, -turns.neck_up)
    for side, sign in SIDES:
        put(f"{side}_clavicle", 0.012, sign * 0.016, trunk - chest - 0.022)
        put(f"{side}_shoulder", -0.012, sign * (shoulder - 0.016), -0.008 - turns.shoulder_down)
        put(f"{side}_elbow", 0, 0, turns.shoulder_down - upper_arm)
        put(f"{side}_wrist", 0, 0, -forearm)
        put(f"{side}_hip", 0, sign * turns.hip_half, 0)
        flesh(f"{side}_shoulder", 0, 0, turns.shoulder_down)
        flesh(f"{side}_hip", turns.hip_back, sign * (hip_half - turns.hip_half), 0)
        put(f"{side}_knee", 0, 0, -thigh)
        put(f"{side}_ankle", 0, 0, -shank)
        put(f"{side}_toe", ball, 0, -0.75 * ankle)
    girth = np.full(len(JOINTS), build)
    for name in ("head", "neck"):
        girth[JOINT[name]] = build**0.3
    for name in ("wrist", "ankle", "toe"):
        for side, _ in SIDES:
            girth[JOINT[f"{side}_{name}"]] = build**0.25
    head_top = np.array([-0.005, 0.0, 0.71 * skull]) * stature_m
    return Figure(stature_m, sex, build, offsets, girth, head_top, is_child, hair, clothes, surface=surface)


def _turning_centres(kind: str, draws: Array) -> TurningCentres:
    """Of one person.  kind : of TURNING_CENTRES.  draws : (4,) standard deviations off the mean."""
    usual, spread = TURNING_CENTRES[kind], TURNING_SPREAD
    return TurningCentres(
        usual.hip_half + spread.hip_half * draws[0],
        usual.hip_back + spread.hip_back * draws[1],
        usual.shoulder_down + spread.shoulder_down * draws[2],
        usual.neck_up + spread.neck_up * draws[3],
    )


def forward_kinematics(offsets: Array, rotations: Array, root_position: Array) -> tuple[Array, Array]:
    """World positions (T, J, 3) m and rotations (T, J, 3, 3) of all joints.

    offsets : (J, 3) m.  rotations : (T, J, 3, 3) local.  root_position : (T, 3) m, world.
    """
    T, J = rotations.shape[:2]
    position = np.zeros((T, J, 3))
    rotation = np.zeros((T, J, 3, 3))
    position[:, 0] = root_position
    rotation[:, 0] = rotations[:, 0]
    for j in range(1, J):
        p = PARENTS[j]
        position[:, j] = position[:, p] + rotation[:, p] @ offsets[j]
        rotation[:, j] = rotation[:, p] @ rotations[:, j]
    return position, rotation


def landmarks_of(figure: Figure, position: Array, rotation: Array) -> Array:
    """The 15 landmarks in the order of LANDMARKS, (T, 15, 3) m, from forward kinematics of the same figure."""
    out = np.zeros((len(position), len(LANDMARKS), 3))
    for i, name in enumerate(LANDMARKS):
        if name == "head":
            out[:, i] = position[:, JOINT["head"]] + rotation[:, JOINT["head"]] @ figure.head_top
        else:
            out[:, i] = position[:, JOINT[name]]
    return out


def feet_and_hands_of(figure: Figure, position: Array, rotation: Array) -> Array:
    """Heels, toes and hand tips in the order of FURTHER_LANDMARKS, (T, 6, 3) m: heel and toe on the sole of the shoe.

    The heel is where the foot lands and rolls, the toe lies under the tip of the foot. Source: Winter, as for the
    figure: the foot is .152 of the stature long, the ankle stands .038 before its heel; the hand is .108 long.
    """
    h, sole = figure.stature_m, -figure.ankle_height_m
    out = np.zeros((len(position), len(FURTHER_LANDMARKS), 3))
    for i, name in enumerate(FURTHER_LANDMARKS):
        side, _, kind = name.partition("_")
        ball = figure.offsets[JOINT[f"{side}_toe"]]
        joint, offset = {
            "heel": ("ankle", np.array([-HEEL_BACK * h, 0.0, sole])),
            "toe": ("toe", np.array([0.114 * h - ball[0], 0.0, sole - ball[2]])),
            "hand_tip": ("wrist", np.array([0.0, 0.0, -0.108 * h])),
        }[kind]
        j = JOINT[f"{side}_{joint}"]
        out[:, i] = position[:, j] + rotation[:, j] @ offset
    return out


def skeleton_of(figure: Figure, rotations: Array, root_position: Array, person: int) -> Skeleton:
    """The same motion as an animation skeleton.  rotations : (T, J, 3, 3), root_position : (T, 3) m."""
    h = figure.stature_m
    ends = {JOINT["head"]: figure.head_top}
    for side, _ in SIDES:
        ends[JOINT[f"{side}_wrist"]] = np.array([0.0, 0.0, -0.108 * h])
        ends[JOINT[f"{side}_toe"]] = np.array([0.045 * h, 0.0, 0.0])
    return Skeleton(person, JOINTS, PARENTS, figure.offsets, ends, rotations, root_position)


def rotation_about(axis: int, angle: Array | float) -> Array:
    """Rotation matrices (..., 3, 3) about the x (0), y (1) or z (2) axis by angle (...,) rad."""
    a = np.asarray(angle, dtype=np.float64)
    c, s = np.cos(a), np.sin(a)
    out = np.zeros((*a.shape, 3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out[..., axis, axis] = 1.0
    out[..., i, i] = c
    out[..., j, j] = c
    out[..., i, j] = -s
    out[..., j, i] = s
    return out

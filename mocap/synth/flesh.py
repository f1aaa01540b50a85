"""The flesh of a person as blended primitives over the skeleton, and what is worn over it.

Lengths below are fractions of stature. Source of breadths, depths and girths: Dreyfuss, The Measure of Man; the shapes
between them are our own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from mocap.synth.figure import JOINT, JOINTS, SIDES, SOLE_M, Figure, rotation_about

Array = NDArray[np.float64]

HIPS = len(JOINTS)  # a bone of loose clothes: the hip of the own side


@dataclass(frozen=True, eq=False)
class Part:
    """One blended primitive: an axis (local z) with elliptic sections, closed by ellipsoidal caps.

    z : (n,) m ascending.  half_x, half_y, center_x, center_y : (n,) m.  caps : lengths of the two caps, m.
    power : exponent of the superellipse.  bones, cuts, widths : the bones in the order of rising z; bone i
    hands over to bone i + 1 at cuts[i] within +- widths[i].  floor_z : nothing below this local z.
    halves : where positive, the bone HIPS means the left hip on the left (y > 0) and the right hip on the right, and
    they share a middle strip of this half width, m.  layer : "flesh", "hair" or "cloth".
    """

    origin: Array
    R: Array
    z: Array
    half_x: Array
    half_y: Array
    center_x: Array
    center_y: Array
    caps: tuple[float, float]
    bones: tuple[int, ...]
    cuts: tuple[float, ...] = ()
    widths: tuple[float, ...] = ()
    power: float = 2.0
    floor_z: float | None = None
    halves: float = 0.0
    layer: str = "flesh"

    def distance(self, points: Array) -> Array:
        """Approximate signed distance, (N,) m, negative inside."""
        local = (points - self.origin) @ self.R
        z = np.clip(local[:, 2], self.z[0], self.z[-1])
        over = local[:, 2] - z
        x = local[:, 0] - np.interp(z, self.z, self.center_x)
        y = local[:, 1] - np.interp(z, self.z, self.center_y)
        cap = np.where(over < 0, self.caps[0], self.caps[1])
        a, b = np.interp(z, self.z, self.half_x), np.interp(z, self.z, self.half_y)
        p = self.power
        k = (np.abs(x / a) ** p + np.abs(y / b) ** p + np.abs(over / cap) ** p) ** (1 / p)
        length = np.sqrt(x * x + y * y + over * over)
        small = np.minimum(np.minimum(a, b), np.where(over == 0, np.inf, cap))
        # Along the ray from the axis the surface is at length / k; on the axis itself the nearest wall counts.
        d = np.where(k > 0.3, length * (1 - 1 / np.maximum(k, 0.3)), (k - 1) * small)
        if self.floor_z is not None:
            d = np.maximum(d, self.floor_z - local[:, 2])
        return d

    def box(self) -> tuple[Array, Array]:
        """Corners of the axis-aligned box in model space that holds the part."""
        side = np.array([np.abs(self.center_x) + self.half_x, np.abs(self.center_y) + self.half_y]).max(
            axis=1
        )
        low = np.array([-side[0], -side[1], self.z[0] - self.caps[0]])
        high = np.array([side[0], side[1], self.z[-1] + self.caps[1]])
        corners = np.array([[(low, high)[i >> k & 1][k] for k in range(3)] for i in range(8)])
        world = corners @ self.R.T + self.origin
        return world.min(axis=0), world.max(axis=0)

    def bone_weights(self, points: Array) -> Array:
        """Weights of all joints for points of this part, (N, J), rows sum to 1."""
        local = (points - self.origin) @ self.R
        z = local[:, 2]
        out = np.zeros((len(points), len(JOINTS) + 1))  # the last column is HIPS
        rest = np.ones(len(points))
        for i, cut in enumerate(self.cuts):
            s = np.clip((z - cut) / (2 * self.widths[i]) + 0.5, 0, 1)
            s = s * s * (3 - 2 * s)
            out[:, self.bones[i]] += rest * (1 - s)
            rest = rest * s
        out[:, self.bones[-1]] += rest
        if self.halves > 0:
            s = np.clip(local[:, 1] / (2 * self.halves) + 0.5, 0, 1)
            s = s * s * (3 - 2 * s)
            out[:, JOINT["left_hip"]] += s * out[:, HIPS]
            out[:, JOINT["right_hip"]] += (1 - s) * out[:, HIPS]
        return out[:, : len(JOINTS)]


class _Modeller:
    """Collects the primitives of one figure; lengths come in fractions of its stature."""

    def __init__(self, figure: Figure, position: Array, rotation: Array) -> None:
        self.figure = figure
        self.H = figure.stature_m
        self.is_male = figure.sex == "male"
        self.build = figure.build
        self.offset = figure.offsets / self.H
        self.surface = figure.surface / self.H
        self.parts: list[Part] = []
        self._position, self._rotation = position, rotation

    def add(
        self,
        joint: str,
        profile: Sequence[tuple[float, ...]],
        caps: tuple[float, float],
        bones: tuple[str, ...],
        cuts: tuple[float, ...] = (),
        widths: tuple[float, ...] = (),
        *,
        at: tuple[float, float, float] = (0.0, 0.0, 0.0),
        power: float = 2.0,
        tilt: Array | None = None,
        floor_z: float | None = None,
        girth: float = 1.0,
        halves: float = 0.0,
        layer: str = "flesh",
        fades: float | None = None,
    ) -> None:
        """One primitive along the z axis of a joint's frame; rows of the profile: z, half_x, half_y[, x[, y]].

        Where the joint does not lie in the axis of its flesh (`Figure.surface`), the primitive does; with `fades` only
        at its top, and this far below the joint the axis goes through the joints again.
        """
        H = self.H
        rows = np.array([[*row, *([0.0] * (5 - len(row)))] for row in sorted(profile)]) * H
        rows[:, 1:3] *= girth
        if len(rows) > 2:
            dense = np.linspace(rows[0, 0], rows[-1, 0], 48)
            rows = np.column_stack([dense, PchipInterpolator(rows[:, 0], rows[:, 1:])(dense)])
        j = JOINT[joint]
        shift = self.surface[j] * H
        if fades is not None:
            rows[:, 3:] += np.clip(1.0 + rows[:, :1] / (fades * H), 0.0, 1.0) * shift[:2]
            shift = np.zeros(3)
        R = self._rotation[j] if tilt is None else self._rotation[j] @ tilt
        self.parts.append(
            Part(
                self._position[j] + self._rotation[j] @ (np.array(at) * H + shift),
                R,
                rows[:, 0],
                rows[:, 1],
                rows[:, 2],
                rows[:, 3],
                rows[:, 4],
                (caps[0] * H, caps[1] * H),
                tuple(HIPS if b == "hips" else JOINT[b] for b in bones),
                tuple(c * H for c in cuts),
                tuple(w * H for w in widths),
                power,
                floor_z,
                halves * H,
                layer,
            )
        )

    def ball(
        self,
        joint: str,
        at: tuple[float, float, float],
        radii: tuple[float, float, float],
        bones: tuple[str, ...],
        cuts: tuple[float, ...] = (),
        widths: tuple[float, ...] = (),
        *,
        layer: str = "flesh",
    ) -> None:
        """An ellipsoid."""
        profile = [(0.0, radii[0], radii[1])]
        self.add(joint, profile, (radii[2], radii[2]), bones, cuts, widths, at=at, layer=layer)


def flesh_of(figure: Figure, position: Array, rotation: Array) -> list[Part]:
    """All primitives of a body in model space; the trunk comes first.

    position : (J, 3) m, rotation : (J, 3, 3), joints of the modelling pose.
    """
    m = _Modeller(figure, position, rotation)
    _trunk(m)
    _head(m)
    for side, sign in SIDES:
        _arm(m, side, sign)
        _leg(m, side, sign)
    _clothes(m)
    return m.parts


def _trunk(m: _Modeller) -> None:
    offset, build, is_male = m.offset, m.build, m.is_male
    spine_z = offset[JOINT["spine"], 2]
    chest_z = spine_z + offset[JOINT["chest"], 2]
    neck_z = chest_z + offset[JOINT["neck"], 2] + m.surface[JOINT["neck"], 2]
    trunk = neck_z / 0.315  # relative trunk length
    shoulder_y = abs(offset[JOINT["left_clavicle"], 1] + offset[JOINT["left_shoulder"], 1])
    wide = shoulder_y / 0.105
    torso = ("pelvis", "spine", "chest")
    torso_cuts = (0.85 * spine_z, chest_z)
    torso_widths = (0.030, 0.036)
    # z, half depth (x), half breadth (y), centre x
    if m.figure.is_child:
        rows = [
            (-0.050, 0.046, 0.060, -0.004),
            (0.000, 0.058, 0.093, -0.006),
            (0.045, 0.059, 0.089, -0.002),
            (0.095, 0.060, 0.084, 0.004),
            (0.150, 0.058, 0.083 * wide, 0.003),
            (0.205, 0.057, 0.090 * wide, 0.001),
            (0.250, 0.050, 0.088 * wide, -0.005),
            (0.275, 0.042, 0.081 * wide, -0.009),
            (0.300, 0.030, 0.046, -0.012),
        ]
    elif is_male:
        rows = [
            (-0.050, 0.046, 0.058, -0.004),
            (0.000, 0.058, 0.092, -0.006),
            (0.045, 0.057, 0.090, -0.004),
            (0.090, 0.054, 0.081, 0.002),
            (0.150, 0.058, 0.085 * wide, 0.004),
            (0.205, 0.062, 0.094 * wide, 0.003),
            (0.250, 0.054, 0.092 * wide, -0.004),
            (0.275, 0.044, 0.086 * wide, -0.009),
            (0.300, 0.032, 0.050, -0.012),
        ]
    else:
        rows = [
            (-0.050, 0.048, 0.064, -0.004),
            (0.000, 0.060, 0.102, -0.006),
            (0.045, 0.055, 0.092, -0.004),
            (0.095, 0.047, 0.071, 0.002),
            (0.150, 0.052, 0.078 * wide, 0.003),
            (0.205, 0.055, 0.089 * wide, 0.000),
            (0.250, 0.048, 0.087 * wide, -0.006),
            (0.275, 0.040, 0.080 * wide, -0.009),
            (0.300, 0.027, 0.042, -0.012),
        ]
    # A stout person is stout in front: the belly moves the section forward and deepens it.
    belly = max(build - 0.95, 0.0)
    stretched = [
        (z * trunk if z > 0 else z, a + 0.05 * belly * bulge, b, c + 0.06 * belly * bulge)
        for z, a, b, c in rows
        for bulge in (float(np.exp(-(((z - 0.085) / 0.06) ** 2))),)
    ]
    m.add("pelvis", stretched, (0.03, 0.02), torso, torso_cuts, torso_widths, power=2.35, girth=build)
    for side, sign in SIDES:
        m.ball(
            "pelvis",
            (-0.036, sign * 0.045, -0.016),
            (0.040 * build, 0.044 * build, 0.048),
            ("pelvis",),
        )
        if m.figure.is_child:
            pass
        elif is_male:
            m.ball("pelvis", (0.030, sign * 0.043, 0.222 * trunk), (0.028, 0.046, 0.040), ("chest",))
        else:
            m.ball("pelvis", (0.034, sign * 0.041, 0.203 * trunk), (0.034, 0.038, 0.036), ("chest",))
        # Trapezius: a slope from the neck to the shoulder.
        start = np.array([-0.012, sign * 0.014, 0.012])
        end = np.array([-0.014, sign * 0.86 * shoulder_y, -0.027])
        along = (end - start) / np.linalg.norm(end - start)
        x_axis = np.array([1.0, 0, 0]) - along[0] * along
        x_axis /= np.linalg.norm(x_axis)
        frame = np.column_stack([x_axis, np.cross(along, x_axis), along])
        length = float(np.linalg.norm(end - start))
        m.add(
            "neck",
            [(0.0, 0.026, 0.020), (length, 0.030, 0.022)],
            (0.02, 0.02),
            ("chest", f"{side}_clavicle"),
            (0.5 * length,),
            (0.02,),
            at=(float(start[0]), float(start[1]), float(start[2])),
            tilt=frame,
            girth=0.5 + 0.5 * build,
        )


def _head(m: _Modeller) -> None:
    figure, H, build, is_male = m.figure, m.H, m.build, m.is_male
    neck_r = (0.0335 if is_male else 0.0285) * build**0.4
    head_z = m.offset[JOINT["head"], 2] - m.surface[JOINT["neck"], 2]
    m.add(
        "neck",
        [(-0.025, neck_r, neck_r * 1.12, -0.004), (head_z + 0.02, neck_r, neck_r * 0.98, 0.006)],
        (0.02, 0.02),
        ("chest", "neck", "head"),
        (-0.012, 0.9 * head_z),
        (0.018, 0.016),
    )
    scale = (figure.head_top[2] / H) / 0.110
    face = 1.0 if is_male else 0.96
    for at, radii in (
        ((-0.004, 0, 0.058), (0.0560, 0.0430, 0.0500)),  # cranium
        ((0.022, 0, 0.020), (0.0330 * face, 0.0335 * face, 0.0450)),  # face
        ((0.034, 0, -0.010), (0.0170, 0.0200 * face, 0.0140)),  # chin
        ((0.055, 0, 0.028), (0.0075, 0.0065, 0.0130)),  # nose
        ((-0.006, 0.0435, 0.030), (0.0100, 0.0050, 0.0150)),  # ears
        ((-0.006, -0.0435, 0.030), (0.0100, 0.0050, 0.0150)),
    ):
        m.ball(
            "head", (at[0] * scale, at[1] * scale, at[2] * scale), tuple(r * scale for r in radii), ("head",)
        )
    _hair(m, scale)


def _hair(m: _Modeller, scale: float) -> None:
    """Hair with volume; short hair is a colour only."""
    hair = m.figure.hair
    if hair == "usual":
        hair = "short" if m.is_male or m.figure.is_child else "gathered"

    def ball(
        at: tuple[float, float, float], radii: tuple[float, float, float], *, on_neck: bool = False
    ) -> None:
        bones, cuts, widths = (("neck", "head"), (-0.05,), (0.02,)) if on_neck else (("head",), (), ())
        layer = "flesh" if m.figure.hair == "usual" else "hair"
        m.ball("head", _scaled(at, scale), _scaled(radii, scale), bones, cuts, widths, layer=layer)

    if hair == "gathered":
        scale = scale if m.figure.is_child else 1.0
        ball((-0.030, 0, 0.018), (0.036, 0.041, 0.058), on_neck=True)
    elif hair == "long":
        ball((-0.012, 0, 0.058), (0.0575, 0.0480, 0.0530))
        m.add(
            "head",
            [
                (scale * z, scale * x, scale * y, scale * c)
                for z, x, y, c in (
                    (-0.075, 0.020, 0.046, -0.042),
                    (-0.030, 0.026, 0.048, -0.036),
                    (0.040, 0.034, 0.047, -0.026),
                )
            ],
            (0.012 * scale, 0.02 * scale),
            ("neck", "head"),
            (-0.06 * scale,),
            (0.025,),
            layer="hair",
        )
    elif hair == "bun":
        ball((-0.010, 0, 0.059), (0.0550, 0.0445, 0.0510))
        ball((-0.058, 0, 0.074), (0.0230, 0.0240, 0.0220))
    elif hair == "afro":
        ball((-0.012, 0, 0.064), (0.0700, 0.0680, 0.0640))


def _scaled(values: tuple[float, float, float], scale: float) -> tuple[float, float, float]:
    return values[0] * scale, values[1] * scale, values[2] * scale


def _arm(m: _Modeller, side: str, sign: float) -> None:
    offset = m.offset
    arm = m.build**0.8 * (1.0 if m.is_male else 0.88)
    L = m.surface[JOINT[f"{side}_shoulder"], 2] - offset[JOINT[f"{side}_elbow"], 2]
    F = -offset[JOINT[f"{side}_wrist"], 2]
    clavicle, upper, fore, hand = (f"{side}_{n}" for n in ("clavicle", "shoulder", "elbow", "wrist"))
    m.ball(
        upper,
        (-0.002, sign * 0.002, -0.012),
        (0.0330 * arm, 0.0310 * arm, 0.044),
        (upper, clavicle),
        (0.020,),
        (0.030,),
    )
    # The whole arm, and below the whole leg, is one profile: the limbs are straight in the modelling pose.
    m.add(
        upper,
        [
            (0.0, 0.0300, 0.0270),
            (-0.25 * L, 0.0305, 0.0272, 0.001),
            (-0.50 * L, 0.0300, 0.0265, 0.004),
            (-0.80 * L, 0.0255, 0.0240, 0.001),
            (-1.0 * L, 0.0240, 0.0245, -0.002),
            (-L - 0.22 * F, 0.0262, 0.0240, 0.002),
            (-L - 0.50 * F, 0.0222, 0.0202, 0.001),
            (-L - 0.80 * F, 0.0178, 0.0155),
            (-L - 1.0 * F, 0.0172, 0.0128),
        ],
        (0.012, 0.012),
        (hand, fore, upper, clavicle),
        (-L - F, -L, 0.008),
        (0.014, 0.022, 0.030),
        girth=arm,
    )
    m.add(
        hand,
        [
            (0.0, 0.0160, 0.0120),
            (-0.028, 0.0215, 0.0115, 0.002),
            (-0.052, 0.0230, 0.0105, 0.002, -sign * 0.001),
            (-0.078, 0.0195, 0.0085, 0.001, -sign * 0.007),
            (-0.097, 0.0140, 0.0075, 0.000, -sign * 0.016),
        ],
        (0.008, 0.012),
        (hand, fore),
        (0.0,),
        (0.014,),
        power=2.3,
    )
    thumb = rotation_about(1, -np.deg2rad(35)) @ rotation_about(0, -sign * np.deg2rad(12))
    m.add(
        hand,
        [(0.0, 0.0095, 0.0095), (-0.030, 0.0085, 0.0085), (-0.042, 0.0070, 0.0070)],
        (0.008, 0.010),
        (hand,),
        at=(0.012, -sign * 0.004, -0.018),
        tilt=thumb,
    )


def _leg(m: _Modeller, side: str, sign: float) -> None:
    offset, H = m.offset, m.H
    leg = m.build**0.9 * (1.0 if m.is_male else 1.02)
    foot_floor = -(0.039 * H + SOLE_M)
    hip_y = offset[JOINT["left_hip"], 1] + m.surface[JOINT["left_hip"], 1]
    T = -offset[JOINT[f"{side}_knee"], 2]
    S = -offset[JOINT[f"{side}_ankle"], 2]
    hip, knee, ankle, toe = (f"{side}_{n}" for n in ("hip", "knee", "ankle", "toe"))
    inward = (0.048 - hip_y) * sign * 0.4
    m.add(
        hip,
        [
            (0.030, 0.040, 0.036, -0.006),
            (-0.02, 0.0520, 0.0470, -0.004, inward),
            (-0.25 * T, 0.0535, 0.0490, 0.000, inward),
            (-0.50 * T, 0.0495, 0.0450, 0.002),
            (-0.75 * T, 0.0430, 0.0395, 0.000),
            (-1.0 * T, 0.0380, 0.0360, 0.000),
            (-T - 0.10 * S, 0.0365, 0.0345, -0.001),
            (-T - 0.30 * S, 0.0375, 0.0355, -0.007),
            (-T - 0.55 * S, 0.0325, 0.0310, -0.006),
            (-T - 0.80 * S, 0.0270, 0.0260, -0.003),
            (-T - 1.0 * S, 0.0255, 0.0240, -0.001),
        ],
        (0.015, 0.018),
        (ankle, knee, hip, "pelvis"),
        (-T - S, -T, -0.004),
        (0.014, 0.028, 0.042),
        girth=leg,
        fades=T,
    )
    # Shoe: along its own axis (local z = forward), flat below.
    forward = np.column_stack([[0.0, 0, 1], [0.0, 1, 0], [-1.0, 0, 0]])  # local x up, y left, z backwards
    low = foot_floor / H
    shoe = [
        (0.032, 0.0230, 0.0180),
        (0.010, 0.0270, 0.0195),
        (-0.030, 0.0260, 0.0215),
        (-0.066, 0.0180, 0.0275),
        (-0.100, 0.0130, 0.0230),
    ]
    sections = [(z, hx, hy, low + hx, sign * 0.001) for z, hx, hy in shoe]
    m.add(
        ankle,
        sections,
        (0.018, 0.012),
        (toe, ankle),
        (-offset[JOINT[toe], 0],),
        (0.014,),
        tilt=forward,
        power=2.6,
    )
    m.ball(ankle, (0.012, 0, -0.010), (0.030, 0.0215, 0.026), (ankle, knee), (0.012,), (0.014,))


def _clothes(m: _Modeller) -> None:
    """Clothes that hang round the limbs and move with them."""
    if m.figure.clothes == "loose":
        _wide_shirt(m)
        for side, _ in SIDES:
            _wide_sleeve(m, side)
            _wide_trouser(m, side)
    elif m.figure.clothes == "skirt":
        m.add(
            "pelvis",
            [
                (-0.215, 0.090, 0.140, 0.002),
                (-0.100, 0.078, 0.122, 0.000),
                (0.000, 0.068, 0.107, -0.004),
                (0.065, 0.058, 0.084, -0.002),
            ],
            (0.012, 0.012),
            ("hips", "pelvis"),
            (-0.015,),
            (0.055,),
            power=2.2,
            girth=m.build,
            halves=0.055,
            layer="cloth",
        )


def _wide_shirt(m: _Modeller) -> None:
    spine_z = m.offset[JOINT["spine"], 2]
    chest_z = spine_z + m.offset[JOINT["chest"], 2]
    trunk = (chest_z + m.offset[JOINT["neck"], 2] + m.surface[JOINT["neck"], 2]) / 0.315
    wide = abs(m.offset[JOINT["left_clavicle"], 1] + m.offset[JOINT["left_shoulder"], 1]) / 0.105
    m.add(
        "pelvis",
        [
            (-0.080, 0.082, 0.124, 0.000),
            (0.000, 0.077, 0.115, 0.000),
            (0.090 * trunk, 0.071, 0.103, 0.004),
            (0.180 * trunk, 0.071, 0.101 * wide, 0.004),
            (0.245 * trunk, 0.056, 0.092 * wide, -0.003),
        ],
        (0.010, 0.015),
        ("hips", "pelvis", "spine", "chest"),
        (-0.045, 0.85 * spine_z, chest_z),
        (0.045, 0.030, 0.036),
        power=2.3,
        girth=m.build,
        halves=0.05,
        layer="cloth",
    )


def _wide_sleeve(m: _Modeller, side: str) -> None:
    L = m.surface[JOINT[f"{side}_shoulder"], 2] - m.offset[JOINT[f"{side}_elbow"], 2]
    arm = m.build**0.8 * (1.0 if m.is_male else 0.92)
    m.add(
        f"{side}_shoulder",
        [(0.0, 0.036, 0.032), (-0.40 * L, 0.041, 0.037), (-0.82 * L, 0.046, 0.042)],
        (0.008, 0.014),
        (f"{side}_shoulder", f"{side}_clavicle"),
        (0.008,),
        (0.030,),
        girth=arm,
        layer="cloth",
    )


def _wide_trouser(m: _Modeller, side: str) -> None:
    T = -m.offset[JOINT[f"{side}_knee"], 2]
    S = -m.offset[JOINT[f"{side}_ankle"], 2]
    m.add(
        f"{side}_hip",
        [
            (0.0, 0.058, 0.052, -0.002),
            (-0.35 * T, 0.061, 0.055),
            (-T, 0.054, 0.051),
            (-T - 0.45 * S, 0.051, 0.049, -0.003),
            (-T - 0.93 * S, 0.053, 0.047, 0.002),
        ],
        (0.008, 0.016),
        (f"{side}_knee", f"{side}_hip", "pelvis"),
        (-T, -0.004),
        (0.028, 0.042),
        girth=m.build**0.9,
        layer="cloth",
        fades=T,
    )

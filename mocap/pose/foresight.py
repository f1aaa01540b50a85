"""Foresight: how far off the landmarks of somebody will be, from where the cameras stand alone.

A body is put into usual postures at places of the room and turned to all sides. Where the edge of its flesh is the
outline of a camera's silhouette, that camera tells where the edge is across itself; behind or before another part of
the body it tells nothing. The sum of all that, with what a fit knows anyway, is the covariance of the pose: the
first-order design of a network of cameras, with a body instead of points.
Source: Grafarend 1974 (orders of design); Fraser 1984 (design of networks of cameras).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, cones_of, joint_transforms, neutral_state
from mocap.body.kinematics import distance_of_lines, point_jacobian
from mocap.data import Camera, CameraRig
from mocap.pose.deviation import fit_covariance, landmark_kind
from mocap.pose.method import DeviationSettings

Array = NDArray[np.float64]

# Angles beside those of a relaxed standing pose, rad: a stride, hands before the body, an arm raised.
_POSTURES: tuple[Mapping[str, float], ...] = (
    {},
    {"right_hip_y": -0.5, "left_hip_y": 0.35, "left_knee_y": 0.5, "right_elbow_z": 0.5, "left_elbow_z": -0.5},
    {"right_elbow_z": 1.5, "left_elbow_z": -1.5},
    {"right_shoulder_x": -1.0, "right_elbow_z": 0.8},
)
# An edge this far outside the flesh that it belongs to is looked at for other flesh: what touches is no outline.
_OUTSIDE_M = 0.01
# Cones seen nearly along their axis have no edges beside them.
_LEAST_SINE = 0.2
_N_AZIMUTHS = 12  # places of one more camera that are tried


@dataclass(frozen=True)
class ForesightSettings:
    """What an outline is trusted to tell.

    n_headings : the body is turned to, evenly round.  n_along : places along a cone where its edges are looked at.
    edge_std_px : of an outline in a picture.  flesh_std_m : by how much the flesh of somebody differs from the body's
    there, with what neighbouring places have in common.  angle_std_rad : what is known of an angle without any sight,
    from the frames before, limits and usual postures. `python -m eval.few_cameras --fit` chose both.
    """

    n_headings: int = 5
    n_along: int = 3
    edge_std_px: float = 1.0
    flesh_std_m: float = 0.02
    angle_std_rad: float = 0.3


@dataclass(frozen=True, eq=False)
class Foresight:
    """What can be expected at P places.

    places : (P, 2) m on the floor.  names : of M landmarks.  covariance : (P, M, 3, 3) m^2, mean over postures and
    headings.
    """

    places: Array
    names: tuple[str, ...]
    covariance: Array

    @property
    def deviation_m(self) -> Array:
        """(P, M) m, the root of the mean squared distance of each landmark."""
        return np.sqrt(np.trace(self.covariance, axis1=2, axis2=3))

    @property
    def mean_m(self) -> Array:
        """(P,) m, over all landmarks."""
        return np.asarray(np.sqrt((self.deviation_m**2).mean(axis=1)))


def foresee(
    rig: CameraRig,
    body: Body,
    places: Array | Sequence[tuple[float, float]],
    settings: ForesightSettings | None = None,
    deviation: DeviationSettings | None = None,
) -> Foresight:
    """What a rig will tell of a body, which has the person's size, at places (P, 2) m.

    Of sight alone: masks are taken to be right, and nothing stands in the room.
    """
    settings, deviation = settings or ForesightSettings(), deviation or DeviationSettings()
    spots = np.asarray(places, dtype=np.float64).reshape(-1, 2)
    found = []
    for spot in spots:
        states = usual_states(body, spot, settings.n_headings)
        told = [rig_information(rig, body, state, settings) for state in states]
        found.append(_covariance(body, states, told, settings, deviation))
    return Foresight(spots, tuple(body.landmarks), np.array(found))


def next_camera(
    rig: CameraRig,
    body: Body,
    place: tuple[float, float],
    settings: ForesightSettings | None = None,
    deviation: DeviationSettings | None = None,
) -> tuple[Camera, float]:
    """Where one more camera, like the rig's first, would tell most of somebody at a place, (2,) m; and the deviation of
    all landmarks with it, m, as `Foresight.mean_m` has it.

    It is tried on a circle round the place, as far away and as high as the others in the mean.
    """
    settings, deviation = settings or ForesightSettings(), deviation or DeviationSettings()
    spot = np.array(place, dtype=np.float64)
    states = usual_states(body, spot, settings.n_headings)
    told = [rig_information(rig, body, state, settings) for state in states]
    centers = np.array([camera.center for camera in rig])
    away, height = np.linalg.norm(centers[:, :2] - spot, axis=1).mean(), centers[:, 2].mean()
    target = np.append(spot, 0.5 * body.height_m)
    tried = []
    for azimuth in 2.0 * np.pi * np.arange(_N_AZIMUTHS) / _N_AZIMUTHS:
        center = np.append(spot + away * np.array([np.cos(azimuth), np.sin(azimuth)]), height)
        camera = aimed(rig[0], "next", center, target)
        more = [
            own + outline_information(camera, body, state, settings)
            for own, state in zip(told, states, strict=True)
        ]
        square = np.trace(_covariance(body, states, more, settings, deviation), axis1=1, axis2=2).mean()
        tried.append((float(np.sqrt(square)), camera))
    deviation_m, camera = min(tried, key=lambda one: one[0])
    return camera, deviation_m


def sees_whole(camera: Camera, places: Array, height_m: float) -> NDArray[np.bool_]:
    """Whether a camera sees somebody of some height from head to foot at places (P, 2) m, (P,)."""
    levels = np.linspace(0.0, height_m, 3)
    post = np.concatenate(
        [np.repeat(places, len(levels), axis=0), np.tile(levels, len(places))[:, None]], axis=1
    )
    uv, depth = camera.project(post)
    return np.asarray((camera.contains(uv) & (depth > 0)).reshape(len(places), -1).all(axis=1))


def _covariance(
    body: Body,
    states: Sequence[Array],
    told: Sequence[Array],
    settings: ForesightSettings,
    deviation: DeviationSettings,
) -> Array:
    """Covariance of the landmarks, (M, 3, 3) m^2, mean over states, with the body's own errors."""
    floor = np.array([deviation.of_landmark[landmark_kind(name)][0] for name in body.landmarks])
    weak = replace(deviation, weak_std_rad=settings.angle_std_rad)
    of_sight = [fit_covariance(body, state, known, weak) for state, known in zip(states, told, strict=True)]
    return np.asarray(np.mean(of_sight, axis=0) + (floor**2)[:, None, None] * np.eye(3))


def rig_information(rig: CameraRig, body: Body, state: Array, settings: ForesightSettings) -> Array:
    """What the outlines in all cameras tell of a state (D,), (D, D)."""
    return np.asarray(np.sum([outline_information(c, body, state, settings) for c in rig], axis=0))


def outline_information(camera: Camera, body: Body, state: Array, settings: ForesightSettings) -> Array:
    """What the outline in one camera tells of a state (D,), (D, D): J^T n n^T J over variance, summed over edges."""
    ends = cones_of(body, state)
    rotation, translation = joint_transforms(body, state[None])
    edge, normal, cone = _edges(camera.center, body, ends, settings.n_along)
    uv, depth = camera.project(edge)
    seen = camera.contains(uv) & (depth > 0)
    seen &= ~_is_covered(camera.center, edge + _OUTSIDE_M * normal, cone, body, ends)
    edge, normal, depth = edge[seen], normal[seen], depth[seen]
    joint = body.cones.joint[cone[seen]]
    offset = np.einsum("erc,er->ec", rotation[0, joint], edge - translation[0, joint])
    _, J, _ = point_jacobian(body, state, joint, offset)
    std_m = np.hypot(settings.edge_std_px * depth / camera.K[0, 0], settings.flesh_std_m)
    across = np.einsum("er,erd->ed", normal, J) / std_m[:, None]
    return np.asarray(across.T @ across)


def usual_states(body: Body, spot: Array, n_headings: int) -> list[Array]:
    """The postures turned to all sides, at a place (2,) m."""
    out = []
    for posture in _POSTURES:
        for heading in 2.0 * np.pi * (np.arange(n_headings) + 0.2) / n_headings:
            state = neutral_state(body)
            for name, value in {**posture, "root_yaw": heading}.items():
                if name in body.layout.names:
                    state[body.layout.names.index(name)] = value
            state[:2] += spot
            out.append(state)
    return out


def _edges(
    center: Array, body: Body, ends: tuple[Array, Array], n_along: int
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Where the flesh may end for a camera at a centre (3,): points (E, 3) m, unit directions (E, 3) out of the flesh,
    across the line of sight, and cones (E,). Both sides of every cone, and its far end."""
    start, end = ends
    points, normals, cones = [], [], []
    axis = end - start
    length = np.linalg.norm(axis, axis=1)
    axis = axis / np.maximum(length, 1e-9)[:, None]
    all_cones = np.arange(len(start))
    for share in (np.arange(n_along) + 0.5) / n_along:
        middle = start + share * (end - start)
        radius = (1.0 - share) * body.cones.radii[:, 0] + share * body.cones.radii[:, 1]
        side = np.cross(_unit(middle - center), axis)
        sine = np.linalg.norm(side, axis=1)
        is_side = (sine > _LEAST_SINE) & (length > 1e-6)
        for sign in (-1.0, 1.0):
            normal = sign * side[is_side] / sine[is_side, None]
            points.append(middle[is_side] + radius[is_side, None] * normal)
            normals.append(normal)
            cones.append(all_cones[is_side])
    sight = _unit(end - center)
    along = axis - (axis * sight).sum(axis=1, keepdims=True) * sight
    sine = np.linalg.norm(along, axis=1)
    is_end = (sine > _LEAST_SINE) & (length > 1e-6)
    normal = along[is_end] / sine[is_end, None]
    points.append(end[is_end] + body.cones.radii[is_end, 1][:, None] * normal)
    normals.append(normal)
    cones.append(all_cones[is_end])
    return np.concatenate(points), np.concatenate(normals), np.concatenate(cones)


def _is_covered(
    center: Array, points: Array, own: NDArray[np.int64], body: Body, ends: tuple[Array, Array]
) -> NDArray[np.bool_]:
    """Whether the line of sight through each point (E, 3) meets other flesh than that of its own cone, (E,)."""
    meets = distance_of_lines(body, ends, center, _unit(points - center)) < 0
    meets[np.arange(len(points)), own] = False
    return np.asarray(meets.any(axis=1))


def aimed(camera: Camera, name: str, center: Array, target: Array) -> Camera:
    """A camera like another at a centre (3,) m, upright, its middle on a target (3,) m."""
    z = _unit(target - center)
    x = _unit(np.cross(z, [0.0, 0.0, 1.0]))
    R = np.stack([x, np.cross(z, x), z])
    return replace(camera, name=name, R=R, t=-R @ center)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))

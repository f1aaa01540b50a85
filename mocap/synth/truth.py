"""The exact truth of a synthetic session, as files."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.data import FURTHER_LANDMARKS, Camera, Motion, Tracks, VoxelGrid
from mocap.io.tables import (
    FEET_AND_HANDS,
    FeetAndHands,
    write_feet_and_hands_csv,
    write_landmarks_csv,
    write_tracks_csv,
)
from mocap.progress import Progress
from mocap.synth.body import Body, mesh_volume_and_centroid
from mocap.synth.figure import JOINTS, PARENTS, feet_and_hands_of, forward_kinematics, landmarks_of
from mocap.synth.voxelise import solid_voxels
from mocap.synth.world import Actor, World

Array = NDArray[np.float64]

TRUTH_VOXEL_M = 0.02
CONTACT_SPEED_M_S = 0.35  # a point rests on the floor while it is slower
CONTACT_HEIGHT_M = 0.025  # and lower than this above what the foot stands on
_SOLES = [
    FURTHER_LANDMARKS.index(f"{side}_{point}") for side in ("left", "right") for point in ("heel", "toe")
]


@dataclass(frozen=True, eq=False)
class _Measured:
    """What is measured on the posed bodies, frame by frame.

    centroids, heads : (T, P, 3) m.  volumes : (T, P) m3.  markers : (T, P, M, 3) m.  solids : the voxels inside, one
    array per frame.  inside : (T, P), whether the centroid is over the room's capture area.
    """

    grid: VoxelGrid
    centroids: Array
    heads: Array
    volumes: Array
    markers: Array
    solids: list[NDArray[np.int32]]
    inside: NDArray[np.bool_]


def write_truth(world: World, truth: Path, report: Progress) -> None:
    """Everything that is known of a world without looking through its cameras, into the folder `truth`."""
    scene = world.scene
    truth.mkdir(exist_ok=True)
    measured = _measure(world, report)
    present = [np.flatnonzero(inside).astype(np.int64) for inside in measured.inside.T]
    write_landmarks_csv(
        truth / "landmarks.csv",
        [
            Motion(a.person, f, f / scene.fps, a.landmarks[f])
            for a, f in zip(world.actors, present, strict=True)
        ],
    )
    write_feet_and_hands_csv(
        truth / FEET_AND_HANDS,
        [feet_and_hands(a, f, scene.fps) for a, f in zip(world.actors, present, strict=True)],
    )
    _write_tracks(world, truth / "tracks.csv", measured.centroids, measured.inside)
    _write_tracks(world, truth / "heads.csv", measured.heads, measured.inside)
    if world.n_markers:
        _write_markers(world, truth, measured.markers, measured.inside)
    if scene.truth_voxels:
        _write_voxels(measured, truth / "voxels.npz")
    _write_poses(world, truth, measured.inside)
    _write_pictures_csv(world, truth / "pictures.csv")
    about = _about(world, measured)
    (truth / "truth.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")


def feet_and_hands(actor: Actor, frames: NDArray[np.int64], fps: float) -> FeetAndHands:
    """Heels, toes and hand tips of one person in frames (T,) of the session, and whether they rest on the floor."""
    xyz = feet_and_hands_of(actor.body.figure, actor.position, actor.rotation)
    steps_m = np.gradient(xyz, axis=0) if len(xyz) > 1 else np.zeros_like(xyz)
    speed_m_s = np.linalg.norm(steps_m, axis=2) * fps
    over_m = xyz[..., 2].copy()
    if actor.pose.ground_m is not None:
        over_m[:, _SOLES] -= np.repeat(actor.pose.ground_m, 2, axis=1)
    rests = (speed_m_s < CONTACT_SPEED_M_S) & (over_m < CONTACT_HEIGHT_M)
    rows = actor.lead + frames
    return FeetAndHands(actor.person, frames, xyz[rows], rests[rows])


def _measure(world: World, report: Progress) -> _Measured:
    """Pose every body in every frame once, and measure it."""
    scene = world.scene
    lower, upper = (np.array(c) for c in scene.room.capture_m)
    grid = VoxelGrid.from_bounds(lower, upper, TRUTH_VOXEL_M)
    n, P = scene.n_frames, len(world.actors)
    centroids, heads, volumes = np.zeros((n, P, 3)), np.zeros((n, P, 3)), np.zeros((n, P))
    markers = np.zeros((n, P, world.n_markers, 3))
    solids = []
    for frame in range(n):
        solid = [np.zeros(0, np.int32)]
        for i, actor in enumerate(world.actors):
            vertices, normals = actor.posed(frame)
            volumes[frame, i], centroids[frame, i] = mesh_volume_and_centroid(vertices, actor.body.faces)
            heads[frame, i] = actor.head_at(frame)
            if scene.truth_voxels:
                solid.append(solid_voxels(vertices, actor.body.faces, grid))
            if actor.markers is not None:
                markers[frame, i] = actor.markers.positions(vertices, normals)
        solids.append(np.unique(np.concatenate(solid)))
        report("truth", frame + 1, n)
    inside = np.all((centroids[..., :2] > lower[:2]) & (centroids[..., :2] < upper[:2]), axis=2)
    return _Measured(grid, centroids, heads, volumes, markers, solids, inside)


def _write_voxels(measured: _Measured, path: Path) -> None:
    """The solid bodies as linear indices, frames joined."""
    solids = measured.solids
    np.savez_compressed(
        path,
        origin_m=measured.grid.origin,
        shape=np.array(measured.grid.shape, dtype=np.int64),
        voxel_size_m=np.float64(TRUTH_VOXEL_M),
        offsets=np.concatenate([[0], np.cumsum([len(s) for s in solids])]).astype(np.int64),
        voxels=np.concatenate(solids).astype(np.int32),
    )


def _write_poses(world: World, truth: Path, inside: NDArray[np.bool_]) -> None:
    """pose_N.npz: the joints' rotations of each person.  inside : (T, P)."""
    for i, actor in enumerate(world.actors):
        kept = slice(actor.lead, actor.lead + world.scene.n_frames)
        np.savez_compressed(
            truth / f"pose_{actor.person}.npz",
            joints=np.array(JOINTS),
            parents=PARENTS,
            offsets_m=actor.body.figure.offsets,
            root_position_m=actor.pose.root_position[kept],
            rotations=actor.pose.rotations[kept].astype(np.float32),
            contact=actor.pose.contact[kept],
            inside=inside[:, i],
        )


def _about(world: World, measured: _Measured) -> dict[str, Any]:
    """truth.json: the scene, its persons, its furniture and its faults."""
    scene = world.scene
    persons = [
        {
            "person": a.person,
            "height_m": round(a.body.figure.stature_m, 4),
            "clothed_height_m": round(_clothed_height(a.body), 4),
            "sex": a.body.figure.sex,
            "build": round(a.body.figure.build, 3),
            "motion": p.motion.kind,
            "volume_m3": round(float(measured.volumes[:, i].mean()), 5),
            "limbs_m": {
                "upper_arm": round(a.body.figure.upper_arm_m, 5),
                "forearm": round(a.body.figure.forearm_m, 5),
                "thigh": round(a.body.figure.thigh_m, 5),
                "shank": round(a.body.figure.shank_m, 5),
            },
        }
        for i, (a, p) in enumerate(zip(world.actors, scene.persons, strict=True))
    ]
    return {
        "scene": scene.name,
        "seed": world.seed,
        "fps": scene.fps,
        "frames": scene.n_frames,
        "persons": persons,
        "room_size_m": list(scene.room.size_m),
        "furniture_m": [_bounds(piece.boxes()) for piece in scene.room.furniture],
        "furniture": [piece.model_dump(mode="json") for piece in scene.room.furniture],
        "faults": _faults(world),
        "markers": None if scene.markers is None else scene.markers.model_dump(mode="json"),
        "voxels": "voxels.npz: a voxel is set when its centre is inside the posed mesh (winding number); "
        "linear C-order indices, offsets per frame",
    }


def _clothed_height(body: Body) -> float:
    """Shoe sole to the top of the hair in the neutral pose, m."""
    figure = body.figure
    rotations = np.tile(np.eye(3), (1, len(JOINTS), 1, 1))
    root = np.array([[0.0, 0.0, figure.standing_height_m]])
    position, rotation = forward_kinematics(figure.offsets, rotations, root)
    return float(landmarks_of(figure, position, rotation)[0, 2, 2])


def _write_tracks(world: World, path: Path, points: Array, inside: NDArray[np.bool_]) -> None:
    """Points (T, P, 3) m of the persons while they are inside, (T, P)."""
    frame, i = np.nonzero(inside)
    person = np.array([a.person for a in world.actors], dtype=np.int64)[i]
    write_tracks_csv(path, Tracks(frame.astype(np.int64), person, frame / world.scene.fps, points[frame, i]))


def _write_markers(world: World, truth: Path, points: Array, inside: NDArray[np.bool_]) -> None:
    """markers.csv from points (T, P, M, 3) m, and marker_set.csv: where the markers sit on each person."""
    lines = ["frame,time_s,person,marker,x_m,y_m,z_m"]
    carried = ["person,marker,part,joint,x_m,y_m,z_m"]
    for frame, i in zip(*np.nonzero(inside), strict=True):
        actor = world.actors[i]
        assert actor.markers is not None
        head = f"{frame},{frame / world.scene.fps:.6f},{actor.person}"
        lines += [
            f"{head},{name},{x:.6f},{y:.6f},{z:.6f}"
            for name, (x, y, z) in zip(actor.markers.names, points[frame, i], strict=True)
        ]
    for actor in world.actors:
        assert actor.markers is not None
        carried += [
            f"{actor.person},{spot.name},{spot.part},{spot.joint},{x:.5f},{y:.5f},{z:.5f}"
            for spot, (x, y, z) in zip(actor.markers.spots, actor.markers.offset, strict=True)
        ]
    (truth / "markers.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (truth / "marker_set.csv").write_text("\n".join(carried) + "\n", encoding="utf-8")


def _faults(world: World) -> list[dict[str, Any]]:
    """The faults of the scene as given; of a moved camera also its pose before and after."""
    out = []
    n_moves = dict.fromkeys(world.rig.names, 0)
    for fault in sorted(world.scene.faults, key=lambda f: f.frame if hasattr(f, "frame") else 0):
        about = fault.model_dump(mode="json")
        if fault.kind == "moved":
            poses = world.cameras[fault.camera]
            k = n_moves[fault.camera] = n_moves[fault.camera] + 1
            about |= {"before": _pose(poses[k - 1]), "after": _pose(poses[k])}
        out.append(about)
    return out


def _bounds(corners: Array) -> list[list[float]]:
    """Lower and upper corner of boxes (B, 8, 3) m together."""
    points = corners.reshape(-1, 3)
    return [points.min(axis=0).tolist(), points.max(axis=0).tolist()]


def _pose(camera: Camera) -> dict[str, Any]:
    """World to camera, and the optical centre, m."""
    return {"R": camera.R.tolist(), "t_m": camera.t.tolist(), "center_m": camera.center.tolist()}


def _write_pictures_csv(world: World, path: Path) -> None:
    """What each picture of each camera shows; the columns are explained in docs/synthetic.md."""
    lines = ["camera,frame,shows_frame,light_gain,is_off,n_moves"]
    for name, time in world.timelines.items():
        lines += [
            f"{name},{k},{time.instant[k]:.6f},{time.gain[k]:.6f},{int(time.is_off[k])},{time.pose[k]}"
            for k in range(len(time))
        ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")

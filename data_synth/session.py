"""From a scene to a session folder: bodies, motions, pictures of all cameras, exact truth."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from data_synth.body import Body, build_body, mesh_volume_and_centroid
from data_synth.figure import JOINTS, forward_kinematics, landmarks_of, make_figure
from data_synth.looks import Look, make_look
from data_synth.motions import MOTIONS, Pose
from data_synth.motions import Path as FloorPath
from data_synth.render import CameraView, PosedScene, Sensor, make_sensor, posed_scene, require_embree
from data_synth.rooms import Room, make_ring, make_room
from data_synth.scene import Person, Progress, Scene, WalkMotion
from data_synth.voxelise import solid_voxels
from mocap.data import CameraRig, Motion, Tracks, VoxelGrid
from mocap.errors import MocapError
from mocap.io.calibration import write_calibration
from mocap.io.tables import write_landmarks_csv, write_tracks_csv

Array = NDArray[np.float64]

TRUTH_VOXEL_M = 0.02


@dataclass(frozen=True, eq=False)
class Actor:
    """One person of a prepared scene.

    position : (T, J, 3) m, rotation : (T, J, 3, 3), world.  landmarks : (T, 15, 3) m.
    """

    person: int
    body: Body
    look: Look
    pose: Pose
    position: Array
    rotation: Array
    landmarks: Array

    def posed(self, frame: int) -> tuple[Array, Array]:
        """Vertices and normals (V, 3) of one frame."""
        return self.body.pose(self.position[frame], self.rotation[frame])


@dataclass(frozen=True, eq=False)
class World:
    """A scene made concrete by its seed."""

    scene: Scene
    seed: int
    room: Room
    rig: CameraRig
    actors: tuple[Actor, ...]

    @property
    def bodies(self) -> tuple[Body, ...]:
        return tuple(a.body for a in self.actors)

    @property
    def looks(self) -> tuple[Look, ...]:
        return tuple(a.look for a in self.actors)

    def at(self, frame: int, *, with_light: bool = True) -> PosedScene:
        """All bodies in one frame, ready for ray casting."""
        posed = [a.posed(frame) for a in self.actors]
        return posed_scene(self.bodies, posed, self.room, with_light=with_light)


def rng_at(seed: int, *address: int) -> np.random.Generator:
    """The generator of one address; independent of every other address and of the order of use."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=address))


def build_world(scene: Scene, *, seed: int | None = None) -> World:
    """Room, rig, bodies and motions of a scene.

    seed : replaces the scene's seed and moves the persons' seeds along with it.
    """
    base = scene.seed if seed is None else seed
    furniture = np.array([[b.lower_m, b.upper_m] for b in scene.room.furniture], dtype=np.float64).reshape(
        -1, 2, 3
    )
    room = make_room(scene.room.size_m, floor=scene.room.floor, furniture=furniture, rng=rng_at(base, 1))
    rig = make_ring(
        scene.rig.n_cameras,
        radius_m=scene.rig.radius_m,
        height_m=scene.rig.height_m,
        focal_px=scene.rig.focal_px,
        size=scene.rig.size_px,
        distortion=scene.rig.distortion,
        room=room,
        rng=rng_at(base, 2),
    )
    shift = 0 if seed is None else seed * 7919
    actors = tuple(
        _actor(scene, i + 1, person, person.seed + shift) for i, person in enumerate(scene.persons)
    )
    return World(scene, base, room, rig, actors)


def _actor(scene: Scene, number: int, person: Person, seed: int) -> Actor:
    rng = rng_at(seed, 3)
    sex = person.sex or ("male" if rng.uniform() < 0.5 else "female")
    drawn = rng.normal(1.765, 0.07) if sex == "male" else rng.normal(1.645, 0.065)
    height = person.height_m or float(np.clip(drawn, 1.45, 2.0))
    build = person.build or float(np.clip(rng.normal(1.0, 0.08), 0.82, 1.25))
    body = build_body(make_figure(height, sex, build, rng=rng_at(seed, 4)))
    look = make_look(rng=rng_at(seed, 5), sex=sex)
    motion = person.motion
    if isinstance(motion, WalkMotion):
        path = FloorPath(
            motion.center_m, motion.radii_m, float(np.deg2rad(motion.start_deg)), motion.clockwise
        )
        pose = MOTIONS["walk"](
            body.figure, scene.n_frames, scene.fps, path=path, speed_m_s=motion.speed_m_s, rng=rng_at(seed, 6)
        )
    else:
        pose = MOTIONS[motion.kind](
            body.figure,
            scene.n_frames,
            scene.fps,
            position=motion.position_m,
            heading_rad=float(np.deg2rad(motion.heading_deg)),
            rng=rng_at(seed, 6),
        )
    position, rotation = forward_kinematics(body.figure.offsets, pose.rotations, pose.root_position)
    return Actor(number, body, look, pose, position, rotation, landmarks_of(body.figure, position, rotation))


def write_session(
    scene: Scene, out: Path, *, seed: int | None, workers: int, progress: Progress | None
) -> Path:
    """Write the session folder of a scene; see `data_synth.scene.synthesise`."""
    require_embree()
    if out.exists() and (
        not out.is_dir() or (any(out.iterdir()) and not (out / "truth" / "truth.json").is_file())
    ):
        raise MocapError(
            "the output folder exists and is not a synthetic session", path=out, remedy="give another folder"
        )
    report = progress or (lambda what, done, total: None)
    report("bodies", 0, 1)
    world = build_world(scene, seed=seed)
    report("bodies", 1, 1)
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{out.name}-", dir=out.parent) as scratch:
        folder = Path(scratch) / "session"
        folder.mkdir()
        groups = [list(world.rig.names[k :: max(workers, 1)]) for k in range(max(workers, 1))]
        groups = [g for g in groups if g]
        total = len(world.rig) * scene.n_frames
        jobs = _start_workers(scene, seed, groups[1:], folder, Path(scratch))
        try:
            _write_head(world, folder)

            def pictures(done: int) -> None:
                report("pictures", min(done * len(groups), total), total)

            render_cameras(world, groups[0], folder, progress=pictures)
            _write_truth(world, folder, report)
            for job in jobs:
                if job.wait() != 0:
                    raise RuntimeError(f"a rendering process failed with exit code {job.returncode}")
        finally:
            for job in jobs:
                if job.poll() is None:
                    job.terminate()
                    job.wait()
        report("pictures", total, total)
        if out.exists():
            shutil.rmtree(out)
        folder.rename(out)
    return out


def _start_workers(
    scene: Scene, seed: int | None, groups: list[list[str]], folder: Path, scratch: Path
) -> list[subprocess.Popen[bytes]]:
    """Processes that render the other groups of cameras; each builds the same world from the same seed."""
    jobs = []
    for k, names in enumerate(groups):
        job = scratch / f"job_{k}.json"
        job.write_text(
            json.dumps(
                {"scene": scene.model_dump(mode="json"), "seed": seed, "cameras": names, "out": str(folder)}
            )
        )
        # A fresh interpreter: forking a process that has used OpenCV's threads can hang.
        code = "import sys; sys.path[:0] = sys.argv[2:]; from data_synth import session; session.work(sys.argv[1])"
        root = str(Path(__file__).resolve().parent.parent)
        jobs.append(subprocess.Popen([sys.executable, "-c", code, str(job), root]))
    return jobs


def work(job_file: str) -> None:
    """Entry of a rendering process."""
    job = json.loads(Path(job_file).read_text())
    scene = Scene.model_validate(job["scene"])
    render_cameras(build_world(scene, seed=job["seed"]), job["cameras"], Path(job["out"]))


def render_cameras(
    world: World, names: list[str], folder: Path, *, progress: Callable[[int], None] | None = None
) -> None:
    """Videos, background clips and true silhouettes of some cameras."""
    scene = world.scene
    order = {n: i for i, n in enumerate(world.rig.names)}
    views = {n: CameraView(world.rig[n], world.room) for n in names}
    sensors = {n: _sensor(world, order[n]) for n in names}
    masks: dict[str, list[NDArray[np.uint8]]] = {n: [] for n in names}
    (folder / "truth" / "masks").mkdir(parents=True, exist_ok=True)
    writers: dict[str, cv2.VideoWriter] = {}
    n_threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # the pictures are small and there is a process per core
    try:
        if not scene.masks_only:
            if scene.with_background:
                for n in names:
                    clip = _open_video(folder / "background" / f"{n}.mp4", scene.fps, scene.rig.size_px)
                    for frame in range(scene.n_background_frames):
                        rng = rng_at(world.seed, 8, order[n], frame)
                        clip.write(sensors[n].expose(views[n].empty, 0, rng=rng)[..., ::-1])
                    clip.release()
            for n in names:
                writers[n] = _open_video(folder / "videos" / f"{n}.mp4", scene.fps, scene.rig.size_px)
        for frame in range(scene.n_frames):
            posed = world.at(frame, with_light=not scene.masks_only)
            for n in names:
                if scene.masks_only:
                    mask = views[n].silhouette(posed)
                    path = folder / "masks" / n / f"{frame:06d}.png"
                    path.parent.mkdir(parents=True, exist_ok=True)
                    cv2.imwrite(str(path), mask.astype(np.uint8) * 255)
                else:
                    picture, mask = views[n].render(posed, world.bodies, world.looks)
                    image = sensors[n].expose(picture, frame, rng=rng_at(world.seed, 9, order[n], frame))
                    writers[n].write(image[..., ::-1])
                masks[n].append(np.packbits(mask, axis=1))
            if progress is not None:
                progress((frame + 1) * len(names))
    finally:
        cv2.setNumThreads(n_threads)
        for writer in writers.values():
            writer.release()
    for n in names:
        np.savez_compressed(folder / "truth" / "masks" / f"{n}.npz", masks=np.stack(masks[n]))


def _sensor(world: World, camera: int) -> Sensor:
    picture = world.scene.picture
    return make_sensor(
        world.scene.n_frames,
        world.scene.rig.size_px,
        noise_levels=picture.noise_levels,
        light_drift=picture.light_drift,
        colour_cast=picture.colour_cast,
        fps=world.scene.fps,
        rng=rng_at(world.seed, 7, camera),
    )


def _open_video(path: Path, fps: float, size: tuple[int, int]) -> cv2.VideoWriter:
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, size)
    if not writer.isOpened():
        raise MocapError(
            "this OpenCV cannot write mp4v video", path=path, remedy="reinstall opencv-python-headless"
        )
    return writer


def _write_head(world: World, folder: Path) -> None:
    """calibration.toml and session.toml; the persons' heights are truth and stay out of them."""
    scene = world.scene
    write_calibration(
        folder / "calibration.toml", world.rig, metadata={"source": f"synthetic scene {scene.name}"}
    )
    lower, upper = ([float(x) for x in corner] for corner in scene.room.capture_m)
    text = f"fps = {float(scene.fps)}\nroom_bounds_m = [{lower}, {upper}]\n"
    (folder / "session.toml").write_text(text, encoding="utf-8")


def _write_truth(world: World, folder: Path, report: Progress) -> None:
    scene = world.scene
    truth = folder / "truth"
    truth.mkdir(exist_ok=True)
    frames = np.arange(scene.n_frames, dtype=np.int64)
    times = frames / scene.fps
    write_landmarks_csv(
        truth / "landmarks.csv", [Motion(a.person, frames, times, a.landmarks) for a in world.actors]
    )
    lower, upper = (np.array(c) for c in scene.room.capture_m)
    grid = VoxelGrid.from_bounds(lower, upper, TRUTH_VOXEL_M)
    rows: list[tuple[int, int, Array]] = []
    volumes: list[list[float]] = []
    solids = []
    for frame in range(scene.n_frames):
        inside = []
        volume_now = []
        for actor in world.actors:
            vertices, _ = actor.posed(frame)
            volume, centroid = mesh_volume_and_centroid(vertices, actor.body.faces)
            rows.append((frame, actor.person, centroid))
            volume_now.append(volume)
            inside.append(solid_voxels(vertices, actor.body.faces, grid))
        volumes.append(volume_now)
        solids.append(np.unique(np.concatenate(inside)) if inside else np.zeros(0, np.int32))
        report("truth", frame + 1, scene.n_frames)
    frame_column = np.array([r[0] for r in rows], dtype=np.int64)
    write_tracks_csv(
        truth / "tracks.csv",
        Tracks(
            frame_column,
            np.array([r[1] for r in rows], dtype=np.int64),
            frame_column / scene.fps,
            np.array([r[2] for r in rows], dtype=np.float64).reshape(-1, 3),
        ),
    )
    np.savez_compressed(
        truth / "voxels.npz",
        origin_m=grid.origin,
        shape=np.array(grid.shape, dtype=np.int64),
        voxel_size_m=np.float64(TRUTH_VOXEL_M),
        offsets=np.concatenate([[0], np.cumsum([len(s) for s in solids])]).astype(np.int64),
        voxels=np.concatenate(solids).astype(np.int32),
    )
    for actor in world.actors:
        np.savez_compressed(
            truth / f"pose_{actor.person}.npz",
            joints=np.array(JOINTS),
            offsets_m=actor.body.figure.offsets,
            root_position_m=actor.pose.root_position,
            rotations=actor.pose.rotations.astype(np.float32),
            contact=actor.pose.contact,
        )
    persons = [
        {
            "person": a.person,
            "height_m": round(a.body.figure.stature_m, 4),
            "clothed_height_m": round(_clothed_height(a.body), 4),
            "sex": a.body.figure.sex,
            "build": round(a.body.figure.build, 3),
            "motion": p.motion.kind,
            "volume_m3": round(float(np.mean([v[i] for v in volumes])), 5),
            "limbs_m": {
                "upper_arm": round(a.body.figure.upper_arm_m, 5),
                "forearm": round(a.body.figure.forearm_m, 5),
                "thigh": round(a.body.figure.thigh_m, 5),
                "shank": round(a.body.figure.shank_m, 5),
            },
        }
        for i, (a, p) in enumerate(zip(world.actors, scene.persons, strict=True))
    ]
    about = {
        "scene": scene.name,
        "seed": world.seed,
        "fps": scene.fps,
        "frames": scene.n_frames,
        "persons": persons,
        "room_size_m": list(scene.room.size_m),
        "furniture_m": [[list(b.lower_m), list(b.upper_m)] for b in scene.room.furniture],
        "voxels": "voxels.npz: a voxel is set when its centre is inside the posed mesh (winding number); "
        "linear C-order indices, offsets per frame",
    }
    (truth / "truth.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")


def _clothed_height(body: Body) -> float:
    """Shoe sole to the top of the hair in the neutral pose, m."""
    figure = body.figure
    rotations = np.tile(np.eye(3), (1, len(JOINTS), 1, 1))
    root = np.array([[0.0, 0.0, figure.standing_height_m]])
    position, rotation = forward_kinematics(figure.offsets, rotations, root)
    return float(landmarks_of(figure, position, rotation)[0, 2, 2])

"""Make the pictures of the documentation from a run of the demo.

    mocap demo                      # session in out/demo/session, result in out/demo/result
    python -m docs.make_pictures    # pictures in docs/pictures

Every picture shows the synthetic demo session; no other footage is needed.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.body import joint_transforms, landmarks_of, load_body_model, neutral_state, scale_body
from mocap.data import LANDMARKS, Camera, Hull, VoxelGrid
from mocap.filters import initial_particles
from mocap.filters.apf import ApfSettings, apf_step
from mocap.filters.refine import RefineSettings, refine
from mocap.foreground import Segmenter, learn_background
from mocap.io.session import Session, open_session
from mocap.io.store import StageStore
from mocap.io.tables import read_landmarks_csv, read_tracks_csv
from mocap.io.video import FrameReader, iter_clip
from mocap.likelihood.colours import ColourProblem, new_appearance
from mocap.metrics import epsilon_lilliefors, point_errors
from mocap.pipeline.config import load_config
from mocap.pipeline.pose_settings import make_tools
from mocap.pipeline.scene_frames import body_parts
from mocap.pipeline.stages.pose import hulls_of_person
from mocap.pose.result import PersonPoses
from mocap.pose.volume import PersonHull, VolumeTools
from mocap.products.hulls import hull_from_arrays, stored_grid
from mocap.products.masks import masks_from_arrays
from mocap.products.poses import stored_poses
from mocap.view import (
    contact_sheet,
    crop,
    draw_body,
    draw_floor_grid,
    draw_hull,
    draw_mask,
    draw_skeleton,
    person_window,
    track_map_svg,
)
from mocap.volume import Carver, colour_hull, surface_voxels
from mocap.volume.residuals import reproject

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

FRAME = 38
CAMERA = 3
MAX_BYTES = 150_000
SHADOW_COLOUR = (86, 180, 233)


@dataclass(frozen=True, eq=False)
class Demo:
    """A finished demo run and one frame of it that all pictures show."""

    root: Path

    @cached_property
    def session(self) -> Session:
        return open_session(self.root / "session")

    @cached_property
    def store(self) -> StageStore:
        return StageStore(self.root / "result" / "store.zarr")

    @cached_property
    def grid(self) -> VoxelGrid:
        return stored_grid(self.store)

    @cached_property
    def images(self) -> tuple[Image, ...]:
        with FrameReader(self.session.image_sources, self.session.rig, range(FRAME, FRAME + 1)) as reader:
            return next(iter(reader))[1]

    @cached_property
    def masks(self) -> list[NDArray[np.bool_]]:
        return masks_from_arrays(self.store.reader("segment").read(FRAME), self.session)

    @cached_property
    def hull(self) -> Hull:
        return hull_from_arrays(self.grid, self.store.reader("carve").read(FRAME))

    @cached_property
    def owner(self) -> NDArray[np.uint16]:
        return self.store.reader("track-owners").read(FRAME)["owner"]

    @cached_property
    def poses(self) -> PersonPoses:
        return stored_poses(self.store)[0]

    @cached_property
    def row(self) -> int:
        return int(np.searchsorted(self.poses.frames, FRAME))

    @cached_property
    def tools(self) -> VolumeTools:
        config = load_config()
        return make_tools(
            self.grid,
            self.session.fps,
            self.poses.body.height_m,
            config.body_model("voxels"),
            config.pose,
            config.likelihood,
            1,
        )

    @cached_property
    def person(self) -> PersonHull:
        voxels = self.hull.voxels[self.owner == self.poses.person]
        return PersonHull(voxels, surface_voxels(voxels, self.grid))

    def window(self, camera: int, *, aspect: float = 0.62) -> tuple[int, int, int, int]:
        """The part of a camera's picture that shows the person."""
        centers = self.grid.centers(self.person.voxels)
        return person_window(self.session.rig[camera], centers, margin=0.06, aspect=aspect)


def cameras(demo: Demo) -> Image:
    """The metre grid on the floor in four cameras."""
    bounds = (demo.grid.origin.tolist(), demo.grid.upper.tolist())
    chosen = (0, 2, 4, 6)
    tiles = [draw_floor_grid(demo.images[c], demo.session.rig[c], bounds) for c in chosen]
    return contact_sheet(tiles, [demo.session.rig[c].name for c in chosen], n_columns=4, width=1280)


def foreground(demo: Demo) -> Image:
    """Background, difference, mask and shadow of one camera."""
    camera = demo.session.rig[CAMERA]
    background = learn_background(iter_clip(demo.session.background_sources[camera.name]))
    segmenter = Segmenter(background)
    clip = iter_clip(demo.session.image_sources[camera.name])
    for frame, image in enumerate(clip):
        found = segmenter.segment(image)
        if frame == FRAME:
            break
    mean = np.clip(np.rint(background.mean), 0, 255).astype(np.uint8)
    difference = np.abs(image.astype(np.int16) - mean).max(axis=2)
    bright = np.repeat(np.clip(2 * difference, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)
    answer = draw_mask(draw_mask(image, found.shadow, SHADOW_COLOUR, 0.5), found.mask)
    x0, y0, x1, y1 = demo.window(CAMERA, aspect=1.0)
    window = (x0, y0, x1, min(y1 + 20, camera.size[1]))
    tiles = [crop(t, window, scale=2.0) for t in (image, mean, bright, answer)]
    labels = ["picture", "mean of the empty scene", "difference x 2", "person (magenta), shadow (blue)"]
    return contact_sheet(tiles, labels, n_columns=4, width=1280)


def volume(demo: Demo) -> Image:
    """Hulls with and without tolerance, by depth and by colour."""
    camera, image, window = demo.session.rig[CAMERA], demo.images[CAMERA], demo.window(CAMERA)
    carver = Carver(demo.session.rig, demo.grid)
    tiles, labels = [], []
    for k in (0, 1):
        voxels = carver.carve(demo.masks, n_faulty_views=k)
        hull = colour_hull(
            voxels, surface_voxels(voxels, demo.grid), demo.grid, demo.session.rig, demo.images
        )
        tiles.append(crop(draw_hull(image, camera, hull), window, scale=2.0))
        labels.append(f"k = {k}: {hull.volume_litres:.0f} litres")
        if k == 1:
            grey = np.full_like(image, 60)
            tiles.append(crop(draw_hull(grey, camera, hull, colour_by="rgb"), window, scale=2.0))
            labels.append("its colours")
            tiles.append(crop(draw_mask(image, reproject(hull, camera)), window, scale=2.0))
            labels.append("reprojected")
    return contact_sheet(tiles, labels, n_columns=4, width=1100)


def tracking(demo: Demo) -> bytes:
    """Paths from above."""
    return track_map_svg(
        demo.session.rig,
        read_tracks_csv(demo.root / "result" / "tracks.csv"),
        read_tracks_csv(demo.root / "session" / "truth" / "tracks.csv"),
        bounds_m=(demo.grid.origin.tolist(), demo.grid.upper.tolist()),
    )


def studio() -> Camera:
    """A camera 5 m in front of the origin that looks at a standing body, a little from the left."""
    eye, target = np.array([4.4, 2.0, 1.5]), np.array([0.0, 0.0, 0.9])
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    K = np.array([[1250.0, 0.0, 330.0], [0.0, 1250.0, 290.0], [0.0, 0.0, 1.0]])
    return Camera("studio", (660, 600), K, np.zeros(4), R, -R @ eye)


def body() -> Image:
    """The bodies at rest, their joints, and a pose."""
    camera = studio()
    ground = np.full((camera.size[1], camera.size[0], 3), 38, dtype=np.uint8)
    tiles, labels = [], []
    for name in ("whole", "anthropometric", "thesis"):
        model = scale_body(load_body_model(name), 1.75)
        rest = np.zeros(model.layout.n_columns)
        rest[2] = neutral_state(model)[2]
        view = draw_body(ground, camera, body_parts(model, rest), alpha=0.75)
        view = draw_axes(view, camera, joint_transforms(model, rest[None]), model.joints)
        tiles.append(view)
        labels.append(f"{name}, rest pose, 1.75 m")
    model = scale_body(load_body_model("whole"), 1.75)
    state = neutral_state(model)
    for column, value in (
        ("right_elbow_z", 1.2),
        ("left_knee_y", 0.9),
        ("left_hip_y", -0.8),
        ("neck_x", 0.25),
        ("left_shoulder_x", 0.15),
        ("left_clavicle_x", 0.3),
    ):
        state[model.layout.names.index(column)] = value
    view = draw_body(ground, camera, body_parts(model, state), alpha=0.55)
    tiles.append(draw_skeleton(view, camera, landmarks_of(model, state[None])[0]))
    labels.append("a pose and its landmarks")
    tiles = [crop(tile, (95, 50, 615, 550)) for tile in tiles]
    return contact_sheet(tiles, labels, n_columns=4, width=1300)


def draw_axes(
    image: Image, camera: Camera, transforms: tuple[Array, Array], joints: tuple[str, ...]
) -> Image:
    """Frame of every joint: x vermilion, y green, z blue, 12 cm long."""
    out = image.copy()
    R, t = transforms[0][0], transforms[1][0]
    for j in range(len(joints)):
        for axis, colour in enumerate(((213, 94, 0), (0, 200, 120), (90, 160, 255))):
            ends, _ = camera.project(np.stack([t[j], t[j] + 0.12 * R[j][:, axis]]))
            a, b = (tuple(int(v) for v in np.rint(end)) for end in ends)
            cv2.arrowedLine(out, a, b, colour, 2, cv2.LINE_AA, tipLength=0.25)
    return out


def likelihood(demo: Demo) -> bytes:
    """A slice of the packed volume with the flesh in it, and the likelihood along two joint angles."""
    problem = demo.tools.frame(demo.person).voxels
    state = demo.poses.states[demo.row]
    layout = demo.tools.body.layout
    figure, axes = new_figure(3, width=10.5, height=4.4)

    # The vertical plane through the right leg, along the direction in which the person faces.
    volume = problem.volume
    side = volume.grid.voxel_size_m
    yaw = state[layout.names.index("root_yaw")]
    ahead, across = np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    hip = demo.poses.landmarks[demo.row][LANDMARKS.index("right_hip")] * [1.0, 1.0, 0.0]
    along, up = np.meshgrid(np.arange(-0.6, 0.6, side / 4), np.arange(0.0, 1.9, side / 4))
    cell = hip + along[..., None] * ahead + up[..., None] * [0.0, 0.0, 1.0] - volume.lower_m
    plane = volume.crop[tuple(np.moveaxis(np.floor(cell / side).astype(int), -1, 0))]
    value = np.where(plane >= 128, 0.25, 0.0) + 0.65 * (plane & 127) / 127.0
    axes[0].imshow(value, origin="lower", extent=(-0.6, 0.6, 0.0, 1.9), cmap="Greys", vmin=0, vmax=1.3)
    points = flesh_points(demo, state) - hip
    near = np.abs(points @ across) < 0.5 * side
    axes[0].plot(
        points[near] @ ahead, points[near, 2], ".", ms=2.2, color="#d55e00", label="flesh of the estimate"
    )
    axes[0].set(xlabel="forwards (m)", ylabel="z (m)", title="slice through the right leg")
    axes[0].legend(loc="upper right", fontsize=7)

    for ax, (column, part) in zip(
        axes[1:], (("right_knee_y", "right_shank"), ("left_shoulder_x", "left_upper_arm")), strict=True
    ):
        d, p = layout.names.index(column), layout.parts.index(part)
        angles = np.linspace(state[d] - 0.8, state[d] + 0.8, 161)
        states = np.tile(state, (len(angles), 1))
        states[:, d] = angles
        per_part = problem.log_likelihood(states)
        ax.plot(np.degrees(angles), per_part.sum(axis=1), color="#0072b2", label="all parts")
        ax.plot(np.degrees(angles), per_part[:, p], "--", color="#d55e00", label=part.replace("_", " "))
        ax.axvline(np.degrees(state[d]), color="#22262b", lw=1, ls=":", label="estimate")
        ax.set(xlabel=f"{column} (degrees)", title="log-likelihood (nats)")
        ax.legend(fontsize=7)
        ax.grid(color="#d9dde2", lw=0.6)
    return png(figure)


def flesh_points(demo: Demo, state: Array) -> Array:
    """All points of the look-up table in one pose, (M, 3) m, world."""
    table = demo.tools.table
    R, t = joint_transforms(demo.tools.body, state[None])
    joint = np.repeat(table.joint, np.diff(table.start))
    return np.einsum("mrc,mc->mr", R[0, joint], table.points.astype(np.float64)) + t[0, joint]


def filtering(demo: Demo) -> Image:
    """Particles of the first and the last layer, the filter's estimate and the refined one."""
    camera, image, window = demo.session.rig[CAMERA], demo.images[CAMERA], demo.window(CAMERA)
    tools, body = demo.tools, demo.tools.body
    frame = tools.frame(demo.person)
    problem, surface = frame.voxels, frame.surface
    start = initial_particles(problem, demo.poses.states[demo.row - 1], 300)
    tiles, labels = [], []
    for n_layers in (1, 4):
        settings = ApfSettings(n_layers=n_layers, n_particles=300, std=tools.noise_std)
        # The same seed gives the first layer of both runs the same numbers.
        particles, info = apf_step(problem, start, settings, rng=np.random.default_rng(1))
        tiles.append(draw_cloud(image, camera, landmarks_of(body, particles.particles)))
        labels.append(f"layer {n_layers} of 4: beta {info.beta[-1]:.2f}")
    tiles.append(draw_body(image, camera, body_parts(body, info.estimate)))
    labels.append("estimate of the filter")
    refined, _ = refine(surface, info.estimate, RefineSettings(tools.prior_std))
    tiles.append(draw_body(image, camera, body_parts(body, refined)))
    labels.append("refined on the hull")
    tiles = [crop(tile, window, scale=2.0) for tile in tiles]
    return contact_sheet(tiles, labels, n_columns=4, width=1100)


def colours(demo: Demo) -> Image:
    """What every sampled pixel says of the estimate, and of a pose with one arm stretched forwards."""
    camera, image, window = demo.session.rig[CAMERA], demo.images[CAMERA], demo.window(CAMERA)
    hull_of = hulls_of_person(demo.session, demo.store, demo.poses.person)
    body, appearance = demo.poses.body, new_appearance(demo.poses.body)
    for frame, state in zip(demo.poses.frames.tolist(), demo.poses.states, strict=True):
        hull = hull_of(frame)
        if hull is not None and hull.rays is not None:
            problem = ColourProblem(body, hull.rays(), appearance)
            appearance = problem.learnt(state, np.ones(body.layout.n_parts, dtype=np.bool_))
    hull = hull_of(FRAME)
    if hull is None or hull.rays is None:
        raise ValueError("the frame of the pictures shows nobody")
    rays = hull.rays()
    problem = ColourProblem(body, rays, appearance)
    right = demo.poses.states[demo.row]
    wrong = right.copy()
    for column, value in (("left_shoulder_x", -1.3), ("left_shoulder_z", -1.4), ("left_elbow_z", -1.9)):
        wrong[body.layout.names.index(column)] = value
    own = rays.camera == CAMERA
    at, _ = camera.project(camera.center + 3.0 * rays.directions[own])
    tiles, labels = [image], ["picture"]
    for state, label in ((right, "estimate"), (wrong, "left arm before the chest")):
        view = draw_skeleton((0.45 * image).astype(np.uint8), camera, landmarks_of(body, state[None])[0])
        for place, value in zip(np.rint(at).astype(int), problem.pixel_values(state)[own], strict=True):
            colour = (0, 200, 120) if value > 0.2 else (213, 94, 0) if value < -0.2 else (150, 150, 150)
            cv2.circle(view, tuple(int(v) for v in place), 1, colour, -1, cv2.LINE_AA)
        tiles.append(view)
        labels.append(f"{label}: {float(problem.log_ratio(state[None])[0]):+.2f}")
    return contact_sheet([crop(t, window, scale=2.0) for t in tiles], labels, n_columns=3, width=1000)


def draw_cloud(image: Image, camera: Camera, landmarks: Array) -> Image:
    """Faint stick figures of many particles, their mean drawn over them.  landmarks : (N, 15, 3) m."""
    total = np.zeros(image.shape, dtype=np.float64)
    chosen = landmarks[:: max(1, len(landmarks) // 60)]
    for one in chosen:
        total += draw_skeleton(image, camera, one)
    mixed = 0.35 * image + 0.65 * total / len(chosen)
    difference = mixed - image
    return np.clip(image * 0.6 + 3.0 * difference, 0, 255).astype(np.uint8)


def metrics(demo: Demo) -> bytes:
    """Error over time, and the share of landmarks within every threshold."""
    estimate = read_landmarks_csv(demo.root / "result" / "landmarks.csv")[0]
    truth = read_landmarks_csv(demo.root / "session" / "truth" / "landmarks.csv")[0]
    _, i, j = np.intersect1d(estimate.frames, truth.frames, return_indices=True)
    errors = point_errors(estimate.landmarks[i], truth.landmarks[j])
    figure, axes = new_figure(2, width=9.5, height=3.0)
    frames = estimate.frames[i]
    axes[0].plot(frames, errors.max(axis=1), "--", color="#d55e00", label="worst landmark")
    axes[0].plot(frames, errors.mean(axis=1), color="#0072b2", lw=2, label="mean of 15")
    axes[0].axhline(100, color="#22262b", lw=1, ls=":", label="epsilon = 100 mm")
    axes[0].set(xlabel="frame", ylabel="error (mm)", ylim=(0, 108))
    ordered = np.sort(errors.ravel())
    axes[1].plot(ordered, 100 * (1 + np.arange(ordered.size)) / ordered.size, color="#0072b2")
    best = epsilon_lilliefors(errors)
    if best is not None:
        axes[1].axvline(best, color="#009e73", lw=1, ls="-.", label=f"epsilon_opt = {best:.0f} mm")
    axes[1].axvline(100, color="#22262b", lw=1, ls=":", label="epsilon = 100 mm")
    axes[1].set(xlabel="epsilon (mm)", ylabel="landmarks within epsilon (%)", xlim=(0, 108), ylim=(0, 103))
    for ax in axes:
        ax.grid(color="#d9dde2", lw=0.6)
        ax.legend(fontsize=8)
    return png(figure)


def synthetic(demo: Demo) -> Image:
    """Six moments of the session, and the true silhouette."""
    camera = demo.session.rig[CAMERA]
    tiles, labels = [], []
    with FrameReader(demo.session.image_sources, demo.session.rig, demo.session.frames) as reader:
        for frame, images in reader:
            if frame % 20 == 0:
                for c in (CAMERA, 6):
                    tiles.append(images[c])
                    labels.append(f"{demo.session.rig[c].name}, frame {frame}")
    packed = np.load(demo.root / "session" / "truth" / "masks" / f"{camera.name}.npz")["masks"][FRAME]
    mask = np.unpackbits(packed, axis=1, count=camera.size[0]).astype(bool)
    tiles.append(draw_mask(demo.images[CAMERA], mask))
    labels.append(f"true silhouette, frame {FRAME}")
    truth = read_landmarks_csv(demo.root / "session" / "truth" / "landmarks.csv")[0]
    tiles.append(draw_skeleton(demo.images[CAMERA], camera, truth.landmarks[FRAME]))
    labels.append("true landmarks")
    return contact_sheet(tiles, labels, n_columns=4, width=1200)


def new_figure(n: int, *, width: float, height: float) -> tuple[Any, Any]:
    """A matplotlib figure without a window, and its n axes in a row."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(1, n)


def png(figure: Any) -> bytes:
    """The figure as PNG bytes without dates or versions."""
    from io import BytesIO

    buffer = BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def jpeg(image: Image) -> bytes:
    """JPEG of the best quality that fits into MAX_BYTES."""
    for quality in (90, 85, 80, 75, 70, 60):
        _, data = cv2.imencode(
            ".jpg", image[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
        )
        if data.nbytes < MAX_BYTES:
            break
    return data.tobytes()


def main(argv: list[str] | None = None) -> int:
    """Write all pictures; 2 when there is no finished demo run."""
    parser = argparse.ArgumentParser(
        description="Make the pictures of the documentation from a run of the demo."
    )
    parser.add_argument("--demo", type=Path, default=Path("out/demo"), help="folder of `mocap demo`")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("pictures"))
    parser.add_argument("--only", nargs="*", help="names of pictures")
    options = parser.parse_args(argv)
    if not (options.demo / "result" / "landmarks.csv").exists():
        print(f"{options.demo} holds no finished demo; run `mocap demo` first", file=sys.stderr)
        return 2
    demo = Demo(options.demo)
    makers: dict[str, Callable[[], bytes | Image]] = {
        "cameras": lambda: cameras(demo),
        "foreground": lambda: foreground(demo),
        "volume": lambda: volume(demo),
        "tracking": lambda: tracking(demo),
        "body": body,
        "likelihood": lambda: likelihood(demo),
        "filter": lambda: filtering(demo),
        "colours": lambda: colours(demo),
        "metrics": lambda: metrics(demo),
        "synthetic": lambda: synthetic(demo),
    }
    options.out.mkdir(parents=True, exist_ok=True)
    for name in options.only or makers:
        made = makers[name]()
        data, suffix = (made, "png") if isinstance(made, bytes) else (jpeg(made), "jpg")
        suffix = "svg" if data.startswith(b"<svg") else suffix
        (options.out / f"{name}.{suffix}").write_bytes(data)
        print(f"{name}.{suffix}: {len(data) / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Make the pictures of docs/volumes.md from synthetic sessions.

for s in demo fault_moved fault_lag furnished furnished_sit; do mocap synth --scene $s -o out/camera_faults/$s; done
python -m docs.make_volume_pictures
"""

from __future__ import annotations

import argparse
import io
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from eval.camera_faults import watch
from mocap.data import CameraRig, VoxelGrid
from mocap.foreground import EMPTY_REDUCTION, empty_picture, learn_background
from mocap.io.session import open_session
from mocap.io.tables import read_landmarks_csv
from mocap.io.video import FrameReader, iter_clip
from mocap.volume import (
    Carver,
    SilhouetteEvidence,
    choose_grid,
    colour_hull,
    learn_occluders,
    surface_voxels,
    things_on_floor,
)
from mocap.volume.consistency import MAX_LAG_FRAMES
from mocap.volume.occluders import VOXEL_M, painted

PICTURES = Path(__file__).with_name("pictures")
MAX_BYTES = 150_000
FRAME = 38
HIDDEN_FRAME, HIDING_CAMERAS = 88, (0, 2)  # of `furnished`
THINGS_CAMERAS = (0, 2, 4)  # of `furnished_sit`
COLOURS = ("#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9", "#999999")


def policies(root: Path) -> bytes:
    """A slice at the height of the arms: votes, and the hulls of three tolerances."""
    import matplotlib.pyplot as plt

    session = open_session(root)
    assert session.truth_dir is not None
    masks = []
    for camera in session.rig:
        with np.load(session.truth_dir / "masks" / f"{camera.name}.npz", allow_pickle=False) as archive:
            masks.append(np.unpackbits(archive["masks"][FRAME], axis=1, count=camera.size[0]).view(np.bool_))
    grid = choose_grid(session.rig, 0.02, bounds_m=session.room_bounds_m)
    carver = Carver(session.rig, grid)
    soft = carver.votes(masks)
    level = int(1.15 / grid.voxel_size_m)
    votes = np.zeros(grid.n_voxels, dtype=np.uint8)
    votes[soft.voxels] = soft.n_votes
    extent = (grid.origin[1], grid.upper[1], grid.origin[0], grid.upper[0])
    with np.load(session.truth_dir / "voxels.npz", allow_pickle=False) as truth:
        true_grid = VoxelGrid(truth["origin_m"], tuple(truth["shape"]), float(truth["voxel_size_m"]))
        own = truth["voxels"][truth["offsets"][FRAME] : truth["offsets"][FRAME + 1]]
    body = true_grid.dense(own)[:, :, int(1.15 / true_grid.voxel_size_m)]
    where = np.argwhere(body) * true_grid.voxel_size_m + true_grid.origin[:2]
    middle = where.mean(axis=0)
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.6), constrained_layout=True)
    picture = axes[0].imshow(
        votes.reshape(grid.shape)[:, :, level], origin="lower", extent=extent, cmap="viridis", vmax=7
    )
    axes[0].set_title("soft volume: foreground votes, 1.15 m above the floor")
    figure.colorbar(picture, ax=axes[0], ticks=range(8))
    true_extent = (true_grid.origin[1], true_grid.upper[1], true_grid.origin[0], true_grid.upper[0])
    axes[1].imshow(np.where(body, 0.75, 1.0), origin="lower", extent=true_extent, cmap="gray", vmin=0, vmax=1)
    for k, colour in ((0, COLOURS[0]), (1, COLOURS[1]), (2, COLOURS[3])):
        hull = grid.dense(carver.carve(masks, n_faulty_views=k))[:, :, level].astype(float)
        litres = len(carver.carve(masks, n_faulty_views=k)) * grid.voxel_size_m**3 * 1e3
        axes[1].contour(hull, [0.5], extent=extent, colors=colour, linewidths=1.6)
        axes[1].plot([], [], color=colour, label=f"k = {k}: {litres:.0f} litres")
    axes[1].plot(
        [],
        [],
        color="0.75",
        linewidth=6,
        label=f"body: {len(own) * true_grid.voxel_size_m**3 * 1e3:.0f} litres",
    )
    axes[1].set_xlim(middle[1] - 0.55, middle[1] + 0.55)
    axes[1].set_ylim(middle[0] - 0.55, middle[0] + 0.55)
    axes[1].legend(fontsize=8, loc="upper right")
    axes[1].set_title("hulls that allow k faulty views")
    for ax in axes:
        ax.set_xlabel("y, m")
        ax.set_ylabel("x, m")
    return _png(figure)


def consistency(moved: SilhouetteEvidence, lagging: SilhouetteEvidence) -> bytes:
    """Shares outside over time, the lag that fits, and masks over silhouettes before and after a move."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(11, 6.6), constrained_layout=True)
    for c, name in enumerate(moved.names):
        axes[0, 0].plot(moved.frames, moved.uncovered[:, c, MAX_LAG_FRAMES], color=COLOURS[c % 7], label=name)
    axes[0, 0].set_title("cam_3 is pushed at frame 50")
    axes[0, 0].set_ylabel("mask outside the others' hull")
    axes[0, 0].legend(fontsize=7, ncols=2, loc="upper left")
    share = lagging.uncovered[:, lagging.names.index("cam_2")].T
    lags = (-MAX_LAG_FRAMES - 0.5, MAX_LAG_FRAMES + 0.5)
    picture = axes[0, 1].imshow(
        share, aspect="auto", origin="lower", extent=(-0.5, len(lagging.frames) - 0.5, *lags), vmax=0.3
    )
    axes[0, 1].set_title("cam_2 is 3 frames late from frame 45 on")
    axes[0, 1].set_ylabel("lag, frames")
    figure.colorbar(picture, ax=axes[0, 1], label="mask outside")
    for ax in axes[0]:
        ax.set_xlabel("frame")
    c = moved.names.index("cam_3")
    for ax, frame in zip(axes[1], (48, 52), strict=True):
        shot = next(s for s in moved.snapshots if s.frame == frame)
        canvas = np.full((*shot.masks[c].shape, 3), 30, dtype=np.uint8)
        canvas[shot.hulls[c] > 0] = (0, 90, 150)
        canvas[(shot.masks[c] > 0) & (shot.hulls[c] > 0)] = (235, 235, 235)
        canvas[(shot.masks[c] > 0) & (shot.hulls[c] == 0)] = (213, 94, 0)
        ax.imshow(canvas)
        ax.set_title(f"cam_3, frame {frame}: mask on the others' silhouette")
        ax.set_axis_off()
    return _png(figure)


def visibility(root: Path) -> NDArray[np.uint8]:
    """Colours of all cameras averaged, and of those that see the voxel, from two sides."""
    from mocap.view import contact_sheet, crop, draw_hull, person_window

    session = open_session(root)
    with FrameReader(session.image_sources, session.rig, range(FRAME, FRAME + 1)) as reader:
        images = next(iter(reader))[1]
    assert session.truth_dir is not None
    masks = []
    for camera in session.rig:
        with np.load(session.truth_dir / "masks" / f"{camera.name}.npz", allow_pickle=False) as archive:
            masks.append(np.unpackbits(archive["masks"][FRAME], axis=1, count=camera.size[0]).view(np.bool_))
    grid = choose_grid(session.rig, 0.02, bounds_m=session.room_bounds_m)
    carver = Carver(session.rig, grid)
    voxels = carver.carve(masks, n_faulty_views=0)
    is_surface = surface_voxels(voxels, grid)
    line = colour_hull(voxels, is_surface, grid, session.rig, images)
    buffer = colour_hull(voxels, is_surface, grid, session.rig, images, "zbuffer")
    pixels = carver.pixels(voxels)
    every = np.mean(
        [i.reshape(-1, 3)[np.maximum(p, 0)] for i, p in zip(images, pixels.T, strict=True)], axis=0
    )
    naive = type(line)(grid, voxels, is_surface, np.full(len(voxels), 7, np.uint8), every.astype(np.uint8))
    tiles, labels = [], []
    for c in (1, 4):
        camera = session.rig[c]
        window = person_window(camera, line.centers)
        tiles.append(crop(images[c], window, scale=1.8))
        labels.append(f"picture of {camera.name}")
        grey = np.full_like(images[c], 60)
        for hull, word in ((naive, "mean of all cameras"), (line, "line walk"), (buffer, "depth buffer")):
            tiles.append(crop(draw_hull(grey, camera, hull, colour_by="rgb"), window, scale=1.8))
            labels.append(word)
    return contact_sheet(tiles, labels, n_columns=4, width=820)


def furniture(root: Path) -> bytes:
    """What is learnt in two cameras, and the hull of one frame without and with it."""
    import matplotlib.pyplot as plt

    session = open_session(root)
    assert session.truth_dir is not None
    rig, every = session.rig, []
    for camera in rig:
        with np.load(session.truth_dir / "masks" / f"{camera.name}.npz", allow_pickle=False) as archive:
            every.append(np.unpackbits(archive["masks"], axis=2, count=camera.size[0]).view(np.bool_))
    frames = [list(masks) for masks in zip(*every, strict=True)]
    grid = choose_grid(rig, 0.025, bounds_m=session.room_bounds_m)
    occluders = learn_occluders(rig, grid, frames)
    with FrameReader(session.image_sources, rig, range(HIDDEN_FRAME, HIDDEN_FRAME + 1)) as reader:
        images = next(iter(reader))[1]
    true = read_landmarks_csv(session.truth_dir / "landmarks.csv")[0].landmarks[HIDDEN_FRAME]
    figure, axes = plt.subplots(1, 4, figsize=(11, 3.1), constrained_layout=True, width_ratios=[4, 4, 2, 2])
    for ax, c in zip(axes[:2], HIDING_CAMERAS, strict=True):
        grey = cv2.resize(cv2.cvtColor(images[c], cv2.COLOR_RGB2GRAY), None, fx=0.5, fy=0.5)
        ax.imshow(grey, cmap="gray", extent=(0, rig[c].size[0], rig[c].size[1], 0), vmax=255)
        depth = occluders.of(rig[c])
        assert depth is not None
        shown = np.where(np.isfinite(depth), depth, np.nan)
        picture = ax.imshow(
            shown,
            cmap="plasma",
            alpha=0.55,
            extent=(0, rig[c].size[0], rig[c].size[1], 0),
            vmin=1.0,
            vmax=5.0,
        )
        ax.set_title(f"{rig[c].name}: depth of what is learnt, m", fontsize=9)
        ax.axis("off")
    figure.colorbar(picture, ax=axes[1])
    for ax, known, word in zip(axes[2:], (None, occluders), ("ignored", "learnt"), strict=True):
        hull = Carver(rig, grid, occluders=known).carve(frames[HIDDEN_FRAME], n_faulty_views=0)
        at = grid.centers(hull)
        ax.scatter(at[:, 1], at[:, 2], s=1.5, color=COLOURS[5])
        ax.scatter(true[:, 1], true[:, 2], s=10, color=COLOURS[3], label="true landmarks")
        middle = true[:, 1].mean()
        ax.set(xlim=(middle - 0.5, middle + 0.5), ylim=(0.0, 2.0), aspect="equal")
        ax.set_title(f"hull, {word}", fontsize=9)
        ax.set_xlabel("y, m")
    axes[2].set_ylabel("z, m")
    axes[2].legend(fontsize=7, loc="upper left")
    return _png(figure)


def things(root: Path) -> NDArray[np.uint8]:
    """The empty room as some cameras see it, and what is found to stand in it."""
    from mocap.view import contact_sheet

    session = open_session(root)
    rig = session.rig
    empty = [
        empty_picture(learn_background(iter_clip(session.background_sources[camera.name]))) for camera in rig
    ]
    small = CameraRig(tuple(camera.reduced(EMPTY_REDUCTION) for camera in rig))
    points = things_on_floor(small, choose_grid(rig, 0.02, bounds_m=session.room_bounds_m), empty)
    found = painted(rig, points, VOXEL_M)
    tiles, labels = [], []
    for c in THINGS_CAMERAS:
        picture = empty[c][..., :3].copy()
        is_thing = np.isfinite(found.depth_m[rig[c].name]).astype(np.uint8)
        is_thing = cv2.resize(is_thing, picture.shape[1::-1], interpolation=cv2.INTER_NEAREST) > 0
        tinted = picture.copy()
        tinted[is_thing] = 0.5 * picture[is_thing] + [115, 40, 85]
        tiles += [picture, tinted]
        labels += [f"{rig[c].name}: the empty room", "what stands in it"]
    order = [*range(0, len(tiles), 2), *range(1, len(tiles), 2)]
    return contact_sheet([tiles[i] for i in order], [labels[i] for i in order], n_columns=3, width=800)


def _png(figure: Any) -> bytes:
    import matplotlib.pyplot as plt

    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=85)
    plt.close(figure)
    return buffer.getvalue()


def _write(name: str, data: bytes) -> None:
    if len(data) > MAX_BYTES:
        raise ValueError(f"{name} has {len(data)} bytes, more than {MAX_BYTES}")
    (PICTURES / name).write_bytes(data)
    print(f"{name}: {len(data) // 1000} kB")


def main() -> int:
    import matplotlib

    matplotlib.use("Agg")
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, default=Path("out/camera_faults"))
    work = parser.parse_args().work
    _write("volumes_policies.png", policies(work / "demo"))
    sheet = cv2.imencode(".png", visibility(work / "demo")[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])[1]
    _write("volumes_colour.png", sheet.tobytes())
    evidence = [
        watch(open_session(work / name), "images").evidence() for name in ("fault_moved", "fault_lag")
    ]
    _write("volumes_consistency.png", consistency(*evidence))
    _write("volumes_furniture.png", furniture(work / "furnished"))
    sheet = cv2.imencode(".png", things(work / "furnished_sit")[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])[
        1
    ]
    _write("volumes_things.png", sheet.tobytes())
    growth = Path(__file__).resolve().parents[1] / "eval" / "results" / "volume_growth.png"
    _write("volume_growth.png", growth.read_bytes())
    return 0


if __name__ == "__main__":
    sys.exit(main())

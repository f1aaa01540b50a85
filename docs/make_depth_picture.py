"""A hull with and without depth: docs/pictures/depth.png.

python -m docs.make_depth_picture
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from eval.whole import save_figure
from mocap.data import VoxelGrid
from mocap.data.depth import DepthNoise
from mocap.io.session import open_session
from mocap.io.session.reading import depth_of, masks_of
from mocap.io.truth import read_true_voxels
from mocap.synth import synthesise
from mocap.synth.scene import load_scene
from mocap.volume import Carver
from mocap.volume.depth import DepthView, is_free

PICTURE = Path(__file__).parent / "pictures" / "depth.png"
SCENE = "depth_walk"
CAMERAS = ("cam_0", "cam_2", "cam_3")
FRAME = 12
HEIGHTS_M = (1.15, 0.6)
GREY, BLUE = "#c9c9c9", "#2f6fb0"


def main() -> None:
    """Film, carve, draw."""
    scene = load_scene(SCENE)
    document = {**scene.model_dump(exclude_unset=True), "n_frames": FRAME + 1, "masks_only": True}
    with tempfile.TemporaryDirectory() as folder:
        root = synthesise(type(scene).model_validate(document), Path(folder) / "session", workers=1)
        session = open_session(root, frames=(FRAME, FRAME + 1))
        ((_, masks),) = masks_of(session)
        ((_, (depth_m,)),) = depth_of(session)
        true = read_true_voxels(root / "truth" / "voxels.npz")
        body = true.grid.centers(true.at(FRAME))
    rig = session.rig.subset(CAMERAS)
    assert session.room_bounds_m is not None
    grid = VoxelGrid.from_bounds(*(np.array(corner) for corner in session.room_bounds_m), 0.02)
    own = [masks[session.rig.names.index(name)] for name in CAMERAS]
    hull = Carver(rig, grid).carve(own, n_faulty_views=0)
    free = is_free(hull, grid, [DepthView(rig[CAMERAS[0]], depth_m, DepthNoise())])
    draw(depth_m, grid.centers(hull), grid.centers(hull[~free]), body)
    picture = cv2.imread(str(PICTURE))
    cv2.imwrite(str(PICTURE), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def draw(
    depth_m: NDArray[np.float32],
    hull: NDArray[np.float64],
    kept: NDArray[np.float64],
    body: NDArray[np.float64],
) -> None:
    """The map, and slices of the three volumes (N, 3) m from above."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(9.5, 3.7), layout="constrained")
    axes[0].imshow(np.where(depth_m > 0, depth_m, np.nan), cmap="viridis_r", vmin=2, vmax=6)
    axes[0].set(xticks=[], yticks=[], title="depth; white: no reading")
    middle = body.mean(axis=0)
    for ax, height_m in zip(axes[1:], HEIGHTS_M, strict=True):
        for points, colour in ((hull, GREY), (kept, BLUE), (body, "black")):
            layer = points[np.abs(points[:, 2] - height_m) < 0.011, :2] - middle[:2]
            ax.plot(*layer.T, "s", color=colour, markersize=3.4, markeredgewidth=0)
        ax.set(title=f"{height_m:g} m above the floor", xlabel="x, m", ylabel="y, m", aspect="equal")
        ax.set(xlim=(-0.5, 0.5), ylim=(-0.5, 0.5))
    save_figure(figure, PICTURE, dpi=90)
    plt.close(figure)


if __name__ == "__main__":
    main()

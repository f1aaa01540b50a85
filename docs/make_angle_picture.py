"""Draw the segment frames that anatomical angles are made of: pictures/angles.png.

python -m docs.make_angle_picture
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mocap.body import joint_transforms, landmarks_of, load_body_model, neutral_state, scale_body
from mocap.data import bones_between
from mocap.metrics.anatomy import ISB_FROM_OURS, segment_frames, segment_joints

if TYPE_CHECKING:
    from mocap.body import Body

Array = NDArray[np.float64]

PICTURE = Path(__file__).parent / "pictures" / "angles.png"
LENGTH_M = 0.16
COLOURS = ("#c0392b", "#27803b", "#1f5fa8")  # X, Y, Z
SIDES = {"left": "#1f77d0", "right": "#e07b00"}
STRIDE = {
    "root_yaw": 0.0,
    "left_hip_y": -0.55,
    "left_knee_y": 0.25,
    "right_hip_y": 0.25,
    "right_knee_y": 0.7,
    "left_shoulder_x": -1.35,
    "right_shoulder_x": 1.35,
    "left_elbow_z": -0.5,
    "right_elbow_z": 0.9,
    "waist_y": 0.08,
}
# Title, axis of the picture to the right, axis up; columns of the world and their signs.
VIEWS = (
    ("from the right", (0, 1.0), (2, 1.0)),
    ("from the front", (1, 1.0), (2, 1.0)),
)


def main() -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from PIL import Image

    body = scale_body(load_body_model("whole"), 1.75)
    poses = []
    for changes in ({}, STRIDE):
        state = neutral_state(body)
        if not changes:
            for side, down in (("right", np.pi / 2), ("left", -np.pi / 2)):
                state[body.layout.names.index(f"{side}_shoulder_x")] = down
                state[body.layout.names.index(f"{side}_elbow_z")] = 0.0
        for name, value in changes.items():
            state[body.layout.names.index(name)] = value
        poses.append(state)
    figure, axes = plt.subplots(1, 3, figsize=(11.5, 6.4), dpi=100, layout="constrained")
    for ax, state, view, words in zip(
        axes,
        (poses[0], poses[0], poses[1]),
        (VIEWS[0], VIEWS[1], VIEWS[0]),
        ("standing: all angles 0", "standing: all angles 0", "a stride"),
        strict=True,
    ):
        _draw(ax, body, state, view)
        ax.set_title(f"{words}\n{view[0]}", fontsize=11, y=0.97)
    handles = [plt.Line2D([], [], color=c, lw=2.5) for c in COLOURS]
    labels = ["X, forward", "Y, to the body's upper end", "Z, to the right"]
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=11)
    figure.savefig(PICTURE)
    plt.close(figure)
    with Image.open(PICTURE) as drawn:
        drawn.convert("RGB").quantize(48).save(PICTURE, optimize=True)  # flat colours: half the size


def _draw(ax: Any, body: Body, state: Array, view: tuple[str, tuple[int, float], tuple[int, float]]) -> None:
    """The skeleton of one pose, seen along an axis, with the frame of every segment at its joint."""
    (_, (right, right_sign), (up, up_sign)) = view

    def flat(points: Array) -> Array:
        return np.stack([right_sign * points[..., right], up_sign * points[..., up]], axis=-1)

    marks = landmarks_of(body, state[None])[0]
    for start, end in bones_between(len(marks)):
        side = body.landmarks[end].partition("_")[0]
        ends = flat(marks[[start, end]])
        ax.plot(*ends.T, color=SIDES.get(side, "#555555"), lw=5, alpha=0.35, solid_capstyle="round")
    R, t = joint_transforms(body, state[None])
    frames = segment_frames(body.joints, body.offset, R, body.standing_pitch)
    for segment, joint in segment_joints(body.joints).items():
        origin = flat(t[0, joint])
        axes = LENGTH_M * (frames[segment][0] @ ISB_FROM_OURS.T).T
        for axis, colour in zip(axes, COLOURS, strict=True):
            tip = flat(axis)
            if np.hypot(*tip) < 0.15 * LENGTH_M:  # towards or away from the eye
                ax.plot(*origin, "o", color=colour, ms=6, mfc="white", mew=1.6, zorder=4)
                continue
            ax.annotate(
                "",
                origin + tip,
                origin,
                arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.8, "shrinkA": 0, "shrinkB": 0},
            )
    ax.set_aspect("equal")
    ax.set_xlim(-0.62, 0.62)
    ax.set_ylim(-0.02, 1.86)
    ax.axis("off")


if __name__ == "__main__":
    main()

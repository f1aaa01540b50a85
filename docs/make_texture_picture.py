"""The colours that `--preset best` has learnt, on the body that has learnt them: docs/pictures/texture.jpg.

python -m docs.make_texture_picture [--work out/texture]

Films a synthetic dancer, runs the preset up to the poses and teaches the colours of places by these poses, as the pass
does it.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mocap.arrays import Array, Image
from mocap.body import Body, cones_of, joint_transforms
from mocap.data import Camera
from mocap.io.session import open_session
from mocap.io.session.reading import pictures_of
from mocap.io.store import StageStore
from mocap.likelihood.colours._kernels import see_cones
from mocap.likelihood.residuals import Texture
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session
from mocap.pipeline.stage import Job
from mocap.pipeline.stages.pose import PoseWork
from mocap.pose.deviation import FrameSeries
from mocap.pose.person import VolumeClip
from mocap.pose.texture import texture_of
from mocap.pose.volume import VolumeObservation
from mocap.products.poses import stored_poses
from mocap.synth import synthesise
from mocap.synth.scene import load_scene
from mocap.view import crop, person_window

PICTURE = Path(__file__).parent / "pictures" / "texture.jpg"
SCENE, N_FRAMES, FRAME = "dance_test", 90, 40
CAMERAS = (1, 4)
ASPECT = 0.55
HEIGHT_PX, QUALITY = 420, 74
MARGIN = 0.02
BACKGROUND, UNKNOWN = 255, 150


def main() -> None:
    """Film, run, learn, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--work", type=Path, default=Path("out/texture"), help="session and run go there")
    work = parser.parse_args().work
    if not (work / "session").exists():
        synthesise(load_scene(SCENE).model_copy(update={"n_frames": N_FRAMES}), work / "session")
    config = load_config("best", ("output.formats=[]",))
    run_session(work / "session", work / "result", config=config, seed=0, resume=True, until="pose")

    session, store = open_session(work / "session"), StageStore(work / "result" / "store.zarr")
    (poses,) = stored_poses(store)
    stage = PoseWork(Job(session, config, store, seed=0))
    tools = stage.tools(poses.height.height_m, 1).with_body(poses.body)
    observation = VolumeObservation(
        tools, stage.hull_of(poses.person), pictures_of=partial(pictures_of, session)
    )
    series = FrameSeries.of_length(len(poses.frames), poses.body)
    series.states[:] = poses.states
    path = np.zeros((len(poses.frames), 3))
    texture = texture_of(VolumeClip(poses.person, poses.frames, path, observation), observation, series)
    state = poses.states[poses.frames == FRAME][0]
    with pictures_of(session, [FRAME]) as reader:
        ((_, pictures),) = reader
    panels = []
    for c in CAMERAS:
        camera = session.rig[c]
        window = person_window(
            camera, poses.landmarks[poses.frames == FRAME][0], margin=MARGIN, aspect=ASPECT
        )
        for image in (pictures[c], worn(texture, poses.body, state, camera)):
            panels.append(_scaled(crop(image, window)))
    sheet = np.hstack(panels)
    cv2.imwrite(str(PICTURE), sheet[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])


def worn(texture: Texture, body: Body, state: Array, camera: Camera) -> Image:
    """(H, W, 3) RGB, the body in a pose (D,) in the colours that its places have; grey where none is known."""
    width, height = camera.size
    uv = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2)
    directions, n = camera.rays(uv.astype(np.float64)), width * height
    columns = np.concatenate([np.tile(camera.center[:, None], n), directions.T]).astype(np.float32)
    depth, miss = np.full(n, np.inf, np.float32), np.zeros(n, np.float32)
    cone, along = np.full(n, -1, np.int32), np.zeros(n, np.float32)
    start, end = cones_of(body, state)
    see_cones(columns, start, end, body.cones.radii, depth, miss, cone, along)
    seen = np.isfinite(depth) & (cone >= 0)
    joint = body.cones.joint[cone[seen]]
    R, t = joint_transforms(body, state[None])
    places = camera.center + depth[seen, None] * directions[seen]
    local = np.einsum("mji,mj->mi", R[0, joint], places - t[0, joint])
    rgb = np.full((n, 3), BACKGROUND, np.uint8)
    rgb[seen] = _colours(texture, joint, local)
    return rgb.reshape(height, width, 3)


def _colours(texture: Texture, joint: NDArray[np.int64], local: Array) -> NDArray[np.uint8]:
    """(N, 3) RGB of points (N, 3) m in the frames of joints (N,): of the known place that is nearest."""
    known = texture.terms.inverse.any(axis=1)
    out = np.full((len(local), 3), UNKNOWN, np.uint8)
    for j in np.unique(joint):
        own, on = np.flatnonzero(known & (texture.places.joint == j)), joint == j
        if len(own):
            nearest = own[cKDTree(texture.places.points[own]).query(local[on])[1]]
            mean = texture.terms.mean[nearest].astype(np.uint8)
            out[on] = cv2.cvtColor(mean[None], cv2.COLOR_YCrCb2RGB)[0]
    return out


def _scaled(image: Image) -> Image:
    width = round(image.shape[1] * HEIGHT_PX / image.shape[0])
    return np.asarray(cv2.resize(image, (width, HEIGHT_PX), interpolation=cv2.INTER_AREA), dtype=np.uint8)


if __name__ == "__main__":
    main()

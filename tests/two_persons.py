"""A small session of two persons, as true silhouettes, and a run on it."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest
from small_session import CAMERAS, FPS, PLAIN, SIZE, copy_session

from mocap.io.store import StageStore
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session

N_FRAMES = 10
# Small pictures show neither feet nor how a spine bends: what is done by hand is tested on a body without. Nor do they
# show girths, and pieces of a recording that fit them for themselves differ by what they fit.
BODY = ("body.model=girdle", "method.size.own_girth=9")
SETTINGS = (*PLAIN, "output.formats=[]", "pose.look_again=false", *BODY)
CONFIG = load_config("default", SETTINGS)


@cache
def two_persons_session(base: Path, n_frames: int = N_FRAMES) -> Path:
    """Two people who stand apart and move their arms; made once in a process. Never change it: copy it."""
    pytest.importorskip("embreex", reason="rendering needs the extra synth (embreex)")
    from mocap.synth import synthesise
    from mocap.synth.scene import scene_from_dict

    scene = {
        "name": "two",
        "seed": 22,
        "n_frames": n_frames,
        "fps": FPS,
        "n_background_frames": 2,
        "rig": {"n_cameras": len(CAMERAS), "size_px": list(SIZE)},
        "room": {"capture_m": [[-1.6, -1.4, 0.0], [1.6, 1.4, 2.1]]},
        "persons": [
            {"seed": 5, "motion": {"kind": "walk", "center_m": [-0.8, 0.0], "radii_m": [0.3, 0.4]}},
            {"seed": 6, "motion": {"kind": "walk", "center_m": [0.8, 0.0], "radii_m": [0.3, 0.4]}},
        ],
    }
    folder = base / f"two_persons_{n_frames}"
    made = synthesise(scene_from_dict(scene), folder / "made", workers=1)
    return copy_session(made, folder / "session", masks=True)


@cache
def two_persons_run(base: Path) -> Path:
    """A run on it. Never change it: copy it."""
    out = base / f"two_persons_{N_FRAMES}" / "out"
    run_session(two_persons_session(base), out, config=CONFIG)
    return out


def exchange_tracks(out: Path, frames: range) -> None:
    """Exchange persons 1 and 2 over some frames in the store of a run, as a tracker that took one for the other."""
    store = StageStore(out / "store.zarr")
    for product, column in (("track", "person"), ("track-owners", "owner")):
        reader = store.reader(product)
        rows = [(frame, arrays) for frame, arrays in reader]
        with store.writer(product, reader.key, reader.attrs) as writer:
            for frame, arrays in rows:
                if frame in frames:
                    names = arrays[column]
                    arrays[column] = names.copy()
                    arrays[column][names == 1], arrays[column][names == 2] = 2, 1
                writer.append(frame, **arrays)
    for product in ("pose", "pose-frames"):
        store.remove(product)

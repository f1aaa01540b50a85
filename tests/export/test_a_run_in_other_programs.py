"""A run's files in the programs that they are for: each shows the landmarks where landmarks.csv has them.

Programs that are not installed are skipped. Blender 5.0 (bpy; USD through usd-core 26.11), ezc3d 1.7, OpenSim 4.6,
movement 0.15 and pandas have passed; the largest differences are in outputs.md.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from keypoint_world import FPS, keypoint_world, write_keypoint_session
from numpy.typing import NDArray
from small_session import mocap, set_options

from mocap.data import Motion
from mocap.io.tables import read_landmarks_csv

Array = NDArray[np.float64]
# Landmarks that lie on a joint of the armature, with its bone.
JOINTS = {
    f"{side}_{landmark}": f"{side}_{landmark}"
    for side in ("left", "right")
    for landmark in ("shoulder", "elbow", "hip", "knee")
}
TOLERANCE_MM = 0.1
N_FRAMES = 8

BLENDER = """
import bpy, json, sys
path, kind, fps, n = sys.argv[1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = int(float(fps))
if kind == "bvh":
    bpy.ops.import_anim.bvh(filepath=path, global_scale=0.01)
elif kind == "glb":
    bpy.ops.import_scene.gltf(filepath=path)
else:
    bpy.ops.wm.usd_import(filepath=path)
armature = next(o for o in bpy.data.objects if o.type == "ARMATURE")
found = []
for frame in range(int(n)):
    bpy.context.scene.frame_set(frame + (kind == "bvh"))
    found.append({b.name: list(armature.matrix_world @ b.head) for b in armature.pose.bones})
print("FOUND" + json.dumps(found))
"""


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Motion]:
    """A folder with every format of a run on today's default body, and its landmarks."""
    root = tmp_path_factory.mktemp("programs")
    session = write_keypoint_session(keypoint_world(N_FRAMES, noise_px=1.0), root / "session")
    brief = ("output.formats=[]", "pose.n_start_frames=1", "pose.n_particles=40")
    said = mocap("run", session, "-o", root / "out", *set_options(brief))
    assert said.code == 0, said.err
    formats = ["bvh", "glb", "trc", "mot", "nc", "bids"]
    formats += ["usd"] if importlib.util.find_spec("pxr") else []
    formats += ["c3d"] if importlib.util.find_spec("ezc3d") else []
    for name in formats:
        said = mocap(
            "export", root / "out", "--what", "motion", "--format", name, "-o", root / "files" / name
        )
        assert said.code == 0, said.err
    (motion,) = read_landmarks_csv(root / "out" / "landmarks.csv")
    return root / "files", motion


def in_blender(files: Path, kind: str) -> dict[str, Array]:
    """Bone -> places of its head, (T, 3) m."""
    (path,) = (files / kind).glob(f"*.{kind}")
    said = subprocess.run(
        [sys.executable, "-c", BLENDER, str(path), kind, str(FPS), str(N_FRAMES)],
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    frames = json.loads(said.stdout.split("FOUND")[1].splitlines()[0])
    return {bone: np.array([frame[bone] for frame in frames]) for bone in frames[0]}


def in_ezc3d(files: Path) -> dict[str, Array]:
    import ezc3d

    (path,) = (files / "c3d").glob("*.c3d")
    c3d = ezc3d.c3d(str(path))
    names = c3d["parameters"]["POINT"]["LABELS"]["value"]
    return {name: c3d["data"]["points"][:3, k].T / 1000.0 for k, name in enumerate(names)}


def in_opensim(files: Path) -> dict[str, Array]:
    """The TRC as OpenSim's own table; scene (x, y, z) = file (z, x, y)."""
    import opensim

    (path,) = (files / "trc").glob("*.trc")
    table = opensim.TimeSeriesTableVec3(str(path))
    rows = [table.getRowAtIndex(k) for k in range(table.getNumRows())]
    found = {}
    for j, name in enumerate(table.getColumnLabels()):
        places = np.array([[row[j][i] for i in range(3)] for row in rows])
        found[name] = places[:, [2, 0, 1]]
    return found


def in_movement(files: Path) -> dict[str, Array]:
    import xarray
    from movement.validators.datasets import ValidPosesInputs

    with xarray.open_dataset(files / "nc" / "motion.nc") as dataset:
        ValidPosesInputs.validate(dataset)
        own = dataset.position.isel(individuals=0).transpose("keypoints", "time", "space").values
        return {str(name): own[k] for k, name in enumerate(dataset.keypoints.values)}


def in_bids(files: Path) -> dict[str, Array]:
    import pandas

    (path,) = (files / "bids").rglob("*_motion.tsv")
    columns = pandas.read_csv(str(path).replace("_motion.tsv", "_channels.tsv"), sep="\t").name
    table = pandas.read_csv(path, sep="\t", header=None, names=list(columns), na_values="n/a")
    names = {name[:-2] for name in columns if name.endswith("_x")}
    return {name: table[[f"{name}_{axis}" for axis in "xyz"]].to_numpy() for name in names}


# What is opened -> (packages it takes, how it is read, names of landmarks there, None = their own).
READERS: dict[str, tuple[tuple[str, ...], Callable[[Path], dict[str, Array]], dict[str, str] | None]] = {
    "blender-bvh": (("bpy",), lambda files: in_blender(files, "bvh"), JOINTS),
    "blender-glb": (("bpy",), lambda files: in_blender(files, "glb"), JOINTS),
    "blender-usd": (("bpy", "pxr"), lambda files: in_blender(files, "usd"), JOINTS),
    "ezc3d": (("ezc3d",), in_ezc3d, None),
    "opensim-trc": (("opensim",), in_opensim, None),
    "movement": (("movement", "xarray"), in_movement, None),
    "bids": (("pandas",), in_bids, None),
}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # programs of others warn of their own affairs when they are imported
@pytest.mark.parametrize("program", READERS)
def test_the_program_shows_the_landmarks_where_they_are(exported: tuple[Path, Motion], program: str) -> None:
    packages, read, names = READERS[program]
    for package in packages:
        pytest.importorskip(package, reason=f"{package} is not installed")
    files, motion = exported
    found = read(files)
    compared = names or {name: name for name in motion.names}
    errors_mm = [
        1000.0 * np.abs(found[there][:N_FRAMES] - motion.landmarks[:, motion.names.index(ours)]).max()
        for ours, there in compared.items()
    ]
    print(f"\n{program}: {max(errors_mm):.4f} mm at most in {len(compared)} points")
    assert max(errors_mm) < TOLERANCE_MM

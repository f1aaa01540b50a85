"""Meshes read back by trimesh's readers and by the glTF specification."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from mocap.data import ColouredMesh
from mocap.errors import MocapError
from mocap.io.formats import write_mesh

TETRAHEDRON = ColouredMesh(
    np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.7, 0.0], [0.0, 0.0, 1.1]]),
    np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]),
    np.array([[255, 0, 0], [188, 188, 188], [0, 255, 0], [0, 0, 0]], dtype=np.uint8),
)
EMPTY = ColouredMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros((0, 3), np.uint8))


def test_ply_holds_the_world_and_srgb(tmp_path: Path) -> None:
    write_mesh(tmp_path / "a.ply", TETRAHEDRON)
    found = trimesh.load(tmp_path / "a.ply", process=False)
    np.testing.assert_allclose(found.vertices, TETRAHEDRON.vertices, atol=1e-6)
    np.testing.assert_array_equal(found.faces, TETRAHEDRON.faces)
    np.testing.assert_array_equal(found.visual.vertex_colors[:, :3], TETRAHEDRON.rgb)


def test_glb_has_y_up_and_linear_colours(tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    write_mesh(path, TETRAHEDRON)
    found = trimesh.load(path, force="mesh", process=False)
    # Blender's turn of y up to z up gives the world back.
    np.testing.assert_allclose(
        np.asarray(found.vertices)[:, [0, 2, 1]] * [1, -1, 1], TETRAHEDRON.vertices, atol=1e-6
    )
    assert found.volume == pytest.approx(0.5 * 0.7 * 1.1 / 6)
    data = path.read_bytes()
    n_text = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + n_text])
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    view = document["bufferViews"][accessor["bufferView"]]
    start = 28 + n_text + view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    rgba = np.frombuffer(data, np.uint8, 16, start).reshape(4, 4)
    # sRGB 188 is half of the light.
    np.testing.assert_array_equal(rgba[:, :3], [[255, 0, 0], [128, 128, 128], [0, 255, 0], [0, 0, 0]])


@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_same_mesh_same_bytes_and_an_empty_one_is_no_error(tmp_path: Path, suffix: str) -> None:
    first, second = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    write_mesh(first, TETRAHEDRON)
    write_mesh(second, TETRAHEDRON)
    assert first.read_bytes() == second.read_bytes()
    write_mesh(first, EMPTY)
    if suffix == ".ply":
        assert b"element vertex 0" in first.read_bytes()
    else:
        assert len(trimesh.load(first, force="scene").geometry) == 0


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(MocapError, match="cannot write the file"):
        write_mesh(tmp_path / "missing" / "a.ply", TETRAHEDRON)

"""The map of the paths: an SVG file that any reader of XML takes, with everything where it is."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import view_world as world

from mocap.data import CameraRig, Tracks
from mocap.view import track_map_svg

T = 23
BOUNDS = ((-2.0, -1.5, 0.0), (2.0, 1.5, 2.2))
SVG = "{http://www.w3.org/2000/svg}"


def square() -> Tracks:
    """One person on the way from (0, 0) to (1, 0) to (1, 2), out of sight in the middle."""
    xyz = np.array([[0.0, 0, 1], [1, 0, 1], [1, 2, 1]])
    frame = np.arange(3)
    observed = np.array([True, False, True])
    return Tracks(frame, np.ones(3, np.int64), frame / 30, xyz, observed=observed)


def parsed(svg: bytes) -> ElementTree.Element:
    root = ElementTree.fromstring(svg)
    assert root.tag == SVG + "svg"
    assert "nan" not in svg.decode()
    return root


def places(path: str) -> np.ndarray:
    return np.array(re.findall(r"(-?[\d.]+) (-?[\d.]+)", path), dtype=np.float64)


def test_a_path_has_the_shape_of_its_places_and_y_points_up():
    root = parsed(track_map_svg(world.rig(), square(), bounds_m=BOUNDS))
    (line,) = [
        p for p in root.iter(SVG + "path") if p.get("stroke-width") == "2.6" and "h24" not in p.get("d")
    ]
    a, b, c = places(line.get("d"))
    scale = b[0] - a[0]
    assert scale > 50  # px of a metre
    np.testing.assert_allclose(b - a, [scale, 0.0], atol=0.11)
    np.testing.assert_allclose(c - b, [0.0, -2 * scale], atol=0.11)
    (dot,) = [p for p in root.iter(SVG + "path") if p.get("stroke") == "white"]
    np.testing.assert_allclose(places(dot.get("d")[1:-2]), [b], atol=0.11)
    (start,) = root.iter(SVG + "circle")
    np.testing.assert_allclose([float(start.get("cx")), float(start.get("cy"))], a, atol=0.11)


def test_unknown_places_are_gaps_and_long_paths_stay_small():
    xyz = np.ones((T, 3))
    xyz[:, 0] = np.linspace(0, 1, T)
    xyz[7:9] = np.nan
    frame = np.arange(T)
    known = parsed(track_map_svg(world.rig(), None, Tracks(frame, np.ones(T, np.int64), frame / 30, xyz)))
    (line,) = [p for p in known.iter(SVG + "path") if p.get("stroke-dasharray") and "h24" not in p.get("d")]
    assert line.get("d").count("M") == 2
    assert len(places(line.get("d"))) == T - 2
    n = 100_000
    frame = np.arange(n)
    long = Tracks(frame, np.ones(n, np.int64), frame / 30, np.ones((n, 3)), observed=np.zeros(n, dtype=bool))
    assert len(track_map_svg(world.rig(), long)) < 80_000


def test_nobody_and_odd_names():
    none = Tracks(np.zeros(0, int), np.zeros(0, int), np.zeros(0), np.zeros((0, 3)))
    empty = track_map_svg(world.rig(), none, bounds_m=BOUNDS)
    assert track_map_svg(world.rig(), None, bounds_m=BOUNDS) == empty
    assert not list(parsed(empty).iter(SVG + "circle"))
    odd = ("<&>", "\x01\x1b", "\udcff")
    rig = CameraRig(tuple(replace(c, name=name) for c, name in zip(world.rig(), odd, strict=True)))
    texts = [t.text for t in parsed(track_map_svg(rig, None)).iter(SVG + "text")]
    assert "<&>" in texts


def test_a_map_needs_no_plotting_library():
    code = "import sys; sys.path.insert(0, 'tests/view'); import view_world; from mocap.view import track_map_svg; "
    code += "track_map_svg(view_world.rig(), None); print('matplotlib' in sys.modules)"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "False"

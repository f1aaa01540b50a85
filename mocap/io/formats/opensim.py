"""Files for OpenSim: the scaled model, its marker set, and set-up files of inverse kinematics and scaling."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from mocap.arrays import Array
from mocap.data.opensim import OpenSimBody
from mocap.io.formats._writing import write_bytes

_VERSION = "40000"
_FREE = ("pelvis_tx", "pelvis_ty", "pelvis_tz")
# Mean of adults: inertias play no part in kinematics, OpenSim wants them.
_MASS_KG = 75.0
# Measurement of the scaling -> landmarks at both ends, and the bodies of the common models that it scales.
_MEASUREMENTS: dict[str, tuple[tuple[tuple[str, str], ...], tuple[str, ...]]] = {
    "torso": ((("SIDE_shoulder", "SIDE_hip"),), ("torso",)),
    "pelvis": ((("left_hip", "right_hip"),), ("pelvis",)),
    "thigh": ((("SIDE_hip", "SIDE_knee"),), ("femur_r", "femur_l")),
    "shank": ((("SIDE_knee", "SIDE_ankle"),), ("tibia_r", "tibia_l")),
    "foot": ((("SIDE_heel", "SIDE_toe"),), ("talus_r", "calcn_r", "toes_r", "talus_l", "calcn_l", "toes_l")),
    "upper_arm": ((("SIDE_shoulder", "SIDE_elbow"),), ("humerus_r", "humerus_l")),
    "forearm": (
        (("SIDE_elbow", "SIDE_wrist"),),
        ("ulna_r", "radius_r", "hand_r", "ulna_l", "radius_l", "hand_l"),
    ),
}
GENERIC_MODEL = "generic.osim"


def write_osim(path: Path, bodies: Sequence[OpenSimBody]) -> None:
    """Write a model: bodies, joints with their coordinates, markers; no muscles, no geometry.

    Raises MocapError when the file cannot be written.
    """
    path = Path(path)
    model = ElementTree.Element("Model", name=path.stem)
    ElementTree.SubElement(model, "Ground", name="ground")
    _text(model, "gravity", "0 -9.80665 0")
    of_bodies, of_joints = _set(model, "BodySet", "bodyset"), _set(model, "JointSet", "jointset")
    for body in bodies:
        mass = body.mass_share * _MASS_KG
        node = ElementTree.SubElement(of_bodies, "Body", name=body.name)
        _text(node, "mass", f"{mass:.4f}")
        _text(node, "mass_center", "0 0 0")
        _text(node, "inertia", f"{0.01 * mass:.5f} {0.01 * mass:.5f} {0.01 * mass:.5f} 0 0 0")
        _joint(of_joints, body)
    _markers(_set(model, "MarkerSet", "markerset"), bodies)
    _write(path, model)


def write_marker_set(path: Path, bodies: Sequence[OpenSimBody]) -> None:
    """Write the markers alone, to be put on a model whose bodies have the same names."""
    node = ElementTree.Element("MarkerSet", name="markerset")
    _markers(ElementTree.SubElement(node, "objects"), bodies)
    _write(Path(path), node)


def write_ik_setup(
    path: Path,
    *,
    model: str,
    trc: str,
    coordinates: str,
    motion: str,
    markers: Sequence[str],
    held: Mapping[str, float],
    time_s: Array,
) -> None:
    """Write the set-up of inverse kinematics.

    model, trc, coordinates, motion : names of files beside it, the last is its result.  markers : those that pull.
    held : coordinate -> weight, for those that are drawn to `coordinates` because no marker shows them.
    time_s : (T,) of the motion.
    """
    tool = ElementTree.Element("InverseKinematicsTool", name=Path(path).stem)
    _text(tool, "results_directory", "./")
    _text(tool, "model_file", model)
    _text(tool, "accuracy", "1e-05")
    _text(tool, "time_range", f"{time_s[0]:.6f} {time_s[-1]:.6f}")
    _text(tool, "output_motion_file", motion)
    _text(tool, "report_errors", "true")
    tasks = _set(tool, "IKTaskSet", "")
    for marker in markers:
        task = ElementTree.SubElement(tasks, "IKMarkerTask", name=marker)
        _text(task, "apply", "true")
        _text(task, "weight", "1")
    for coordinate, weight in held.items():
        task = ElementTree.SubElement(tasks, "IKCoordinateTask", name=coordinate)
        _text(task, "apply", "true")
        _text(task, "weight", f"{weight:g}")
        _text(task, "value_type", "from_file")
    _text(tool, "marker_file", trc)
    _text(tool, "coordinate_file", coordinates)
    _write(Path(path), tool)


def write_scale_setup(
    path: Path,
    *,
    markers: str,
    trc: str,
    scaled: str,
    names: Mapping[str, str],
    height_m: float,
    time_s: Array,
) -> None:
    """Write the set-up that scales a model of one's own, which it expects as `generic.osim` beside it.

    markers, trc, scaled : names of files beside it, the last is its result.  names : landmark -> marker.
    """
    tool = ElementTree.Element("ScaleTool", name=Path(path).stem)
    _text(tool, "mass", f"{_MASS_KG:g}")
    _text(tool, "height", f"{1000 * height_m:.0f}")
    maker = ElementTree.SubElement(tool, "GenericModelMaker")
    _text(maker, "model_file", GENERIC_MODEL)
    _text(maker, "marker_set_file", markers)
    scaler = ElementTree.SubElement(tool, "ModelScaler")
    _text(scaler, "apply", "true")
    _text(scaler, "scaling_order", "measurements")
    measured = _set(scaler, "MeasurementSet", "")
    for name, (pairs, bodies) in _MEASUREMENTS.items():
        _measurement(measured, name, _marker_pairs(pairs, names), bodies)
    _text(scaler, "marker_file", trc)
    _text(scaler, "time_range", f"{time_s[0]:.6f} {time_s[-1]:.6f}")
    _text(scaler, "preserve_mass_distribution", "true")
    _text(scaler, "output_model_file", scaled)
    placer = ElementTree.SubElement(tool, "MarkerPlacer")
    _text(placer, "apply", "false")
    _write(Path(path), tool)


def _marker_pairs(pairs: Sequence[tuple[str, str]], names: Mapping[str, str]) -> list[str]:
    """Pairs of markers, of both sides where the landmarks have sides, as far as the set has both."""
    found = []
    for pair in pairs:
        for side in ("right", "left") if "SIDE" in pair[0] else ("",):
            first, second = (names.get(landmark.replace("SIDE", side)) for landmark in pair)
            if first and second:
                found.append(f"{first} {second}")
    return found


def _measurement(parent: ElementTree.Element, name: str, pairs: Sequence[str], bodies: Sequence[str]) -> None:
    if not pairs:
        return
    node = ElementTree.SubElement(parent, "Measurement", name=name)
    _text(node, "apply", "true")
    of_pairs = _set(node, "MarkerPairSet", "")
    for pair in pairs:
        _text(ElementTree.SubElement(of_pairs, "MarkerPair"), "markers", pair)
    of_bodies = _set(node, "BodyScaleSet", "")
    for body in bodies:
        _text(ElementTree.SubElement(of_bodies, "BodyScale", name=body), "axes", "X Y Z")


def _joint(parent: ElementTree.Element, body: OpenSimBody) -> None:
    """A joint with up to three rotations, and three translations for what hangs on the ground."""
    is_free = body.parent == "ground"
    node = ElementTree.SubElement(parent, "CustomJoint", name=f"{body.parent}_{body.name}")
    _text(node, "socket_parent_frame", f"{body.parent}_offset")
    _text(node, "socket_child_frame", f"{body.name}_offset")
    coordinates = ElementTree.SubElement(node, "coordinates")
    turning = [name for name, _ in body.rotations if name]
    for name in [*turning, *(_FREE if is_free else ())]:
        reach = 50.0 if name in _FREE else 2 * np.pi
        coordinate = ElementTree.SubElement(coordinates, "Coordinate", name=name)
        _text(coordinate, "default_value", "0")
        _text(coordinate, "range", f"{-reach:.6f} {reach:.6f}")
    frames = ElementTree.SubElement(node, "frames")
    places = ((body.parent, body.location), (body.name, np.zeros(3)))
    for name, location in places:
        frame = ElementTree.SubElement(frames, "PhysicalOffsetFrame", name=f"{name}_offset")
        _text(frame, "socket_parent", "/ground" if name == "ground" else f"/bodyset/{name}")
        _text(frame, "translation", _numbers(location))
        _text(frame, "orientation", "0 0 0")
    transform = ElementTree.SubElement(node, "SpatialTransform")
    for k, (name, axis) in enumerate(body.rotations):
        _axis(transform, f"rotation{k + 1}", name, axis)
    for k in range(3):
        _axis(transform, f"translation{k + 1}", _FREE[k] if is_free else "", tuple(np.eye(3)[k]))


def _axis(parent: ElementTree.Element, name: str, coordinate: str, axis: Sequence[float]) -> None:
    node = ElementTree.SubElement(parent, "TransformAxis", name=name)
    _text(node, "coordinates", coordinate)
    _text(node, "axis", _numbers(axis))
    if coordinate:
        _text(ElementTree.SubElement(node, "LinearFunction", name="function"), "coefficients", "1 0")
    else:
        _text(ElementTree.SubElement(node, "Constant", name="function"), "value", "0")


def _markers(parent: ElementTree.Element, bodies: Sequence[OpenSimBody]) -> None:
    for body in bodies:
        for name, location in body.markers.items():
            node = ElementTree.SubElement(parent, "Marker", name=name)
            _text(node, "socket_parent_frame", f"/bodyset/{body.name}")
            _text(node, "location", _numbers(location))
            _text(node, "fixed", "true")


def _set(parent: ElementTree.Element, kind: str, name: str) -> ElementTree.Element:
    node = ElementTree.SubElement(parent, kind, {"name": name} if name else {})
    return ElementTree.SubElement(node, "objects")


def _text(parent: ElementTree.Element, name: str, text: str) -> None:
    ElementTree.SubElement(parent, name).text = text


def _numbers(values: Sequence[float] | Array) -> str:
    return " ".join(f"{float(v) + 0.0:.6f}" for v in values)


def _write(path: Path, content: ElementTree.Element) -> None:
    document = ElementTree.Element("OpenSimDocument", Version=_VERSION)
    document.append(content)
    ElementTree.indent(document)
    write_bytes(path, ElementTree.tostring(document, encoding="utf-8", xml_declaration=True) + b"\n")

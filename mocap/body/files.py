"""The body of one person as a body file: what a run has sized, to be used again."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable

from mocap.arrays import Array
from mocap.body.model import Body, BodyModel, JointSpec, PartSpec

_DIGITS = 6  # of fractions of the height: some micrometres
_HEIGHT_DIGITS = 4


def model_of(body: Body, model: BodyModel) -> BodyModel:
    """The body file's content of a person's body, `height_m` included.

    model : the body file that the body came from; joints, rotations and names are taken from it, lengths and radii from
    the body. Lengths are rounded to micrometres, the height to a tenth of a millimetre, so that a body which is read
    and written again gives the same file.
    Raises ValueError when the body does not come from the model.
    """
    n_cones = [len(p.cones) for p in model.part]
    if body.joints != tuple(j.name for j in model.joint) or len(body.cones.joint) != sum(n_cones):
        raise ValueError(f"the body {body.name} does not come from the model {model.name}")
    height = round(body.height_m, _HEIGHT_DIGITS)
    own = iter(range(len(body.cones.joint)))
    parts = []
    for part in model.part:
        cones = []
        for cone in part.cones:
            k = next(own)
            cones.append(
                cone.model_copy(
                    update={
                        "start": _fractions(body.cones.start[k], body.height_m),
                        "end": _fractions(body.cones.end[k], body.height_m),
                        "radii": _fractions(body.cones.radii[k], body.height_m),
                    }
                )
            )
        parts.append(part.model_copy(update={"cones": tuple(cones)}))
    joints = [
        joint.model_copy(update={"offset": _fractions(offset, body.height_m)})
        for joint, offset in zip(model.joint, body.offset, strict=True)
    ]
    landmarks = {
        name: model.landmarks[name].model_copy(
            update={"offset": _fractions(body.landmark_offset[m], body.height_m)}
        )
        for m, name in enumerate(body.landmarks)
    }
    return model.model_copy(
        update={"height_m": height, "joint": tuple(joints), "part": tuple(parts), "landmarks": landmarks}
    )


def body_toml(model: BodyModel, comment: str = "") -> str:
    """A body model as the text of a body file, which `load_body_model` reads back.  comment : put at the top."""
    lines = [f"# {line}".rstrip() for line in comment.splitlines()]
    lines += [f"name = {_text(model.name)}", f"source = {_text(model.source)}"]
    if model.height_m is not None:
        lines.append(f"height_m = {_number(model.height_m)}")
    lines += [f"round_ends = {_bool(model.round_ends)}", f"exclusive = {_bool(model.exclusive)}"]
    for joint in model.joint:
        lines += _joint_lines(joint)
    for part in model.part:
        lines += _part_lines(part)
    lines += ["", "[landmarks]"]
    lines += [
        f"{name} = {{ joint = {_text(mark.joint)}, offset = {_list(mark.offset)} }}"
        for name, mark in model.landmarks.items()
    ]
    return "\n".join(lines) + "\n"


def _joint_lines(joint: JointSpec) -> list[str]:
    lines = ["", "[[joint]]", f"name = {_text(joint.name)}"]
    if joint.parent:
        lines.append(f"parent = {_text(joint.parent)}")
    lines.append(f"offset = {_list(joint.offset)}")
    if joint.translation_speed is not None:
        lines.append(f"translation_speed = {_list(joint.translation_speed)}")
    if joint.standing_pitch:
        lines.append(f"standing_pitch = {_number(joint.standing_pitch)}")
    if not joint.dofs:
        return lines
    dofs = [
        f"  {{ name = {_text(d.name)}, axis = {_text(d.axis)}, limits = {_list(d.limits)}, "
        f"speed = {_number(d.speed)}, circular = {_bool(d.circular)}"
        + ("" if d.usual_std is None else f", usual_std = {_number(d.usual_std)}")
        + " },"
        for d in joint.dofs
    ]
    return [*lines, "dofs = [", *dofs, "]"]


def _part_lines(part: PartSpec) -> list[str]:
    lines = ["", "[[part]]", f"name = {_text(part.name)}"]
    if part.parent:
        lines.append(f"parent = {_text(part.parent)}")
    lines += [f"side = {_text(part.side)}", f"variance = {_list(part.variance)}"]
    cones = [
        f"  {{ joint = {_text(c.joint)}, from = {_list(c.start)}, to = {_list(c.end)}, radii = {_list(c.radii)} }},"
        for c in part.cones
    ]
    return [*lines, "cones = [", *cones, "]"]


def _fractions(lengths: Array, height_m: float) -> tuple[float, ...]:
    # Adding 0 makes a negative zero positive.
    return tuple(round(float(v), _DIGITS) + 0.0 for v in lengths / height_m)


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _bool(value: bool) -> str:
    return "true" if value else "false"


def _number(value: float) -> str:
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return repr(float(value))


def _list(values: Iterable[float]) -> str:
    return f"[{', '.join(_number(v) for v in values)}]"

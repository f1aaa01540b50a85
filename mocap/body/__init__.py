"""The body: kinematic tree, flesh, sizes, first pose."""

from mocap.body.files import body_toml, model_of
from mocap.body.flesh import LookUpTable, build_look_up_table
from mocap.body.hierarchy import hierarchy_presets, limb_presets, load_hierarchy, load_limbs
from mocap.body.initial import (
    HeightEstimate,
    candidate_states,
    head_top,
    height_from_tops,
    is_upright,
    lowest_of,
)
from mocap.body.kinematics import (
    cones_of,
    joint_transforms,
    landmarks_of,
    neutral_state,
    skeleton_of,
)
from mocap.body.model import Body, BodyModel, body_presets, load_body_model, scale_body
from mocap.body.skin import body_skin

__all__ = [
    "Body",
    "BodyModel",
    "HeightEstimate",
    "LookUpTable",
    "body_presets",
    "body_skin",
    "body_toml",
    "build_look_up_table",
    "candidate_states",
    "cones_of",
    "head_top",
    "height_from_tops",
    "hierarchy_presets",
    "is_upright",
    "joint_transforms",
    "landmarks_of",
    "limb_presets",
    "load_body_model",
    "load_hierarchy",
    "load_limbs",
    "lowest_of",
    "model_of",
    "neutral_state",
    "scale_body",
    "skeleton_of",
]

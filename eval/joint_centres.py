"""Where segments of skinned people turn inside their flesh: MakeHuman shapes, and the synthetic people of this package.

    python -m eval.joint_centres [--shapes 200] [--own 20]

Draws shapes of the package anny (extra `anny`) of both sexes and measures where the heads of their bones lie: at
rest, as fractions of the stature, forward from the middle of the flesh about them. The same is measured on people of
`mocap.synth`: where they turn (`own`) and where the tables of lengths and breadths have their joints (`tables`).
Writes eval/results/joint_centres.csv: source, sex, measure, mean and standard deviation. TURNING_CENTRES and
TURNING_SPREAD of mocap/synth/figure.py come from there:

    hip_half        half of hips_apart of `anny`
    hip_back        `tables` less `anny`, mean of hips_from_section and hips_from_trunk
    shoulder_down   shoulders_over_hips, tables less anny
    neck_up         neck_over_hips, anny less tables
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eval.pose_sessions import ROOT
from eval.whole import write_csv
from mocap.arrays import Array
from mocap.synth.body import Body, build_body
from mocap.synth.figure import JOINT, JOINTS, forward_kinematics, make_figure

RESULTS = ROOT / "eval" / "results" / "joint_centres.csv"
FIELDS = ("source", "sex", "people", "measure", "mean", "std")
SEXES = ("male", "female")
_SLICE = 0.012  # half the thickness of a section, of the stature
_SEED = 5


def measures(
    vertices: Array, joints: Array, stature: float, arms: NDArray[np.bool_] | None = None
) -> dict[str, float]:
    """Of a neutral body, fractions of its barefoot stature.  vertices : (V, 3), joints : (J, 3), one unit.

    arms : (V,) bool, vertices that are no trunk and no leg; without it arms are told by how far out they are.
    """
    v, p = vertices / stature, joints / stature
    of = {name: p[j] for name, j in JOINT.items()}
    hips = 0.5 * (of["left_hip"] + of["right_hip"])
    shoulders = 0.5 * (of["left_shoulder"] + of["right_shoulder"])

    def middle(z: float, half_breadth: float) -> float:
        own = (np.abs(v[:, 2] - z) < _SLICE) & (np.abs(v[:, 1]) < half_breadth)
        x = v[own if arms is None else own & ~arms, 0]
        return float(0.5 * (x.min() + x.max()))

    def length(a: str, b: str) -> float:
        return float(np.linalg.norm(of[a] - of[b]))

    trunk = middle(0.5 * (hips[2] + shoulders[2]), 0.2)
    return {
        "hips_apart": float(of["left_hip"][1] - of["right_hip"][1]),
        "hips_from_section": float(hips[0]) - middle(hips[2], 0.25),
        "hips_from_trunk": float(hips[0]) - trunk,
        "hips_over_floor": float(hips[2] - v[:, 2].min()),
        "shoulders_apart": float(of["left_shoulder"][1] - of["right_shoulder"][1]),
        "shoulders_over_hips": float(shoulders[2] - hips[2]),
        "neck_over_hips": float(of["neck"][2] - hips[2]),
        "upper_arm": length("left_shoulder", "left_elbow"),
        "forearm": length("left_elbow", "left_wrist"),
        "thigh": length("left_hip", "left_knee"),
        "shank": length("left_knee", "left_ankle"),
    }


def anny_people(n: int) -> dict[str, list[dict[str, float]]]:
    """Measures of n shapes of the package anny, half of them women."""
    from mocap.synth import anny_body

    model = anny_body._model()
    rng = np.random.default_rng(_SEED)
    found: dict[str, list[dict[str, float]]] = {sex: [] for sex in SEXES}
    for k in range(n):
        sex = SEXES[k % 2]
        build = float(np.clip(rng.normal(1.0, 0.1), 0.82, 1.25))
        shape = {
            "gender": float(sex == "female"),
            "age": anny_body._ADULT_AGE,
            "height": float(rng.uniform(0.3, 0.7)),
            "weight": float(np.clip(0.45 + 1.1 * (build - 1), 0, 1)),
            "muscle": float(np.clip(0.5 + 0.4 * (build - 1) + 0.06 * rng.standard_normal(), 0, 1)),
            "proportions": float(np.clip(0.6 + 0.12 * rng.standard_normal(), 0, 1)),
        }
        vertices, heads = anny_body._rest(model, shape)
        stature = float(np.ptp(vertices[:, 2]))
        found[sex].append(measures(vertices, anny_body._joints(heads)[0], stature))
    return found


def own_people(n: int, *, of_tables: bool) -> dict[str, list[dict[str, float]]]:
    """Measures of n people of this package; of_tables : at the points that the tables call joints."""
    rng = np.random.default_rng(_SEED)
    found: dict[str, list[dict[str, float]]] = {sex: [] for sex in SEXES}
    for k in range(n):
        sex = SEXES[k % 2]
        stature = float(rng.uniform(1.55, 1.9))
        body = build_body(make_figure(stature, sex, float(rng.normal(1.0, 0.08)), rng=rng))
        found[sex].append(measures(*_neutral(body, of_tables=of_tables)))
    return found


def _neutral(body: Body, *, of_tables: bool) -> tuple[Array, Array, float, NDArray[np.bool_]]:
    """Vertices, joints, stature and whether a vertex belongs to an arm."""
    upright = np.tile(np.eye(3), (1, len(JOINTS), 1, 1))
    position, rotation = forward_kinematics(body.figure.offsets, upright, np.zeros((1, 3)))
    vertices, _ = body.pose(position[0], rotation[0])
    limbs = [j for name, j in JOINT.items() if name.endswith(("shoulder", "elbow", "wrist"))]
    joints = position[0] + body.figure.surface if of_tables else position[0]
    return vertices, joints, body.figure.stature_m, np.isin(body.weights.argmax(axis=1), limbs)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--shapes", type=int, default=200)
    parser.add_argument("--own", type=int, default=20)
    arguments = parser.parse_args()
    rows = []
    for source, found in (
        ("anny", anny_people(arguments.shapes)),
        ("own", own_people(arguments.own, of_tables=False)),
        ("tables", own_people(arguments.own, of_tables=True)),
    ):
        for sex, people in found.items():
            for measure in people[0]:
                values = [p[measure] for p in people]
                row = (source, sex, len(people), measure, f"{np.mean(values):.4f}", f"{np.std(values):.4f}")
                rows.append(dict(zip(FIELDS, row, strict=True)))
                sys.stdout.write(" ".join(map(str, row)) + "\n")
    write_csv(Path(RESULTS), FIELDS, rows)


if __name__ == "__main__":
    main()

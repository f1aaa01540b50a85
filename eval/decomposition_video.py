"""XN Figures 5-19 and 6-4 on a recording of our own: a dancer in one clip, tracked as an object of polygons.

The person of Figure 5-19 jumps, crosses and opens arms and legs; the clip is lost, and its 12 parts are not listed.
Ours is the development scene `dance` as one of its cameras sees it, rendered with shading and shadows: 10 parts (trunk,
head, upper arms, forearms, thighs, shanks), each a rectangle of one length with three columns, |X| = 30, and colour
histograms of the first picture, where the polygons are set by hand (here: by the truth). The noise of a column is half
the largest true movement from frame to frame. The error is exact where the source had eyes: the mean distance of both
ends of all parts from the projected landmarks.

- residual: PS with residual and with combinatorial resampling, N = 500 (Figure 5-19).
- convergence: error and time over N of the filters of Figure 6-4, each particle scored four times.

Writes eval/results/decomposition_video.csv.

    python -m eval.decomposition_video [--frames 90] [--runs 5]

About four minutes on one core.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eval.decomposition.readings import filter_named
from eval.decomposition.store import RESULTS
from eval.decomposition.tables import LABELS
from eval.whole import write_csv
from mocap.arrays import Array
from mocap.data import LANDMARKS
from mocap.data.problem import StateLayout
from mocap.filters import FilterBudget, initial_particles
from mocap.geometry.rigid import wrap_angle
from mocap.polygons.likelihood import PolygonProblem, colour_bins, mark_runs, part_histograms
from mocap.polygons.tree import PolygonTree, part_frames, with_loose_joints

SCENE, CAMERA = "dance", 0
FIELDS = ("figure", "method", "n_particles", "runs", "frames", "error_px", "std_px", "step_ms")
# Name, landmarks at its ends, parent, width over length.
PARTS = (
    ("trunk", "pelvis", "neck", -1, 0.55),
    ("head", "neck", "head", 0, 0.8),
    *(
        (f"{side}_{name}", f"{side}_{a}", f"{side}_{b}", 0 if on is None else 2 + 4 * k + on, width)
        for k, side in enumerate(("left", "right"))
        for name, a, b, on, width in (
            ("upper_arm", "shoulder", "elbow", None, 0.3),
            ("forearm", "elbow", "wrist", 0, 0.3),
            ("thigh", "hip", "knee", None, 0.35),
            ("shank", "knee", "ankle", 2, 0.25),
        )
    ),
)
_SEED = 519
_NOISE_LEVELS = 2.0
N_RESIDUAL = 500
SCHEMES = (("PS, residual", "ps", "residual"), ("PS, combinatorial", "pfcr-equal", "systematic"))
N_SCORES = 4
COUNTS = (25, 50, 100, 200)
CONVERGING = ("hapsopf", "psapf", "hpso", "apsopf", "apf")


@dataclass(frozen=True, eq=False)
class Film:
    """The clip.  ends : (T, P, 2, 2) px, true ends of every part.  bins : colour bins of every picture."""

    ends: Array
    bins: tuple[NDArray[np.uint16], ...]


def make_film(n_frames: int) -> Film:
    """The scene as one camera sees it."""
    from mocap.synth.render import CameraView
    from mocap.synth.scene import load_scene
    from mocap.synth.world import build_world

    world = build_world(load_scene(SCENE))
    camera = tuple(world.rig)[CAMERA]
    view, rng = CameraView(camera, world.room), np.random.default_rng(_SEED)
    ends, bins = [], []
    for frame in range(n_frames):
        picture, _ = view.render(world.at(float(frame)), world.things, world.looks)
        noisy = picture + _NOISE_LEVELS * rng.standard_normal(picture.shape)
        bins.append(mark_runs(colour_bins(np.clip(np.round(noisy), 0, 255).astype(np.uint8))))
        uv, _ = camera.project(world.actors[0].landmarks_at(float(frame)))
        ends.append([[uv[LANDMARKS.index(a)], uv[LANDMARKS.index(b)]] for _, a, b, _, _ in PARTS])
    return Film(np.array(ends), tuple(bins))


def person_tree(ends: Array) -> PolygonTree:
    """The object whose rest is a pose (P, 2, 2) px: rectangles along its parts, three columns each."""
    origin, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    length, angle = np.linalg.norm(along, axis=1), np.arctan2(along[:, 1], along[:, 0])
    parent = np.array([p[3] for p in PARTS])
    names, column_part = ["trunk_x", "trunk_y", "trunk_theta"], [0, 0, 0]
    for k, part in enumerate(PARTS[1:], 1):
        names.append(f"{part[0]}_angle")
        column_part.append(k)
    D = len(names)
    layout = StateLayout(
        names=tuple(names),
        lower=np.full(D, -np.inf),
        upper=np.full(D, np.inf),
        is_circular=np.array([n.endswith(("theta", "angle")) for n in names]),
        parts=tuple(p[0] for p in PARTS),
        part_of_column=np.array(column_part),
        parent_of_part=parent,
    )
    offset = np.array(
        [_turned(origin[k] - origin[max(q, 0)], -angle[max(q, 0)]) for k, q in enumerate(parent)]
    )
    rest = np.array([0.0 if q < 0 else angle[k] - angle[q] for k, q in enumerate(parent)])
    box = np.array([[0.0, -0.5], [1.0, -0.5], [1.0, 0.5], [0.0, 0.5]])
    corners = np.concatenate([box * [own, own * part[4]] for own, part in zip(length, PARTS, strict=True)])
    return with_loose_joints(PolygonTree(layout, offset, rest, corners, 4 * np.arange(len(PARTS) + 1)))[0]


def _turned(v: Array, angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * v[0] - s * v[1], s * v[0] + c * v[1]])


def states_of(tree: PolygonTree, ends: Array) -> Array:
    """States (T, 3 P) whose parts begin and point as the true ones (T, P, 2, 2) do."""
    along = ends[:, :, 1] - ends[:, :, 0]
    angle = np.arctan2(along[..., 1], along[..., 0])
    out = np.empty((len(ends), tree.layout.n_columns))
    for p, q in enumerate(tree.layout.parent_of_part):
        c = tree.first_column[p]
        if q < 0:
            out[:, c : c + 2], out[:, c + 2] = ends[:, p, 0], angle[:, p]
            continue
        apart = ends[:, p, 0] - ends[:, q, 0]
        for t in range(len(ends)):
            out[t, c : c + 2] = _turned(apart[t], -angle[t, q]) - tree.offset[p]
        out[:, c + 2] = wrap_angle(angle[:, p] - angle[:, q] - tree.rest_angle[p])
    return out


def ends_of(tree: PolygonTree, states: Array) -> Array:
    """Ends (T, P, 2, 2) px of the parts of states (T, 3 P)."""
    origin, angle = part_frames(tree, states)
    length = tree.corners[1::4, 0]
    tip = origin + length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return np.stack([origin, tip], axis=2)


def track(
    film: Film, name: str, n_particles: int, n_layers: int, resampling: str, seed: int
) -> tuple[float, float]:
    """Mean error of the ends, px, and milliseconds of a step, of one run."""
    tree = person_tree(film.ends[0])
    truth = states_of(tree, film.ends)
    change = np.diff(truth, axis=0)
    change = np.where(tree.layout.is_circular, wrap_angle(change), change)
    std = 0.5 * np.abs(change).max(axis=0)
    reference = part_histograms(tree, film.bins[0], truth[:1])[0][0]
    budget = FilterBudget(name, n_particles=n_particles, n_layers=n_layers, resampling=resampling)
    settings = filter_named(name).settings_from_budget(budget, tree.layout, std)
    rng = np.random.default_rng([_SEED, seed])
    state = initial_particles(PolygonProblem(tree, film.bins[0], reference), truth[0], n_particles)
    estimates, seconds = [truth[0]], 0.0
    for bins in film.bins[1:]:
        problem = PolygonProblem(tree, bins, reference)
        begun = time.process_time()
        state, info = filter_named(name).step(problem, state, settings, rng=rng)
        seconds += time.process_time() - begun
        estimates.append(info.estimate)
    error = np.linalg.norm(ends_of(tree, np.array(estimates)) - film.ends, axis=-1)[1:]
    return float(error.mean()), 1e3 * seconds / (len(film.bins) - 1)


def lines(film: Film, runs: int) -> list[dict[str, Any]]:
    """Both figures as rows."""
    todo = [("5-19", label, name, N_RESIDUAL, 1, scheme) for label, name, scheme in SCHEMES]
    todo += [
        ("6-4", {"psapf": "APF", "apf": "PFAPF"}.get(name, LABELS[name]), name, n, N_SCORES, "systematic")
        for name in CONVERGING
        for n in COUNTS
    ]
    out = []
    for figure, label, name, n, n_layers, scheme in todo:
        found = np.array([track(film, name, n, n_layers, scheme, seed) for seed in range(runs)])
        error, std, step = found[:, 0].mean(), found[:, 0].std(ddof=1), found[:, 1].min()
        values = (figure, label, n, runs, len(film.bins), f"{error:.2f}", f"{std:.2f}", f"{step:.2f}")
        out.append(dict(zip(FIELDS, values, strict=True)))
        print(", ".join(map(str, values)), file=sys.stderr, flush=True)
    return out


def main(argv: Sequence[str] | None = None) -> int:
    """Render the clip, track it, write the CSV."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=90)
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args(argv)
    write_csv(RESULTS / "decomposition_video.csv", FIELDS, lines(make_film(options.frames), options.runs))
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""One cell of a comparison: a filter with its settings, tracking one synthetic object from the first frame on."""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eval.decomposition.readings import (
    AbsoluteAngles,
    LogDistanceProblem,
    filter_named,
    to_relative,
)
from mocap.data.problem import ArticulatedProblem
from mocap.filters import FilterBudget, ParticleState, initial_particles
from mocap.polygons import corner_error
from mocap.polygons.likelihood import (
    PolygonLikelihoodSettings,
    PolygonProblem,
    mark_runs,
    part_histograms,
    random_walk_std,
)
from mocap.polygons.tree import PolygonTree, corner_positions, object_trees, with_loose_joints
from mocap.synth.polygons import SMALL, PolygonScene, PolygonSceneSettings, make_polygon_scene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class World:
    """What is common to the experiments of one source.

    std_px, std_rad : random walk of the filters.
    The rest is read otherwise in eval.decomposition_regimes only.  is_log_distance : `LogDistanceProblem`.
    has_absolute_state, has_absolute_motion : angles of the parts in the picture, for the filters and in the film.
    has_loose_joints : the filters' state has three noisy columns for every part, 3 P in all; the film has joints.
    start_px, start_rad : standard deviation of a start set by hand, of its centre and of every part's angle; the
    reference histograms are taken there.
    """

    scene: PolygonSceneSettings
    std_px: float
    std_rad: float
    likelihood: PolygonLikelihoodSettings
    is_log_distance: bool = False
    has_absolute_state: bool = False
    has_absolute_motion: bool = False
    has_loose_joints: bool = False
    start_px: float = 0.0
    start_rad: float = 0.0


_LARGE = PolygonSceneSettings(n_arms=4, n_levels=4)
WORLDS = {
    # SW 6.1, 6.2, 6.4.
    "sw": World(
        replace(_LARGE, strong_frames=((50, 150), (200, 250))), 1.0, 0.025, PolygonLikelihoodSettings()
    ),
    # XN 4.4.1, 4.4.2, 4.4.4; chapter 5 uses the same.
    "xn4": World(_LARGE, 1.0, 0.025, PolygonLikelihoodSettings()),
    # XN 6.2: silhouette beside colour; its weight is not printed, ours is that of the colour.
    # The random walk is twice as wide, and so is the motion.
    "xn6": World(
        replace(SMALL, speed_px=1.0, speed_rad=0.025),
        2.0,
        0.05,
        PolygonLikelihoodSettings(lambda_silhouette=50.0),
    ),
}


# How sharp the likelihood is decides what swapping can do; the sources' 50 is in "sw".
SHARPNESS = (15, 200, 800)
for _lambda in SHARPNESS:
    WORLDS[f"sw_{_lambda}"] = replace(
        WORLDS["sw"], likelihood=PolygonLikelihoodSettings(lambda_colour=float(_lambda))
    )

# The filters' walk in percent of that of "sw"; the motion stays as it is.
STEP_WIDTHS = (50, 71, 141)
for _percent in STEP_WIDTHS:
    _factor = _percent / 100
    WORLDS[f"step_{_percent}"] = replace(
        WORLDS["sw"], std_px=_factor * WORLDS["sw"].std_px, std_rad=_factor * WORLDS["sw"].std_rad
    )

# Other readings of the published experiment, one at a time, on the worlds of SW and XN 4-5 and of XN 6.
for _base in ("sw", "xn6"):
    _world = WORLDS[_base]
    _scene = _world.scene
    WORLDS |= {
        # "The polygons are manually positioned in the first frame" (SW 6.2).
        f"{_base}_by-hand": replace(_world, start_px=2.0, start_rad=0.08),
        f"{_base}_log": replace(_world, is_log_distance=True),
        f"{_base}_fast": replace(
            _world, scene=replace(_scene, speed_px=2 * _scene.speed_px, speed_rad=2 * _scene.speed_rad)
        ),
        # x^k = (x, y, theta) of part k (XN 4.4.2).
        f"{_base}_absolute": replace(_world, has_absolute_state=True),
        f"{_base}_absolute-film": replace(_world, has_absolute_state=True, has_absolute_motion=True),
        f"{_base}_colour-only": replace(_world, likelihood=replace(_world.likelihood, lambda_silhouette=0.0)),
        # Silhouettes from somebody who never saw the picture empty.
        f"{_base}_clutter-in-sight": replace(_world, scene=replace(_scene, is_clutter_known=False)),
    }

# The sources' own: SW has three noisy columns for every part and starts by hand; a film slower than the walk leaves
# filters an error with a floor, as published. 0.4 was named before any run of these worlds.
SLOW = 0.4
for _state in ("sw", "sw_loose"):
    _world = replace(WORLDS["sw"], has_loose_joints=_state != "sw")
    _scene = _world.scene
    _slow = replace(_scene, speed_px=SLOW * _scene.speed_px, speed_rad=SLOW * _scene.speed_rad)
    _joint = "-" if "_" in _state else "_"
    WORLDS |= {
        _state: _world,
        f"{_state}{_joint}slow": replace(_world, scene=_slow),
        f"{_state}{_joint}slow-by-hand": replace(_world, scene=_slow, start_px=2.0, start_rad=0.08),
    }


@dataclass(frozen=True, order=True)
class SceneKey:
    """Which scene.  world : a key of WORLDS.  seed : which of the scenes with these settings.  n_frames : 0 = all."""

    world: str
    n_arms: int
    n_levels: int
    n_objects: int = 1
    n_clutter: int = 0
    seed: int = 0
    n_frames: int = 0


@dataclass(frozen=True, order=True)
class RunKey:
    """Which filter on it.

    n_evaluations : of the whole state per frame, the same for all filters that are compared (reading guide 23). A
    filter without layers gets as many particles, one with n_layers gets n_evaluations / n_layers of them.
    n_layers : how often a filter that anneals or swarms scores each particle, XN's L + 1; 1 for the others.
    is_split : one filter for each object instead of one for all, n_evaluations each.
    """

    filter: str
    n_evaluations: int
    n_layers: int = 1
    resampling: str = "systematic"
    is_split: bool = False
    seed: int = 0


@dataclass(frozen=True, order=True)
class Cell:
    """A scene and a run on it; one number comes out: the mean error."""

    scene: SceneKey
    run: RunKey

    def key(self) -> dict[str, str]:
        """The cell as the columns of a CSV row."""
        scene = {f"scene_{k}" if k == "seed" else k: str(v) for k, v in asdict(self.scene).items()}
        run = {f"run_{k}" if k == "seed" else k: str(v) for k, v in asdict(self.run).items()}
        return scene | run


KEY_FIELDS = tuple(Cell(SceneKey("sw", 1, 2), RunKey("sir", 2)).key())
VALUE_FIELDS = (
    "error_px",
    "error_weak_px",
    "error_strong_px",
    "evaluations",
    "resampling_ms",
    "swapping_ms",
    "step_ms",
    "status",
)


def scene_of(key: SceneKey) -> PolygonScene:
    """The scene of a key; clutter does not change the motion."""
    settings = replace(
        WORLDS[key.world].scene,
        n_arms=key.n_arms,
        n_levels=key.n_levels,
        n_objects=key.n_objects,
        n_clutter=key.n_clutter,
    )
    if key.n_frames:
        settings = replace(settings, n_frames=key.n_frames)
    scene = make_polygon_scene(settings, rng=np.random.default_rng(_scene_seed(key)))
    if WORLDS[key.world].has_absolute_motion:
        scene = replace(scene, states=scene.states @ to_relative(scene.tree).T)
    return scene


def _scene_seed(key: SceneKey) -> list[int]:
    return [key.seed, key.n_arms, key.n_levels, key.n_objects]


def start_of(key: SceneKey, scene: PolygonScene) -> Array:
    """The state (D,), angles against the parent, at which the filters start; the same in all runs of a scene."""
    world, tree = WORLDS[key.world], scene.tree
    draw = np.random.default_rng([_START, *_scene_seed(key)]).standard_normal(tree.layout.n_columns)
    error = random_walk_std(tree.layout, world.start_px, world.start_rad) * draw
    return np.asarray(scene.states[0] + to_relative(tree) @ error, dtype=np.float64)


_START = 41  # apart from the seeds of the motion


@dataclass(frozen=True, eq=False)
class _Track:
    """One filter on one (sub-)tree of a scene.  columns : its part of the whole state.  parts : its reference rows."""

    tree: PolygonTree
    columns: NDArray[np.int64]
    parts: NDArray[np.int64]
    settings: Any


class _Run:
    """A run in progress; frame by frame, so that several runs share the pictures of a scene."""

    def __init__(self, scene: PolygonScene, cell: Cell) -> None:
        self.cell, self.scene, self.world = cell, scene, WORLDS[cell.scene.world]
        start = start_of(cell.scene, scene)
        self.reference = scene.reference
        self.tree = scene.tree
        if self.world.start_px or self.world.start_rad:
            self.reference = part_histograms(scene.tree, scene.bins(0), start[None])[0][0]
        self.to_relative = to_relative(scene.tree) if self.world.has_absolute_state else None
        if self.to_relative is not None:
            start = np.linalg.solve(self.to_relative, start).astype(np.float64)
        if self.world.has_loose_joints:
            self.tree, kept = with_loose_joints(scene.tree)
            start, jointed = np.zeros(self.tree.layout.n_columns), start
            start[kept] = jointed
        self.estimates = np.full((len(scene.states), len(start)), np.nan)
        self.estimates[0] = start
        self.seconds: dict[str, float] = {}
        self.step_s = 0.0
        self.n_evaluations = 0
        self.failure = ""
        self.rng = np.random.default_rng([cell.run.seed, zlib.crc32(repr(cell).encode())])
        self.tracks = [self._track(tree, columns) for tree, columns in self._trees()]
        problems = [self._problem(track, scene.bins(0)) for track in self.tracks]
        self.states = [
            initial_particles(
                problem, start[track.columns], max(2, cell.run.n_evaluations // cell.run.n_layers)
            )
            for problem, track in zip(problems, self.tracks, strict=True)
        ]

    def _trees(self) -> Sequence[tuple[PolygonTree, NDArray[np.int64]]]:
        if self.cell.run.is_split:
            return object_trees(self.tree)
        return [(self.tree, np.arange(self.tree.layout.n_columns))]

    def _track(self, tree: PolygonTree, columns: NDArray[np.int64]) -> _Track:
        run = self.cell.run
        budget = FilterBudget(
            run.filter,
            n_particles=run.n_evaluations // run.n_layers,
            n_layers=run.n_layers,
            resampling=run.resampling,
        )
        std = random_walk_std(tree.layout, self.world.std_px, self.world.std_rad)
        settings = filter_named(run.filter).settings_from_budget(budget, tree.layout, std)
        parts = np.array([self.scene.tree.layout.parts.index(name) for name in tree.layout.parts])
        return _Track(tree, columns, parts, settings)

    def _problem(self, track: _Track, bins: NDArray[np.uint16]) -> ArticulatedProblem:
        make = LogDistanceProblem if self.world.is_log_distance else PolygonProblem
        problem = make(track.tree, bins, self.reference[track.parts], self.world.likelihood)
        if self.to_relative is None:
            return problem
        return AbsoluteAngles(problem, self.to_relative[np.ix_(track.columns, track.columns)])

    def step(self, frame: int, bins: NDArray[np.uint16]) -> None:
        """Filter one frame; a failure ends the run and is kept as its status."""
        if self.failure:
            return
        try:
            for i, track in enumerate(self.tracks):
                self._step_track(i, track, frame, bins)
        except Exception as error:  # one failed cell must not stop the others
            self.failure = f"{type(error).__name__}: {error}".replace("\n", " ")[:120]

    def _step_track(self, i: int, track: _Track, frame: int, bins: NDArray[np.uint16]) -> None:
        problem = self._problem(track, bins)
        begun = time.perf_counter()
        state: ParticleState = self.states[i]
        self.states[i], info = filter_named(self.cell.run.filter).step(
            problem, state, track.settings, rng=self.rng
        )
        self.step_s += time.perf_counter() - begun
        self.estimates[frame, track.columns] = info.estimate
        self.n_evaluations += info.n_evaluations
        for name, seconds in info.seconds.items():
            self.seconds[name] = self.seconds.get(name, 0.0) + seconds

    def row(self) -> dict[str, str]:
        """The finished run as a CSV row; times are per frame."""
        row = self.cell.key() | dict.fromkeys(VALUE_FIELDS, "")
        if self.failure:
            return row | {"status": self.failure}
        states = self.estimates
        if self.to_relative is not None:
            states = states @ self.to_relative.T
        error = corner_error(corner_positions(self.tree, states), self.scene.corners)[1:]
        frames = np.arange(1, len(error) + 1)
        strong = np.zeros(len(error), dtype=np.bool_)
        for first, last in self.scene.settings.strong_frames:
            strong |= (frames >= first) & (frames <= last)
        n = max(1, len(error))
        values = {
            "error_px": _mean(error),
            "error_weak_px": _mean(error[~strong]),
            "error_strong_px": _mean(error[strong]),
            "evaluations": f"{self.n_evaluations / n:.1f}",
            "resampling_ms": f"{1e3 * self.seconds.get('resampling', 0.0) / n:.4f}",
            "swapping_ms": f"{1e3 * self.seconds.get('swapping', 0.0) / n:.4f}",
            "step_ms": f"{1e3 * self.step_s / n:.3f}",
        }
        status = "ok" if np.all(np.isfinite(error)) else "not finite"
        return row | values | {"status": status}


def _mean(values: Array) -> str:
    return f"{values.mean():.3f}" if len(values) else ""


def run_scene(
    key: SceneKey, runs: Sequence[RunKey], progress: Callable[[int], None] | None = None
) -> list[dict[str, str]]:
    """All runs on one scene, side by side through its frames: one CSV row each, failed ones too."""
    scene = scene_of(key)
    rows, going = [], []
    for run in runs:
        cell = Cell(key, run)
        try:
            going.append(_Run(scene, cell))
        except (ValueError, KeyError, ImportError, AttributeError) as error:
            status = f"{type(error).__name__}: {error}".replace("\n", " ")[:120]
            rows.append(cell.key() | dict.fromkeys(VALUE_FIELDS, "") | {"status": status})
    for frame in range(1, scene.settings.n_frames):
        bins = mark_runs(scene.bins(frame))
        for one in going:
            one.step(frame, bins)
        if progress is not None:
            progress(frame)
    return rows + [one.row() for one in going]

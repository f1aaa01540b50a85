"""Meeting-room scenes drawn from a seed: people enter, cross, meet, sit and leave.

The scene files of the project were made with `python -m mocap.synth.meetings mocap/synth/scenes/meetings`; they are
plain TOML with explicit way-points.
"""

from __future__ import annotations

import itertools
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from mocap.errors import MocapError
from mocap.synth.figure import make_figure
from mocap.synth.furniture import Chair, Table
from mocap.synth.motions import MOTIONS
from mocap.synth.scene import Scene, scene_from_dict
from mocap.synth.world import rng_at

Array = NDArray[np.float64]
Point = tuple[float, float]

SIZE_M = (5.0, 4.0, 2.8)
MARGIN_M = 0.05
FPS = 15.0
BODY_M = 0.28  # furniture and walls are kept this far from the middle of a walking person
APART_M = 0.55  # two persons' middles are never closer
TABLE_M = 0.18  # a corner may be cut as close as this
MEET_M = 0.95
_CELL_M = 0.1
_TURN_S, _SEAT_S = 1.0, 3.7  # about what a turn on the spot, and sitting down and standing up take
_APPROACH_M = 0.55  # a chair is approached from this far before the middle of its seat
_DOORS = ((2.5, -1.2), (-2.5, 1.2), (1.6, 2.0), (-1.6, -2.0))
_SHIRTS = (
    (165, 45, 42),
    (38, 62, 150),
    (45, 120, 62),
    (205, 165, 45),
    (218, 216, 210),
    (42, 42, 48),
    (120, 60, 130),
    (210, 110, 40),
)
_TROUSERS = ((45, 50, 75), (70, 62, 50), (88, 88, 92), (150, 135, 105), (30, 30, 34))


@dataclass
class _Plan:
    """A room with its furniture, where one may walk, and where one comes in."""

    door: Point
    table: Table
    chairs: list[Chair]
    free: NDArray[np.bool_]
    graph: csr_array
    ways: dict[tuple[Point, Point], list[Point] | None] = field(default_factory=dict)


def meeting_scene(seed: int, *, n_persons: int, seconds: float = 20.0, masks_only: bool = False) -> Scene:
    """A scene of `n_persons` in a meeting room of 5 x 4 m with a table and chairs, four corner cameras and one above.

    Raises RuntimeError when no plan without collisions is found, which another seed mends.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(91,)))
    for _ in range(150):
        plan = _layout(rng)
        document = {
            "name": f"meeting_{seed}",
            "seed": seed,
            "n_frames": round(seconds * FPS),
            "fps": FPS,
            "masks_only": masks_only,
            "truth_voxels": not masks_only,
            "room": {
                "size_m": list(SIZE_M),
                "floor": str(rng.choice(["tiles", "planks", "carpet"])),
                "capture_m": [
                    [-SIZE_M[0] / 2 + MARGIN_M, -SIZE_M[1] / 2 + MARGIN_M, 0.0],
                    [SIZE_M[0] / 2 - MARGIN_M, SIZE_M[1] / 2 - MARGIN_M, 2.2],
                ],
                "furniture": [
                    _rounded(plan.table.model_dump(exclude_defaults=True)),
                    *(_rounded(c.model_dump(exclude_defaults=True)) for c in plan.chairs),
                ],
            },
            "rig": {"kind": "corners_ceiling"},
            "persons": [],
        }
        if _fill(document, plan, n_persons, seconds, rng):
            return scene_from_dict(document)
    raise RuntimeError(f"no plan for seed {seed}")


def crossing_scene(seed: int, *, seconds: float = 24.0) -> Scene:
    """Two persons in different colours who pass each other closely again and again, before seven cameras."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(92,)))
    for _ in range(60):
        gap = rng.uniform(0.54, 0.62)
        turn = rng.uniform(0, 2 * np.pi)
        reach = rng.uniform(1.25, 1.45)
        persons = []
        for i, side in enumerate((1.0, -1.0)):
            ends = [(side * reach, side * gap / 2), (-side * reach, side * gap / 2)]
            ends = [
                (c * np.cos(turn) - s * np.sin(turn), c * np.sin(turn) + s * np.cos(turn)) for c, s in ends
            ]
            persons.append(
                _somebody(seed * 10 + i, i, rng)
                | {
                    "motion": {
                        "kind": "route",
                        "speed_m_s": round(float(rng.uniform(0.95, 1.15)), 2),
                        "start_s": round(float(rng.uniform(0.1, 0.5)), 2),
                        "repeat": True,
                        "waypoints": [{"at_m": _point(e)} for e in ends],
                    },
                }
            )
        document = {
            "name": f"crossing_{seed}",
            "seed": seed,
            "n_frames": round(seconds * FPS),
            "fps": FPS,
            "persons": persons,
        }
        scene = scene_from_dict(document)
        a, b = root_paths(scene)
        distance = np.linalg.norm(a - b, axis=1)
        if distance.min() >= 0.5 and n_encounters(distance, 0.95) >= 4:
            return scene
    raise RuntimeError(f"no plan for seed {seed}")


def n_encounters(distance: Array, within_m: float) -> int:
    """How often a distance over time (T,) m falls below a threshold."""
    near = distance < within_m
    return int(near[0]) + int(np.count_nonzero(near[1:] & ~near[:-1]))


def scene_text(scene: Scene, description: str) -> str:
    """The scene as a TOML file."""
    document = scene.model_dump(mode="json", exclude_defaults=True)
    del document["name"]
    document.pop("description", None)
    lines = [f'description = "{description}"']
    tables = {k: v for k, v in document.items() if isinstance(v, dict)}
    lines += [f"{k} = {_toml(v)}" for k, v in document.items() if k not in tables and k != "persons"]
    for name, table in tables.items():
        lines += ["", f"[{name}]"]
        for key, value in table.items():
            if key == "furniture":
                lines += ["furniture = [", *(f"  {_toml(v)}," for v in value), "]"]
            else:
                lines.append(f"{key} = {_toml(value)}")
    for person in document["persons"]:
        lines += ["", "[[persons]]"]
        motion = person.pop("motion")
        lines += [f"{k} = {_toml(v)}" for k, v in person.items()]
        stops = motion.pop("waypoints")
        lines += ["", "[persons.motion]", *(f"{k} = {_toml(v)}" for k, v in motion.items())]
        lines += ["waypoints = [", *(f"  {_toml(s)}," for s in stops), "]"]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {_toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    return f'"{value}"' if isinstance(value, str) else repr(value)


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _rounded(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_rounded(v) for v in value]
    return round(value, 2) if isinstance(value, float) else value


def _point(p: Any) -> list[float]:
    return [round(float(p[0]), 2), round(float(p[1]), 2)]


# --- the room -----------------------------------------------------------------------------------------------


def _layout(rng: np.random.Generator) -> _Plan:
    """Table, chairs that can be reached, and a door."""
    while True:
        door = _DOORS[int(rng.integers(len(_DOORS)))]
        long = bool(rng.uniform() < 0.7)
        table = Table.model_validate(
            {
                "kind": "table",
                "center_m": _point((rng.uniform(-0.4, 0.4), rng.uniform(-0.25, 0.25))),
                "size_m": _point((rng.uniform(1.1, 1.5), rng.uniform(0.6, 0.75))),
                "heading_deg": 0.0 if long else 90.0,
            }
        )
        half = np.array(table.size_m if long else table.size_m[::-1]) / 2
        x, y = table.center_m
        spots = [
            (x - half[0] - 0.92, y, 0.0),
            (x + half[0] + 0.92, y, 180.0),
            (x, y - half[1] - 0.92, 90.0),
            (x, y + half[1] + 0.92, -90.0),
            (rng.uniform(-1.4, 1.4), -1.62, 90.0),
            (rng.uniform(-1.4, 1.4), 1.62, -90.0),
            (-2.12, rng.uniform(-0.9, 0.9), 0.0),
            (2.12, rng.uniform(-0.9, 0.9), 180.0),
        ]
        chairs: list[Chair] = []
        for k in rng.permutation(len(spots)):
            cx, cy, heading = spots[k]
            near = [np.hypot(cx - c.center_m[0], cy - c.center_m[1]) for c in chairs]
            is_clear = min([*near, np.hypot(cx - door[0], cy - door[1]) - 0.2], default=9) > 0.95
            if is_clear and abs(cx) < 2.15 and abs(cy) < 1.65:
                chairs.append(
                    Chair.model_validate(
                        {"kind": "chair", "center_m": _point((cx, cy)), "heading_deg": heading}
                    )
                )
        chairs = chairs[: int(rng.integers(3, 5))]
        free = _free_cells(table, chairs)
        plan = _Plan(door, table, chairs, free, _graph(free))
        ends = [_before(c) for c in chairs]
        if len(chairs) >= 3 and all(_way(plan, _inside_door(door), e) is not None for e in ends):
            return plan


def _free_cells(table: Table, chairs: list[Chair]) -> NDArray[np.bool_]:
    """Grid over the room: where the middle of a person may be."""
    n = np.round(np.array(SIZE_M[:2]) / _CELL_M).astype(int) + 1
    x = -SIZE_M[0] / 2 + _CELL_M * np.arange(n[0])
    y = -SIZE_M[1] / 2 + _CELL_M * np.arange(n[1])
    X, Y = np.meshgrid(x, y, indexing="ij")
    free = (np.abs(X) < SIZE_M[0] / 2 - 0.35) & (np.abs(Y) < SIZE_M[1] / 2 - 0.35)
    for boxes in (table.boxes(), *(c.boxes() for c in chairs)):
        corners = boxes.reshape(-1, 3)
        low, high = corners.min(axis=0), corners.max(axis=0)
        dx = np.maximum(np.maximum(low[0] - X, X - high[0]), 0)
        dy = np.maximum(np.maximum(low[1] - Y, Y - high[1]), 0)
        free &= np.hypot(dx, dy) > BODY_M
    return free


def _graph(free: NDArray[np.bool_]) -> csr_array:
    """Steps between free cells that touch, with their lengths in cells."""
    number = np.arange(free.size).reshape(free.shape)
    rows, columns, lengths = [], [], []
    for di, dj in ((1, 0), (0, 1), (1, 1), (1, -1)):
        a = (slice(0, free.shape[0] - di), slice(max(0, -dj), free.shape[1] - max(0, dj)))
        b = (slice(di, None), slice(max(0, dj), free.shape[1] - max(0, -dj)))
        both = free[a] & free[b]
        rows.append(number[a][both])
        columns.append(number[b][both])
        lengths.append(np.full(int(both.sum()), np.hypot(di, dj)))
    i, j, v = (np.concatenate(x) for x in (rows, columns, lengths))
    return csr_array(
        (np.tile(v, 2), (np.concatenate([i, j]), np.concatenate([j, i]))), shape=(free.size,) * 2
    )


def _cell(p: Point) -> tuple[int, int]:
    return round((p[0] + SIZE_M[0] / 2) / _CELL_M), round((p[1] + SIZE_M[1] / 2) / _CELL_M)


def _is_free(plan: _Plan, p: Point) -> bool:
    i, j = _cell(p)
    return 0 <= i < plan.free.shape[0] and 0 <= j < plan.free.shape[1] and bool(plan.free[i, j])


def _sees(plan: _Plan, a: Point, b: Point) -> bool:
    """Whether one may walk straight from a to b."""
    n = int(np.hypot(b[0] - a[0], b[1] - a[1]) / (0.4 * _CELL_M)) + 2
    line = np.linspace(a, b, n)
    cells = np.rint((line + np.array(SIZE_M[:2]) / 2) / _CELL_M).astype(int)
    inside = np.all((cells >= 0) & (cells < plan.free.shape), axis=1)
    return bool(inside.all() and plan.free[cells[:, 0], cells[:, 1]].all())


def _way(plan: _Plan, start: Point, end: Point) -> list[Point] | None:
    """Points from start to end, both excluded, with straight free lines between; None when there is no way."""
    if (start, end) not in plan.ways:
        plan.ways[start, end] = _find_way(plan, start, end)
    return plan.ways[start, end]


def _find_way(plan: _Plan, start: Point, end: Point) -> list[Point] | None:
    if not _is_free(plan, start) or not _is_free(plan, end):
        return None
    if _sees(plan, start, end):
        return []
    shape = plan.free.shape
    first, last = (int(np.ravel_multi_index(_cell(p), shape)) for p in (start, end))
    _, came = dijkstra(plan.graph, indices=first, return_predecessors=True)
    if came[last] < 0 and first != last:
        return None
    nodes = [last]
    while nodes[-1] != first:
        nodes.append(int(came[nodes[-1]]))
    cells = [np.unravel_index(n, shape) for n in nodes]
    points = [
        (float(i * _CELL_M - SIZE_M[0] / 2), float(j * _CELL_M - SIZE_M[1] / 2)) for i, j in cells[::-1]
    ]
    points[0], points[-1] = start, end
    out = [points[0]]
    while out[-1] != points[-1]:
        k = len(points) - 1
        while points[k] != out[-1] and not _sees(plan, out[-1], points[k]):
            k -= 1
        if points[k] == out[-1]:
            return None
        out.append(points[k])
    return out[1:-1]


def _before(chair: Chair) -> Point:
    """Where a chair is approached from."""
    turn = np.deg2rad(chair.heading_deg)
    x, y = chair.center_m
    return round(float(x + _APPROACH_M * np.cos(turn)), 2), round(float(y + _APPROACH_M * np.sin(turn)), 2)


def _inside_door(door: Point) -> Point:
    return door[0] - 0.5 * np.sign(door[0]) * (abs(door[0]) == 2.5), door[1] - 0.5 * np.sign(door[1]) * (
        abs(door[1]) == 2.0
    )


def _outside_door(door: Point) -> Point:
    x, y = _inside_door(door)
    return door[0] + 1.8 * (door[0] - x), door[1] + 1.8 * (door[1] - y)


# --- the persons --------------------------------------------------------------------------------------------


def _fill(
    document: dict[str, Any], plan: _Plan, n_persons: int, seconds: float, rng: np.random.Generator
) -> bool:
    """Add persons one by one, none of whom runs into another; False when it does not work out."""
    paths: list[Array] = []
    meeting: tuple[Point, float] | None = None
    for i in range(n_persons):
        for _ in range(400):
            person, meets = _itinerary(plan, i, n_persons, seconds, meeting, rng)
            if person is None:
                continue
            rough = _rough_path(person["motion"], seconds)
            ends = person["motion"]["waypoints"][-1]["at_m"]
            if _is_outside(ends) and not _is_outside(rough[-1]):
                continue
            if not all(_keeps_apart(rough, other) for other in paths):
                continue
            person = _somebody(document["seed"] * 10 + i, i, rng) | person
            trial = {**document, "persons": [*document["persons"], person]}
            try:
                scene = scene_from_dict(trial)
                path = root_paths(scene, only=i)[0]
            except (ValueError, MocapError):
                continue
            if _is_outside(ends) and not _is_outside(path[-1]):
                continue
            if not _keeps_clear(path, plan.table):
                continue
            if all(_keeps_apart(path, other) for other in paths):
                document["persons"].append(person)
                paths.append(path)
                meeting = meets if meeting is None else meeting
                break
        else:
            return False
    inside = np.array([np.all(np.abs(p) < np.array(SIZE_M[:2]) / 2, axis=1) for p in paths])
    pairs = itertools.combinations(range(n_persons), 2)
    encounters = sum(
        n_encounters(
            np.where(inside[a] & inside[b], np.linalg.norm(paths[a] - paths[b], axis=1), np.inf), 1.1
        )
        for a, b in pairs
    )
    stops = [p["motion"]["waypoints"] for p in document["persons"]]
    happens = (
        any(not inside[i, 0] for i in range(n_persons)),
        any(not inside[i, -1] for i in range(n_persons)),
        any(w.get("sit") for way in stops for w in way),
        encounters >= n_persons,
        (inside.sum(axis=0) >= 2).mean() > 0.6,
    )
    return all(happens)


def _itinerary(
    plan: _Plan,
    number: int,
    n_persons: int,
    seconds: float,
    meeting: tuple[Point, float] | None,
    rng: np.random.Generator,
) -> tuple[dict[str, Any] | None, tuple[Point, float] | None]:
    """A person's way: from the door or a place inside over several stops; the spot where it waits for somebody."""
    stops: list[dict[str, Any]] = []
    here: Point
    comes_in = number in (1, 2) or (number > 3 and rng.uniform() < 0.65)
    leaves = number in (0, 3) or rng.uniform() < 0.2
    meets = None
    if comes_in:
        stops.append({"at_m": _point(_outside_door(plan.door))})
        stops.append({"at_m": _point(_inside_door(plan.door))})
        here = _inside_door(plan.door)
        start = float(rng.uniform(0.0, 0.35 * seconds))
    elif number == 3:
        chair = plan.chairs[int(rng.integers(len(plan.chairs)))]
        here = _before(chair)
        stops.append({"at_m": _point(chair.center_m), "heading_deg": chair.heading_deg, "sit": True})
        stops.append({"at_m": _point(here)})
        start = float(rng.uniform(0.5, 4.0))
    else:
        here = _random_place(plan, rng)
        stops.append({"at_m": _point(here), "heading_deg": float(np.round(rng.uniform(-180, 180)))})
        start = float(rng.uniform(0.3, 2.5))
    chairs = [plan.chairs[k] for k in rng.permutation(len(plan.chairs))]
    sits = number == 1 or rng.uniform() < 0.4
    if leaves and seconds < 40:
        sits = False  # or there is no time left to leave
    n_stops = max(1, round(seconds / (20 if number == 3 else 12 if leaves else 8)))
    sit_at = int(rng.integers(n_stops)) if sits else -1
    for k in range(n_stops):
        if k == sit_at:
            chair = chairs.pop()
            target = _before(chair)
            stop = {
                "at_m": _point(chair.center_m),
                "pause_s": round(float(rng.uniform(2.0, 6.0)), 1),
                "heading_deg": chair.heading_deg,
                "sit": True,
            }
        elif meeting is not None and k == 0 and rng.uniform() < 0.6:
            angle = rng.uniform(0, 2 * np.pi)
            target = (
                meeting[0][0] + MEET_M * float(np.cos(angle)),
                meeting[0][1] + MEET_M * float(np.sin(angle)),
            )
            stop = {
                "at_m": _point(target),
                "pause_s": round(float(rng.uniform(1.0, 3.0)), 1),
                "heading_deg": round(float(np.degrees(angle + np.pi)) % 360, 0),
            }
        else:
            target = _random_place(plan, rng)
            waits = number == 0 and k == n_stops - 1
            stop = {"at_m": _point(target)}
            if waits or rng.uniform() < 0.6:
                stop["pause_s"] = round(float(rng.uniform(4.0, 6.0) if waits else rng.uniform(0.5, 2.5)), 1)
            if waits:
                meets = (target, 0.0)
        way = _way(plan, here, target)
        if way is None:
            return None, None
        stops += [{"at_m": _point(p)} for p in way]
        if stop.get("sit"):
            stops.append({"at_m": _point(target)})
        stops.append(stop)
        if stop.get("sit"):
            stops.append({"at_m": _point(target)})
        here = target
    if leaves:
        way = _way(plan, here, _inside_door(plan.door))
        if way is None:
            return None, None
        stops += [{"at_m": _point(p)} for p in (*way, _inside_door(plan.door), _outside_door(plan.door))]
    motion = {
        "kind": "route",
        "speed_m_s": round(float(rng.uniform(0.8, 1.2)), 2),
        "start_s": round(start, 2),
        "waypoints": stops,
    }
    return {"motion": motion}, meets


def _random_place(plan: _Plan, rng: np.random.Generator) -> Point:
    cells = np.argwhere(plan.free)
    i, j = cells[int(rng.integers(len(cells)))]
    return round(i * _CELL_M - SIZE_M[0] / 2, 2), round(j * _CELL_M - SIZE_M[1] / 2, 2)


def _rough_path(motion: dict[str, Any], seconds: float) -> Array:
    """About where a person will be over the frames, (T, 2) m: straight lines, and usual times for turns and seats."""
    stops = motion["waypoints"]
    clock, times, points = motion["start_s"], [-1.0], [stops[0]["at_m"]]
    clock += 1.8 * bool(stops[0].get("sit"))
    heading = None
    for k, (a, b) in enumerate(itertools.pairwise(stops)):
        way = np.subtract(b["at_m"], a["at_m"])
        length = float(np.hypot(*way))
        new = float(np.arctan2(way[1], way[0]))
        is_sharp = heading is not None and abs(np.angle(np.exp(1j * (new - heading)))) > 1.1
        clock += _TURN_S * (is_sharp or k == 0)
        heading = new
        times.append(clock)
        points.append(a["at_m"])
        clock += length / motion["speed_m_s"]
        times.append(clock)
        points.append(b["at_m"])
        if b.get("pause_s"):
            clock += _TURN_S * ("heading_deg" in b) + b["pause_s"] + _SEAT_S * bool(b.get("sit"))
    t = np.arange(round(seconds * FPS)) / FPS
    return np.stack([np.interp(t, times, [p[c] for p in points]) for c in range(2)], axis=1)


def _is_outside(p: Any) -> bool:
    return bool(abs(p[0]) > SIZE_M[0] / 2 or abs(p[1]) > SIZE_M[1] / 2)


def _keeps_clear(path: Array, table: Table) -> bool:
    """Whether nobody cuts a corner through the table.  path : (T, 2) m."""
    corners = table.boxes().reshape(-1, 3)[:, :2]
    low, high = corners.min(axis=0) - TABLE_M, corners.max(axis=0) + TABLE_M
    return not np.all((path > low) & (path < high), axis=1).any()


def _keeps_apart(a: Array, b: Array) -> bool:
    """Whether two persons never run into each other inside the room.  a, b : (T, 2) m."""
    half = np.array(SIZE_M[:2]) / 2 + 0.3
    both = np.all(np.abs(a) < half, axis=1) & np.all(np.abs(b) < half, axis=1)
    return bool(np.all(np.linalg.norm(a - b, axis=1)[both] > APART_M))


def _somebody(seed: int, number: int, rng: np.random.Generator) -> dict[str, Any]:
    """Seed, stature and colours of a person; no two numbers below eight have the same shirt."""
    first = seed // 10 % len(_SHIRTS)
    sex = "male" if rng.uniform() < 0.5 else "female"
    usual, spread = (1.765, 0.07) if sex == "male" else (1.645, 0.065)
    return {
        "seed": seed,
        "sex": sex,
        "height_m": round(float(np.clip(rng.normal(usual, spread), 1.5, 1.95)), 2),
        "colours": {
            "shirt": list(_SHIRTS[(first + 3 * number) % len(_SHIRTS)]),
            "trousers": list(_TROUSERS[int(rng.integers(len(_TROUSERS)))]),
        },
    }


def root_paths(scene: Scene, *, only: int | None = None) -> list[Array]:
    """Where the pelvis of each person is over the frames, (T, 2) m each; bodies are not built for it."""
    out = []
    for i, person in enumerate(scene.persons):
        if only is not None and i != only:
            continue
        if person.height_m is None or person.sex is None:
            raise ValueError(f"person {i} needs height_m and sex")
        figure = make_figure(person.height_m, person.sex, 1.0, rng=rng_at(person.seed, 4))
        pose = MOTIONS[person.motion.kind](
            figure, scene.n_frames, scene.fps, rng=rng_at(person.seed, 6), **person.motion.arguments()
        )
        out.append(pose.root_position[:, :2])
    return out


SCENES: dict[str, tuple[int, dict[str, Any]]] = {
    **{f"meeting_{k:02d}": (300 + k, {"n_persons": n}) for k, n in enumerate((3, 4, 5, 3), 1)},
    **{f"meeting_test_{k:02d}": (3300 + k, {"n_persons": n}) for k, n in enumerate((3, 4, 5, 4), 1)},
    "meeting_long_01": (311, {"n_persons": 4, "seconds": 60.0, "masks_only": True}),
    "meeting_long_test_01": (3311, {"n_persons": 4, "seconds": 60.0, "masks_only": True}),
    "meeting_long_test_02": (3312, {"n_persons": 3, "seconds": 60.0, "masks_only": True}),
    "crossing_01": (321, {}),
    "crossing_test_01": (3321, {}),
}


def write_scenes(folder: Path, names: list[str] | None = None) -> None:
    """Draw the project's meeting and crossing scenes into a folder."""
    for name, (seed, options) in SCENES.items():
        if names and name not in names:
            continue
        if name.startswith("crossing"):
            scene = crossing_scene(seed)
            text = "Two persons in different colours pass each other closely again and again"
        else:
            scene = meeting_scene(seed, **options)
            n, seconds = options["n_persons"], round(options.get("seconds", 20.0))
            text = f"Meeting room: {n} persons enter, cross, meet, sit and leave within {seconds} s"
            text += ", silhouettes only" if options.get("masks_only") else ""
        held_out = "Held out. " if "test" in name else ""
        (folder / f"{name}.toml").write_text(scene_text(scene, held_out + text), encoding="utf-8")


if __name__ == "__main__":
    write_scenes(Path(sys.argv[1]), sys.argv[2:])

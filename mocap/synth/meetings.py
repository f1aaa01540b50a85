"""Meeting-room scenes drawn from a seed: people enter, cross, meet, sit and leave.

The scene files of the project were made with `python -m mocap.synth.meetings mocap/synth/scenes/meetings`; they are
plain TOML with explicit way-points.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
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
    persons = document.pop("persons")
    tables = {k: v for k, v in document.items() if isinstance(v, dict)}
    lines = [f'description = "{description}"']
    lines += [f"{k} = {_toml(v)}" for k, v in document.items() if k not in tables]
    for name, table in tables.items():
        lines += _table_lines(name, table)
    for person in persons:
        lines += _person_lines(person)
    return "\n".join(lines) + "\n"


def _table_lines(name: str, table: dict[str, Any]) -> list[str]:
    """A table of a scene; every piece of furniture has a line of its own."""
    lines = ["", f"[{name}]"]
    for key, value in table.items():
        lines += _list_lines(key, value) if key == "furniture" else [f"{key} = {_toml(value)}"]
    return lines


def _person_lines(person: dict[str, Any]) -> list[str]:
    """A person of a scene; every way-point has a line of its own."""
    motion = person.pop("motion")
    stops = motion.pop("waypoints")
    lines = ["", "[[persons]]", *(f"{k} = {_toml(v)}" for k, v in person.items())]
    lines += ["", "[persons.motion]", *(f"{k} = {_toml(v)}" for k, v in motion.items())]
    return [*lines, *_list_lines("waypoints", stops)]


def _list_lines(key: str, values: list[Any]) -> list[str]:
    return [f"{key} = [", *(f"  {_toml(v)}," for v in values), "]"]


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
        chairs = _chairs(table, door, rng)
        free = _free_cells(table, chairs)
        plan = _Plan(door, table, chairs, free, _graph(free))
        ends = [_before(c) for c in chairs]
        if len(chairs) >= 3 and all(_way(plan, _inside_door(door), e) is not None for e in ends):
            return plan


def _chairs(table: Table, door: Point, rng: np.random.Generator) -> list[Chair]:
    """Up to four chairs round the table and along the walls, clear of each other and of the door."""
    half = np.array(table.size_m if table.heading_deg == 0.0 else table.size_m[::-1]) / 2
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
            about = {"kind": "chair", "center_m": _point((cx, cy)), "heading_deg": heading}
            chairs.append(Chair.model_validate(about))
    return chairs[: int(rng.integers(3, 5))]


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
    cells = _cells_between(plan, start, end)
    return None if cells is None else _shortcut(plan, cells)


def _cells_between(plan: _Plan, start: Point, end: Point) -> list[Point] | None:
    """Start, middles of the cells on the shortest way over the grid, end; None when there is no way."""
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
    return points


def _shortcut(plan: _Plan, points: list[Point]) -> list[Point] | None:
    """The points that are needed when straight free lines join them, ends excluded; None when a step is not free."""
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
    meeting: Point | None = None
    for _ in range(n_persons):
        joined = _join(document, plan, paths, seconds, meeting, rng)
        if joined is None:
            return False
        person, path, meets = joined
        document["persons"].append(person)
        paths.append(path)
        meeting = meets if meeting is None else meeting
    return _is_eventful(document, paths)


def _join(
    document: dict[str, Any],
    plan: _Plan,
    paths: list[Array],
    seconds: float,
    meeting: Point | None,
    rng: np.random.Generator,
) -> tuple[dict[str, Any], Array, Point | None] | None:
    """One more person, its path (T, 2) m and where it waits for somebody; None after 400 vain trials."""
    i = len(paths)
    for _ in range(400):
        motion, meets = _itinerary(plan, i, seconds, meeting, rng)
        if motion is None or not _may_go(_rough_path(motion, seconds), motion, paths):
            continue
        person = _somebody(document["seed"] * 10 + i, i, rng) | {"motion": motion}
        try:
            scene = scene_from_dict({**document, "persons": [*document["persons"], person]})
            path = root_paths(scene, only=i)[0]
        except (ValueError, MocapError):
            continue
        if _keeps_clear(path, plan.table) and _may_go(path, motion, paths):
            return person, path, meets
    return None


def _may_go(path: Array, motion: dict[str, Any], others: list[Array]) -> bool:
    """Whether a path ends outside when the motion does, and keeps apart from the other paths, (T, 2) m all."""
    leaves = _is_outside(motion["waypoints"][-1]["at_m"])
    return (_is_outside(path[-1]) or not leaves) and all(_keeps_apart(path, other) for other in others)


def _is_eventful(document: dict[str, Any], paths: list[Array]) -> bool:
    """Whether somebody enters, somebody leaves, somebody sits, people meet and share the room.  paths : (T, 2) m."""
    n = len(paths)
    inside = np.array([np.all(np.abs(p) < np.array(SIZE_M[:2]) / 2, axis=1) for p in paths])
    encounters = sum(
        n_encounters(
            np.where(inside[a] & inside[b], np.linalg.norm(paths[a] - paths[b], axis=1), np.inf), 1.1
        )
        for a, b in itertools.combinations(range(n), 2)
    )
    stops = [w for person in document["persons"] for w in person["motion"]["waypoints"]]
    happens = (
        not inside[:, 0].all(),
        not inside[:, -1].all(),
        any(w.get("sit") for w in stops),
        encounters >= n,
        (inside.sum(axis=0) >= 2).mean() > 0.6,
    )
    return all(happens)


@dataclass(frozen=True)
class _Stop:
    """A stop of a way.  target : where the walk to it ends.  waypoint : what the route says of it."""

    target: Point
    waypoint: dict[str, Any]
    is_meeting: bool = False

    def along(self, way: list[Point]) -> list[dict[str, Any]]:
        """The way-points of the walk to this stop; a seat is approached and left from before the chair."""
        points = [{"at_m": _point(p)} for p in way]
        if not self.waypoint.get("sit"):
            return [*points, self.waypoint]
        return [*points, {"at_m": _point(self.target)}, self.waypoint, {"at_m": _point(self.target)}]


def _itinerary(
    plan: _Plan, number: int, seconds: float, meeting: Point | None, rng: np.random.Generator
) -> tuple[dict[str, Any] | None, Point | None]:
    """A person's motion: from the door or a place inside over several stops; the spot where it waits for somebody."""
    comes_in = number in (1, 2) or (number > 3 and rng.uniform() < 0.65)
    leaves = number in (0, 3) or rng.uniform() < 0.2
    beginning, here, start = _beginning(plan, number, seconds, comes_in, rng)
    chair = plan.chairs[rng.permutation(len(plan.chairs))[-1]]
    sits = number == 1 or rng.uniform() < 0.4
    if leaves and seconds < 40:
        sits = False  # or there is no time left to leave
    n_stops = max(1, round(seconds / (20 if number == 3 else 12 if leaves else 8)))
    sit_at = int(rng.integers(n_stops)) if sits else -1

    stop_of = partial(_stop, plan, chair, sit_at, meeting, rng, waits_at=n_stops - 1 if number == 0 else -1)
    middle = _visits(plan, here, n_stops, stop_of)
    ending = None if middle is None else _ending(plan, middle.here, leaves)
    if middle is None or ending is None:
        return None, None
    motion = {
        "kind": "route",
        "speed_m_s": round(float(rng.uniform(0.8, 1.2)), 2),
        "start_s": round(start, 2),
        "waypoints": [*beginning, *middle.waypoints, *ending],
    }
    return motion, middle.meeting


def _stop(
    plan: _Plan,
    chair: Chair,
    sit_at: int,
    meeting: Point | None,
    rng: np.random.Generator,
    k: int,
    *,
    waits_at: int,
) -> _Stop:
    """Stop k of a way: the chair, a talk with who waits at the meeting point, or a place somewhere."""
    if k == sit_at:
        return _seat(chair, rng)
    if meeting is not None and k == 0 and rng.uniform() < 0.6:
        return _beside(meeting, rng)
    return _standing(plan, rng, is_meeting=k == waits_at)


@dataclass(frozen=True)
class _Visits:
    """Way-points over several stops, where they end, and the spot where somebody is waited for."""

    waypoints: list[dict[str, Any]]
    here: Point
    meeting: Point | None


def _visits(plan: _Plan, here: Point, n_stops: int, stop_of: Callable[[int], _Stop]) -> _Visits | None:
    """A walk over stops, each drawn when the one before has been reached; None when there is no way to one."""
    waypoints: list[dict[str, Any]] = []
    meeting = None
    for k in range(n_stops):
        stop = stop_of(k)
        way = _way(plan, here, stop.target)
        if way is None:
            return None
        waypoints += stop.along(way)
        here = stop.target
        meeting = here if stop.is_meeting else meeting
    return _Visits(waypoints, here, meeting)


def _ending(plan: _Plan, here: Point, leaves: bool) -> list[dict[str, Any]] | None:
    """The way out by the door for who leaves; None when there is none."""
    if not leaves:
        return []
    way = _way(plan, here, _inside_door(plan.door))
    if way is None:
        return None
    return [{"at_m": _point(p)} for p in (*way, _inside_door(plan.door), _outside_door(plan.door))]


def _beginning(
    plan: _Plan, number: int, seconds: float, comes_in: bool, rng: np.random.Generator
) -> tuple[list[dict[str, Any]], Point, float]:
    """The first way-points, the place where they end, and when the walk begins, s."""
    stops: list[dict[str, Any]]
    if comes_in:
        here = _inside_door(plan.door)
        stops = [{"at_m": _point(_outside_door(plan.door))}, {"at_m": _point(here)}]
        return stops, here, float(rng.uniform(0.0, 0.35 * seconds))
    if number == 3:
        chair = plan.chairs[int(rng.integers(len(plan.chairs)))]
        here = _before(chair)
        stops = [
            {"at_m": _point(chair.center_m), "heading_deg": chair.heading_deg, "sit": True},
            {"at_m": _point(here)},
        ]
        return stops, here, float(rng.uniform(0.5, 4.0))
    here = _random_place(plan, rng)
    stops = [{"at_m": _point(here), "heading_deg": float(np.round(rng.uniform(-180, 180)))}]
    return stops, here, float(rng.uniform(0.3, 2.5))


def _seat(chair: Chair, rng: np.random.Generator) -> _Stop:
    """A while on a chair."""
    about = {
        "at_m": _point(chair.center_m),
        "pause_s": round(float(rng.uniform(2.0, 6.0)), 1),
        "heading_deg": chair.heading_deg,
        "sit": True,
    }
    return _Stop(_before(chair), about)


def _beside(meeting: Point, rng: np.random.Generator) -> _Stop:
    """A talk, face to face with who waits at the meeting point."""
    angle = rng.uniform(0, 2 * np.pi)
    target = (
        meeting[0] + MEET_M * float(np.cos(angle)),
        meeting[1] + MEET_M * float(np.sin(angle)),
    )
    about = {
        "at_m": _point(target),
        "pause_s": round(float(rng.uniform(1.0, 3.0)), 1),
        "heading_deg": round(float(np.degrees(angle + np.pi)) % 360, 0),
    }
    return _Stop(target, about)


def _standing(plan: _Plan, rng: np.random.Generator, *, is_meeting: bool) -> _Stop:
    """A place somewhere in the room, most often with a pause; a long one where others shall come."""
    target = _random_place(plan, rng)
    about: dict[str, Any] = {"at_m": _point(target)}
    if is_meeting or rng.uniform() < 0.6:
        about["pause_s"] = round(float(rng.uniform(4.0, 6.0) if is_meeting else rng.uniform(0.5, 2.5)), 1)
    return _Stop(target, about, is_meeting)


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

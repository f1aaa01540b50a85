"""Turns: nobody turns about within a few frames, so on one side of such a turn the person was followed the wrong way
round.

A first pose that faces the wrong way is kept on until some frame shows the right one clearly; that is one side of the
turn. Each side is followed once more from a pose on the other, and what explains its frames better stays.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body
from mocap.body.kinematics import facing_of
from mocap.pose.deviation import FrameSeries
from mocap.pose.evidence import PersonClip
from mocap.pose.follow import FramePose, note, unbroken
from mocap.pose.method import RepairSettings

Array = NDArray[np.float64]
Follow = Callable[[Sequence[tuple[Array, range]]], Sequence[Sequence[FramePose]]]


def turns_of(body: Body, states: Array, fps: float, settings: RepairSettings) -> list[tuple[int, int]]:
    """Rows (before, after) between which the person of states (T, D), consecutive frames, turns about faster than
    anybody does; none for who lies, or on a body without a yaw."""
    reach = max(1, round(settings.turn_s * fps))
    if body.yaw_column is None or len(states) <= reach:
        return []
    angle, is_level = facing_of(body, states)
    turned = np.cos(angle[reach:] - angle[:-reach]) < settings.turn_cosine
    turned &= is_level[reach:] & is_level[:-reach]
    turns: list[tuple[int, int]] = []
    for row in np.flatnonzero(turned).tolist():
        begin = turns.pop()[0] if turns and row <= turns[-1][1] else row
        turns.append((begin, row + reach))
    return turns


def carry_over_turns(clip: PersonClip, series: FrameSeries, follow: Follow) -> None:
    """Follow one side of every turn in a series once more, in place, from the pose before or after it, over the next
    turn if there is one; whichever side gains more, if any does.

    follow : poses along ways through the clip, each given as the pose (D,) to begin with and the rows in its order.
    """
    tools = clip.observation.tools
    method = tools.settings.method
    if 1.0 / tools.fps >= method.follow.apart_s:
        return  # between pictures far apart one may turn about
    for piece in unbroken(clip.frames):
        seen = -1
        while True:
            # What was carried over one turn may have taken others along.
            turns = turns_of(tools.body, series.states[piece], tools.fps, method.repair)
            ahead = [k for k, (before, _) in enumerate(turns) if before > seen]
            if not ahead:
                break
            seen = turns[ahead[0]][0]
            _carry_over(clip, series, piece, turns, ahead[0], follow)


def _carry_over(
    clip: PersonClip,
    series: FrameSeries,
    piece: slice,
    turns: Sequence[tuple[int, int]],
    k: int,
    follow: Follow,
) -> None:
    """The turn k of those in a piece of the series."""
    before, after = (piece.start + row for row in turns[k])
    first = piece.start + turns[k - 1][0] + 1 if k else piece.start
    stop = piece.start + turns[k + 1][1] if k + 1 < len(turns) else piece.stop
    sides = follow(
        [
            (series.states[after], range(after - 1, first - 1, -1)),
            (series.states[before], range(before + 1, stop)),
        ]
    )
    gain, poses = max(((_gain(clip, series, side), side) for side in sides), key=lambda entry: entry[0])
    if gain > 0:
        for pose in poses:
            note(series, pose.row, pose, clip.observation.tools)


def _gain(clip: PersonClip, series: FrameSeries, poses: Sequence[FramePose]) -> float:
    """How much more evidence poses have than those in their rows of the series, nats."""
    observation, total = clip.observation, 0.0
    for pose in poses:
        prepared = observation.prepare(int(clip.frames[pose.row]))
        if prepared is not None:
            new, old = observation.evidence(prepared).evidence([pose.state, series.states[pose.row]])
            total += float(new - old)
    return total

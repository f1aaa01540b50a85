"""Texture: poses of a whole clip refined once more, on the colours that every place of the body has in all of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array, Indices
from mocap.data.problem import StateLayout
from mocap.forks import can_fork, forked, shared_zeros
from mocap.likelihood.residuals import (
    ColourCounts,
    Crops,
    Texture,
    TextureProblem,
    TextureSettings,
    places_of,
)
from mocap.pose.deviation import FrameSeries, fit_covariance
from mocap.pose.evidence import PersonClip
from mocap.pose.follow import unbroken
from mocap.pose.volume import VolumeObservation

# What is done with the rows of a clip that one process takes, and which of the two it is.
_Half = Callable[[Indices, int], None]


def settle_on_texture(clip: PersonClip, series: FrameSeries) -> None:
    """Refine the poses of some frames on hull, outlines and texture together, and carry those between them along, in
    place.

    A pose that was off one way in one frame and the other way in the next has smeared the texture, and is drawn to the
    middle: what is left of it is what is constant. It is off for a while, not for a frame: every
    `texture_every_frames`-th frame tells enough. The pictures are read twice. Frames without pictures, or without a
    hull, stay as they are where they have no neighbours.
    """
    observation = clip.observation
    assert isinstance(observation, VolumeObservation)
    if observation.pictures_of is None or not len(series):
        return
    tools = observation.tools
    weight, method = tools.settings.texture_weight, tools.settings.method
    texture = texture_of(clip, observation, series)
    # The colours of limbs have had their say.
    observation = observation.with_tools(replace(tools, settings=replace(tools.settings, colour_weight=0.0)))
    found = series.states.copy()
    is_refined = shared_zeros((len(series),), np.bool_)

    def settle(rows: Indices, half: int) -> None:
        for row, crops in _crops(clip, observation, rows):
            prepared = observation.prepare(int(clip.frames[row]))
            if prepared is None:
                continue
            evidence = observation.evidence(prepared)
            problem = TextureProblem.about(texture, crops, series.states[row], weight)
            state = evidence.refined_with(series.states[row], problem)
            fit = evidence.fit(state)
            series.states[row], series.settled[row] = state, problem.compared
            series.fit_covariance[row] = fit_covariance(tools.body, state, fit.information, method.deviation)
            series.misfit[row], series.unexplained[row] = fit.misfit, fit.unexplained
            series.log_likelihood[row] = fit.log_likelihood
            is_refined[row] = True

    every, pieces = tools.settings.texture_every_frames, unbroken(clip.frames)
    rows = [np.unique([*range(piece.start, piece.stop, every), piece.stop - 1]) for piece in pieces]
    _in_halves(settle, np.concatenate(rows), tools.n_threads)
    for piece in pieces:
        own = series.rows(piece)  # views
        _carry_along(tools.body.layout, found[piece], own, np.flatnonzero(is_refined[piece]))


def _carry_along(layout: StateLayout, found: Array, series: FrameSeries, refined: Indices) -> None:
    """Move the poses between refined rows as those have been moved from what was found (T, D), in place."""
    if not len(refined):
        return
    between, moved = np.setdiff1d(np.arange(len(found)), refined), series.states[refined] - found[refined]
    for column in range(layout.n_columns):
        series.states[between, column] += np.interp(between, refined, moved[:, column])
    series.states[between] = np.clip(series.states[between], layout.lower, layout.upper)
    before = refined[np.maximum(np.searchsorted(refined, between) - 1, 0)]
    after = refined[np.minimum(np.searchsorted(refined, between), len(refined) - 1)]
    series.settled[between] = series.settled[before] & series.settled[after]


def texture_of(clip: PersonClip, observation: VolumeObservation, series: FrameSeries) -> Texture:
    """The texture that the poses of a clip teach, by frames spread over it."""
    tools, numbers = observation.tools, TextureSettings()
    places = places_of(tools.body, tools.table, numbers.n_places)
    counts: NDArray[np.int64] = shared_zeros((2, len(places.joint), 3, 256), np.int64)

    def count(rows: Indices, half: int) -> None:
        own = ColourCounts(tools.body, places, counts[half], numbers)
        for row, crops in _crops(clip, observation, rows):
            own.see(crops, series.states[row])

    n = tools.settings.method.evidence.texture_frames
    _in_halves(count, np.unique(np.linspace(0, len(series) - 1, n).astype(np.int64)), tools.n_threads)
    return ColourCounts(tools.body, places, counts.sum(axis=0), numbers).texture


def _crops(clip: PersonClip, observation: VolumeObservation, rows: Indices) -> Iterator[tuple[int, Crops]]:
    """What cameras show around the person, of those rows of the clip in which there is a hull."""
    assert observation.pictures_of is not None
    frames = clip.frames[rows].tolist()
    with observation.pictures_of(frames) as reader:
        for row, (frame, pictures) in zip(rows.tolist(), reader, strict=True):
            hull = observation.hull_of(frame)
            if hull is not None and hull.crops is not None:
                yield row, hull.crops(pictures)


def _in_halves(do: _Half, rows: Indices, n_threads: int) -> None:
    """Do something with all rows: with one half of them in a process of its own where there are threads for it."""
    earlier, later = np.array_split(rows, 2)
    if n_threads > 1 and len(earlier) and len(later) and can_fork():
        with forked(lambda tick: do(later, 1), lambda n: None):
            do(earlier, 0)
    else:
        for half, own in enumerate((earlier, later)):
            if len(own):
                do(own, half)

"""Contacts: when heels and toes rest on the floor, from how high and how fast they are; and held there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data.motion import ALL_LANDMARKS
from mocap.pose.method import ContactSettings

Array = NDArray[np.float64]

# Columns among the landmarks: heel and toe of the left foot, then of the right.
SOLE_POINTS = tuple(
    ALL_LANDMARKS.index(f"{side}_{point}") for side in ("left", "right") for point in ("heel", "toe")
)


@dataclass(frozen=True, eq=False)
class Contacts:
    """What rests on the floor.

    probability : (T, 4), of SOLE_POINTS.  level_m : (4,), height of each while it rests, which is that of the floor but
    for what the body's soles are off.  hold : (T, 4), from 0 to 1, how firmly each may be held: a point that lands or
    leaves still moves.
    """

    probability: Array
    level_m: Array
    hold: Array

    @property
    def runs(self) -> list[list[NDArray[np.int64]]]:
        """Of every sole point the rows of each of its contacts."""
        return [unbroken_runs(own > 0.5) for own in self.probability.T]


def contacts_of(
    points: Array, variance: Array, fps: float, settings: ContactSettings, level: Array | None = None
) -> Contacts:
    """When sole points (T, 4, 3) m, world, rest on the floor.

    variance : (T, 4) m^2, of their heights.  level : (4,) m, how high each is while it rests; None = `lowest_level`.
    A point that rests is as high as its usual lowest place and does not move; one in the air is higher and fast. Both
    states last for a while, so that a frame is judged with its neighbours: the forward-backward recursion of a
    two-state Markov chain. Source: Rabiner 1989.
    """
    T = len(points)
    level = lowest_level(points, settings) if level is None else level
    if T < 2:
        nothing = np.zeros((T, points.shape[1]))
        return Contacts(nothing, level, nothing)
    speed2 = ((np.gradient(points, axis=0) * fps) ** 2).sum(axis=2)
    above = np.maximum(points[..., 2] - level, 0.0)
    height_var = settings.height_std_m**2 + variance
    rests = -0.5 * above**2 / height_var - 0.5 * np.log(height_var)
    still = -0.5 * speed2 / settings.speed_std_m_s**2 - 3 * np.log(settings.speed_std_m_s)
    rests += still
    # In the air: heights are spread evenly over the usual lift of a foot, speeds like those of a swing or, as of the
    # heels of who crouches, like those of a point that rests.
    swings = -0.5 * speed2 / settings.swing_m_s**2 - 3 * np.log(settings.swing_m_s)
    flies = np.logaddexp(np.log(1.0 - settings.still_share) + swings, np.log(settings.still_share) + still)
    flies += -np.log(settings.lift_m) + 0.5 * np.log(2 * np.pi)
    odds = np.clip(rests - flies, -settings.most_nats, settings.most_nats)
    switch = min(0.5, 1.0 / (settings.usual_s * fps))
    probability = np.stack([_smoothed_probability(own, switch) for own in odds.T], axis=1)
    return Contacts(probability, level, probability * np.exp(-0.5 * speed2 / settings.hold_speed_m_s**2))


def lowest_level(points: Array, settings: ContactSettings) -> Array:
    """Usual lowest height of every sole point (T, 4, 3), (4,) m: a low quantile, as a single low frame is noise; the
    floor itself where that is farther from it than a sole can be."""
    if not len(points):
        return np.zeros(points.shape[1])
    low = np.quantile(points[..., 2], settings.low_quantile, axis=0)
    return np.where(np.abs(low) <= settings.most_level_m, low, 0.0)


def held(points: Array, contacts: Contacts, hold_frames: float) -> Array:
    """Sole points (T, 4, 3), those that rest put where they rest, as firmly as they may be held.

    The place is the mean over the frames of the contact within about `hold_frames`, weighted alike: who stands for long
    shifts his feet.
    """
    out = points.copy()
    for k, runs in enumerate(contacts.runs):
        for run in runs:
            weight = contacts.hold[run, k]
            near = np.exp(-0.5 * ((run[:, None] - run) / hold_frames) ** 2) * weight
            share = near.sum(axis=1, keepdims=True)
            place = near @ points[run, k] / np.maximum(share, 1e-9)
            out[run, k] += np.where(share > 1e-9, weight[:, None], 0.0) * (place - points[run, k])
    return out


def slips_m(points: Array, runs: list[list[NDArray[np.int64]]]) -> Array:
    """How far each sole point (T, 4, 3) moves along the floor in each contact, m: the largest distance from the
    contact's middle place, its first and last frame left out, in which a foot lands and leaves."""
    found = []
    for k, own in enumerate(runs):
        for run in own:
            inner = points[run[1:-1], k, :2]
            if len(inner) > 1:
                found.append(np.linalg.norm(inner - np.median(inner, axis=0), axis=1).max())
    return np.array(found)


def unbroken_runs(mask: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """The rows of every unbroken stretch in which a mask (T,) holds."""
    rows = np.split(np.arange(len(mask)), np.flatnonzero(np.diff(mask)) + 1)
    return [run for run in rows if len(run) and mask[run[0]]]


def _smoothed_probability(odds: Array, switch: float) -> Array:
    """Probability (T,) of the first of two states from its log odds (T,) in every frame and the chance of a change."""
    likelihood = np.stack([1 / (1 + np.exp(-odds)), 1 / (1 + np.exp(odds))], axis=1)
    stay = np.array([[1 - switch, switch], [switch, 1 - switch]])
    forward, backward = np.empty_like(likelihood), np.ones_like(likelihood)
    now = np.full(2, 0.5)
    for i, own in enumerate(likelihood):
        now = own * (now @ stay if i else now)
        now /= now.sum()
        forward[i] = now
    for i in range(len(odds) - 2, -1, -1):
        after = stay @ (likelihood[i + 1] * backward[i + 1])
        backward[i] = after / after.sum()
    both = forward * backward
    return np.asarray(both[:, 0] / both.sum(axis=1))

"""Limbs of a body with their landmarks, and legs that have taken each other's place.

A follower can take one leg for the other where they cross behind something, and no search for a single limb brings
both back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, landmarks_of
from mocap.data.problem import limbs_of
from mocap.filters.refine import RefineSettings, refine
from mocap.pose.evidence import FrameEvidence
from mocap.pose.method import LegsSettings
from mocap.pose.point_fit import PointFit

Array = NDArray[np.float64]

_LEG = ("knee", "ankle", "heel", "toe")
_ARM = ("elbow", "wrist", "hand_tip")
_HELD_STD, _FREE_STD = 1e-3, 1e3  # of columns that stay and that move, against residuals of 1 m
_N_ITERATIONS = 12  # legs are within a centimetre of each other's places after six


@dataclass(frozen=True, eq=False)
class Limb:
    """columns : of the state.  landmarks : indices."""

    columns: NDArray[np.int64]
    landmarks: NDArray[np.int64]


@lru_cache(maxsize=16)
def limbs_with_landmarks(body: Body) -> tuple[Limb, ...]:
    """The limbs that have columns and landmarks."""
    layout, parts = body.layout, body.landmark_parts
    found = [
        Limb(np.flatnonzero(np.isin(layout.part_of_column, limb)), np.flatnonzero(np.isin(parts, limb)))
        for limb in limbs_of(layout)
    ]
    return tuple(limb for limb in found if len(limb.columns) and len(limb.landmarks))


@lru_cache(maxsize=16)
def legs_of(body: Body) -> tuple[Limb, Limb] | None:
    """Left and right leg with the landmarks below the hip, in this order; None for a body that has not two of them."""
    return _pair_of(body, _LEG)


@lru_cache(maxsize=16)
def arms_of(body: Body, *, with_hands: bool = True) -> tuple[Limb, Limb] | None:
    """Left and right arm with the landmarks below the shoulder, in this order; None for a body that has not two.

    with_hands : tips of hands are among the landmarks.
    """
    return _pair_of(body, _ARM if with_hands else _ARM[:2])


def _pair_of(body: Body, kinds: Sequence[str]) -> tuple[Limb, Limb] | None:
    sides = []
    for side in ("left", "right"):
        names = [f"{side}_{name}" for name in kinds]
        landmarks = np.array([body.landmarks.index(name) for name in names if name in body.landmarks])
        own = [limb for limb in limbs_with_landmarks(body) if np.isin(landmarks, limb.landmarks).all()]
        sides += [Limb(limb.columns, landmarks) for limb in own]
    return (sides[0], sides[1]) if len(sides) == 2 and sides[0].columns[0] != sides[1].columns[0] else None


def legs_exchanged(evidence: FrameEvidence, state: Array) -> Array | None:
    """A state (D,) with each leg where the other one is, moved to a nearby minimum of the residuals; None for a body
    that has not two legs.
    """
    body, settings = evidence.tools.body, evidence.tools.settings
    legs = legs_of(body)
    if legs is None or not settings.refine:
        return None
    return evidence.all_refined([limbs_exchanged(body, state, legs)], settings.method.legs.n_iterations)[0]


def limbs_exchanged(body: Body, state: Array, pair: tuple[Limb, Limb]) -> Array:
    """A state (D,) with the landmarks of each of two limbs where those of the other one are; the rest stays."""
    left, right = pair
    places = landmarks_of(body, state[None])[0]
    targets = np.concatenate([places[right.landmarks], places[left.landmarks]])
    own = np.concatenate([left.landmarks, right.landmarks])
    return moved_to(body, state, own, targets, np.concatenate([left.columns, right.columns]))


def moved_to(
    body: Body, state: Array, landmarks: NDArray[np.int64], places: Array, columns: NDArray[np.int64]
) -> Array:
    """A state (D,) whose `columns` alone have moved so that landmarks (K,) come near places (K, 3) m."""
    problem = PointFit(body, body.landmark_joint[landmarks], body.landmark_offset[landmarks], places)
    prior_std = np.full(body.layout.n_columns, _HELD_STD)
    prior_std[columns] = _FREE_STD
    return refine(problem, state, RefineSettings(prior_std, 1.0, _N_ITERATIONS))[0]


def in_doubt(
    body: Body, state: Array, rival: Array | None, settings: LegsSettings
) -> tuple[NDArray[np.bool_], Array]:
    """Which landmarks are in doubt because a rival pose (D,) has them elsewhere, (M,) bool, and the standard deviation
    of each that covers both places, (M,) m.
    """
    if rival is None:
        return np.zeros(len(body.landmarks), dtype=np.bool_), np.zeros(len(body.landmarks))
    both = landmarks_of(body, np.stack([state, rival]))
    apart = np.linalg.norm(both[0] - both[1], axis=1)
    is_apart = apart > settings.apart_m
    return is_apart, np.where(is_apart, settings.std_per_apart * apart, 0.0)

"""Smoothing over a whole clip: points of the body in space, then the body fitted to them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body
from mocap.body.kinematics import point_jacobian
from mocap.data import LANDMARKS
from mocap.filters.refine import RefineSettings, refine
from mocap.filters.smoother import smooth_points
from mocap.pose.contacts import SOLE_POINTS, contacts_of, held
from mocap.pose.deviation import FrameSeries, astray_variance, limb_misfit
from mocap.pose.method import Method
from mocap.pose.point_fit import PointFit

Array = NDArray[np.float64]


def smooth_motion(body: Body, series: FrameSeries, fps: float, lag: int, method: Method) -> Array:
    """States (T, D) smoothed over time, inside the limits; every frame looks at `lag` later ones.

    Points of the body are smoothed in space, not angles: near a shoulder's singularity equal poses have angles far
    apart. A point of a limb that fits badly counts less, one that jumps and comes back counts little. Then the body is
    fitted to the smoothed points; heels and toes that rest on the floor are held where they rest.
    """
    numbers = method.smooth
    joint, offset = _handles(body, numbers.handle_m)
    part = body.part_of_joint[joint]
    misfit = limb_misfit(body.layout, series.misfit, method.deviation.most_misfit_nats)[:, part]
    astray = astray_variance(series, method.deviation)[:, None]
    variance = numbers.noise_m**2 + (numbers.noise_per_nat_m * misfit) ** 2 + astray
    points = np.stack([point_jacobian(body, s, joint, offset)[0] for s in series.states])
    push = np.full(len(joint), numbers.acceleration_m_s2 / fps**2)
    smoothed, _, _ = smooth_points(points, variance, push, lag=lag)
    weight = np.ones(smoothed.shape[:2])
    if len(body.landmarks) > len(LANDMARKS) and method.contact.hold > 0:
        # The landmarks are the first of the points.
        sole = list(SOLE_POINTS)
        contacts = contacts_of(smoothed[:, sole], variance[:, sole], fps, method.contact)
        smoothed[:, sole] = held(smoothed[:, sole], contacts, method.contact.hold_s * fps)
        weight[:, sole] += (method.contact.hold - 1.0) * contacts.hold
    fits = [
        PointFit(body, joint, offset, places, np.sqrt(own)[:, None])
        for places, own in zip(smoothed, weight, strict=True)
    ]
    return _fitted(fits, series.states, numbers.n_iterations)


def carried_over(states: Array, body: Body, other: Body, method: Method) -> Array:
    """States (T, D) of another size of the same body, whose points stay where they are as well as its lengths allow."""
    joint, offset = _handles(body, method.smooth.handle_m)
    fits = [PointFit(other, joint, offset, point_jacobian(body, s, joint, offset)[0]) for s in states]
    return _fitted(fits, states, method.smooth.n_iterations)


def _fitted(fits: Sequence[PointFit], starts: Array, n_iterations: int) -> Array:
    """States (T, D) of the fits of frames, each from its own start (T, D) or the frame before."""
    states = np.empty_like(starts)
    settings = RefineSettings(
        prior_std=np.full(starts.shape[1], 1e3), residual_std_m=1.0, n_iterations=n_iterations
    )
    for i, fit in enumerate(fits):
        start = min([starts[i], *([states[i - 1]] if i else [])], key=fit.cost)
        states[i] = refine(fit, start, settings)[0]
    return states


def _handles(body: Body, handle_m: float) -> tuple[NDArray[np.int64], Array]:
    """Points that say where the whole body is: the landmarks, and two for the direction of every joint that turns about
    more than one axis.  Returns joints (K,) and offsets (K, 3) m in their frames."""
    turning = [j for j in range(len(body.joints)) if (body.dof_joint == j).sum() > 1]
    handles = handle_m * np.eye(3)[[0, 1]]
    joint = np.concatenate([body.landmark_joint, np.repeat(turning, 2)]).astype(np.int64)
    return joint, np.concatenate([body.landmark_offset, *([handles] * len(turning))])

"""Edits of poses: what somebody who looked at a result knows better, worked into the frames that were followed.

An edit is a repair that a person orders: the poses are not followed anew, but changed in the frames that it speaks of
and carried to their neighbours by the evidence, before all is smoothed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, landmarks_of
from mocap.data.problem import ResidualProblem
from mocap.geometry.rigid import wrap_angle
from mocap.pose.deviation import FrameSeries, fit_covariance
from mocap.pose.evidence import FrameEvidence
from mocap.pose.follow import unbroken
from mocap.pose.limbs import Limb, arms_of, legs_of, limbs_exchanged, limbs_with_landmarks, moved_to
from mocap.pose.method import EditSettings
from mocap.pose.point_fit import PointFit
from mocap.pose.repair import carried
from mocap.pose.result import FollowedPerson

Array = NDArray[np.float64]
Sides = Literal["legs", "arms", "body"]


class EditedEvidence(FrameEvidence, Protocol):
    """Evidence of a frame in which a landmark can be pinned."""

    def refined_with(self, state: Array, other: ResidualProblem) -> Array:
        """A state (D,) moved to a nearby minimum of the evidence's cost and of another one, nats."""
        ...


EvidenceOf = Callable[[int], EditedEvidence | None]


@dataclass(frozen=True)
class Pin:
    """Where a landmark is in a frame.  place_m : world, m."""

    frame: int
    landmark: str
    place_m: tuple[float, float, float]


@dataclass(frozen=True)
class Exchange:
    """Frames in which left and right have changed places: of the legs, of the arms, or of the whole body, which then
    faces the other way."""

    frames: range
    sides: Sides = "body"


@dataclass(frozen=True)
class PoseEdits:
    """The edits of one person's poses.  bad : frames whose evidence is not to be believed."""

    exchanges: tuple[Exchange, ...] = ()
    pins: tuple[Pin, ...] = ()
    bad: tuple[range, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.exchanges or self.pins or self.bad)


def edited(followed: FollowedPerson, edits: PoseEdits, evidence_of: EvidenceOf) -> FollowedPerson:
    """A person's frames with edits worked in: exchanges, then pins, then bad frames.

    evidence_of : row -> what poses are judged by there, None where too little is seen.
    Raises ValueError for a landmark that the body has not.
    """
    work = _Frames(followed, evidence_of)
    for exchange in edits.exchanges:
        for row in work.rows_in(exchange.frames):
            work.set(row, exchanged(followed.body, work.states[row], exchange.sides), is_refined=True)
    for pin in edits.pins:
        for row in work.rows_in(range(pin.frame, pin.frame + 1)):
            _pin(work, row, pin)
    is_bad = np.zeros(len(followed.frames), dtype=np.bool_)
    for frames in edits.bad:
        is_bad[work.rows_in(frames)] = True
    return _without(replace(followed, series=work.series, information=work.information), is_bad)


def exchanged(body: Body, state: Array, sides: Sides) -> Array:
    """A state (D,) with left and right exchanged; itself for a body that has not two of them."""
    if sides == "body":
        return _turned(body, state)
    pair = legs_of(body) if sides == "legs" else arms_of(body)
    return state if pair is None else limbs_exchanged(body, state, pair)


def _turned(body: Body, state: Array) -> Array:
    """The pose whose left landmarks are where the right ones are, and the other way round: it faces the other way."""
    names = body.landmarks
    other = np.array([names.index(_other_side(name)) for name in names])
    start = state.copy()
    if body.yaw_column is not None:
        start[body.yaw_column] = wrap_angle(start[body.yaw_column] + np.pi)
    places = landmarks_of(body, state[None])[0][other]
    return moved_to(body, start, np.arange(len(names)), places, np.arange(len(state)))


def _other_side(name: str) -> str:
    side, _, rest = name.partition("_")
    return f"{ {'left': 'right', 'right': 'left'}[side] }_{rest}" if side in ("left", "right") else name


def reach_gap_m(body: Body, state: Array, landmark: str, place_m: Sequence[float]) -> float:
    """How far a landmark stays from a place, m, when the limb that bears it is stretched for it."""
    at = body.landmarks.index(landmark)
    place = np.asarray(place_m, dtype=np.float64)[None]
    moved = moved_to(body, state, np.array([at]), place, _limb_of(body, at).columns)
    return float(np.linalg.norm(landmarks_of(body, moved[None])[0, at] - place[0]))


def _limb_of(body: Body, landmark: int) -> Limb:
    """The limb that bears a landmark, or all of the body for one of the trunk."""
    for limb in limbs_with_landmarks(body):
        if landmark in limb.landmarks:
            return limb
    return Limb(np.arange(body.layout.n_columns), np.array([landmark]))


def _pin(work: _Frames, row: int, pin: Pin) -> None:
    """The landmark moved to its place with all that hangs on it, and its limb carried on to both sides."""
    body, numbers = work.followed.body, work.numbers
    at = body.landmarks.index(pin.landmark)
    limb, place = _limb_of(body, at), np.array([pin.place_m])
    state = moved_to(body, work.states[row], np.array([at]), place, limb.columns)
    point = PointFit(
        body, body.landmark_joint[[at]], body.landmark_offset[[at]], place, 1.0 / numbers.pin_std_m
    )
    evidence = work.evidence_of(row)
    if evidence is not None:
        state = evidence.refined_with(state, point)
    work.set(row, state, is_refined=False, pinned=(at, point))
    piece = next(piece for piece in unbroken(work.followed.frames) if piece.start <= row < piece.stop)
    own = work.states[piece].copy()
    for step in (-1, 1):
        found = carried(
            body,
            own,
            row - piece.start,
            step,
            (limb,),
            lambda k: work.evidence_of(piece.start + k),
            work.followed.tools.settings.method.repair,
        )
        for k, state in found:
            work.set(piece.start + k, state, is_refined=False)


class _Frames:
    """The frames of a person while they are edited."""

    def __init__(self, followed: FollowedPerson, evidence_of: EvidenceOf) -> None:
        self.followed, self.evidence_of = followed, evidence_of
        self.numbers: EditSettings = followed.tools.settings.method.edits
        self.series = copied(followed.series)
        self.information = None if followed.information is None else followed.information.copy()

    @property
    def states(self) -> Array:
        return self.series.states

    def rows_in(self, frames: range) -> list[int]:
        """Rows of the frames in which the person is."""
        return [row for row, frame in enumerate(self.followed.frames) if int(frame) in frames]

    def set(
        self, row: int, state: Array, *, is_refined: bool, pinned: tuple[int, ResidualProblem] | None = None
    ) -> None:
        """Give a row another state.  is_refined : it is moved to a minimum of the residuals first.  pinned : landmark
        that is known for sure, and the problem that holds it, in nats."""
        series, body, evidence = self.series, self.followed.body, self.evidence_of(row)
        information = np.zeros((len(state),) * 2)
        series.doubtful[row], series.settled[row] = False, False
        if evidence is not None:
            state = evidence.all_refined([state])[0] if is_refined else state
            fit = evidence.fit(state)
            information = fit.information
            series.misfit[row], series.unexplained[row] = fit.misfit, fit.unexplained
            series.hidden_std[row] = np.where(fit.judged, 0.0, series.hidden_std[row])
            series.observed[row], series.log_likelihood[row] = fit.observed, fit.log_likelihood
        series.states[row] = state
        if pinned is not None:
            landmark, problem = pinned
            information = information + problem.normal_equations(state)[1]
            series.hidden_std[row, landmark] = 0.0
            series.observed[row, landmark] = True
        if self.information is not None:
            self.information[row] = information
        if self.followed.tools.settings.refine:
            deviation = self.followed.tools.settings.method.deviation
            series.fit_covariance[row] = fit_covariance(body, state, information, deviation)


def copied(series: FrameSeries) -> FrameSeries:
    """A series that may be changed."""
    return FrameSeries(**{field.name: getattr(series, field.name).copy() for field in fields(series)})


def _without(followed: FollowedPerson, is_bad: NDArray[np.bool_]) -> FollowedPerson:
    """The frames with the bad ones bridged: poses on the way from the last good one to the next, nothing observed."""
    if not is_bad.any() or is_bad.all():
        return followed
    body, series, frames = followed.body, copied(followed.series), followed.frames
    good = np.flatnonzero(~is_bad)
    blind_m = followed.tools.settings.method.follow.blind_std_m
    step_m = float(followed.tools.noise_std[0])
    for name in ("fit_covariance", "misfit", "unexplained", "hidden_std", "observed", "doubtful", "settled"):
        getattr(series, name)[is_bad] = 0
    for name in ("log_likelihood", "ess_share"):
        getattr(series, name)[is_bad] = np.nan
    information = None
    if followed.information is not None:
        information = np.where(is_bad[:, None, None], 0.0, followed.information)
    for row in np.flatnonzero(is_bad):
        after = int(np.searchsorted(good, row))
        a, b = good[max(after - 1, 0)], good[min(after, len(good) - 1)]
        share = 0.0 if a == b else float(frames[row] - frames[a]) / float(frames[b] - frames[a])
        way = series.states[b] - series.states[a]
        way = np.where(body.layout.is_circular, wrap_angle(way), way)
        series.states[row] = series.states[a] + share * way
        n_away = min(abs(int(frames[row] - frames[end])) for end in (a, b))
        series.blind_std[row] = np.hypot(blind_m, n_away * step_m)
    return replace(followed, series=series, information=information)

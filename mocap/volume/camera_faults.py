"""Camera faults told from silhouettes and pictures over a whole recording: moved, lagging, frozen, black, misplaced.

For each camera an exact piecewise-constant fit (a shortest path over frames) chooses in every frame between "in
time", "lags by L frames" and "does not fit at any lag". A frame costs the share of the mask that its state leaves
unexplained, in units of the usual share; a change of state has a fixed price, so that single bad masks do not pay.
What the stretches of other states mean is then decided with the pictures, if there are any.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import CameraRig, Occluders
from mocap.volume.consistency import (
    FRAME_S,
    MAX_LAG_FRAMES,
    MIN_CELLS,
    SHRINK,
    ConsistencyMonitor,
    SilhouetteEvidence,
    Snapshot,
)
from mocap.volume.rig_agreement import MaskSample, Misfit, rig_agreement
from mocap.volume.rig_doubts import doubt_rig
from mocap.volume.synchrony import ClockEstimate, SynchronySettings, synchronise

Array = NDArray[np.float64]
Kind = Literal[
    "moved",
    "lag",
    "rate",
    "frozen",
    "black",
    "blind",
    "misfit",
    "scene",
    "calibration",
    "rig",
    "exchanged",
    "repeats",
    "flicker",
]

# The fit. Prices are in units of the usual unexplained share (at least 1 % of the mask): a change of state must save
# twelve such frames, and a lag must be better than none by a fifth of one in every frame.
_USUAL_SHARE = 0.01
_USUAL_FACTOR = 3.0
_LARGEST_SHARE = 0.5
_LARGEST_COST = 10.0  # of one frame, so that a single hull that failed decides nothing
_OFF_SHARE = 0.15
_OFF_COST = 8.0
_LAG_PRICE = 0.2
_CHANGE_PRICE = 12.0
_MIN_GAIN = 12.0
_MIN_FRAMES = 5
_LASTING_FRAMES = 25  # a lag or a misfit that fewer frames tell of is no fault of the camera
_JOIN_FRAMES = 8  # stretches closer than this are one
# A lag explains a stretch when it leaves at most this share of what no lag leaves.
_LAG_LEAVES = 0.3
_DRIFT_PER_FRAME = 0.7  # a clip of half the rate drifts by half a frame
_SHIFT_LEAVES = 0.5
_SAME_TIME_FRAMES = 3
_SHARPEN_FRAMES = 12
# A mask after lost pictures, against its change before and behind: 3.9 and 3.1 times where four and three were lost
# (scenes fault_dropped and fault_dropped_test, a scratch script); 1.5 near the frame at which a healthy camera seemed
# to have lost eight.
_LOST_JUMP, _JUMP_FRAMES = 2.0, 8
# Frozen: the mask changes this much less than the others', or the picture than its own usual noise.
_FROZEN_MASK_CHANGE = 0.005
_MOVING_MASK_CHANGE = 0.05
_FROZEN_PICTURE_SHARE = 0.25
_BLACK_LEVEL, _BLACK_CONTRAST = 16.0, 6.0
# Background shift: cells (of 4 px) that count as moved; the noise on steady cameras is below 0.2.
_MOVED_CELLS = 0.5
# A camera that moves shifts all of its background alike: most points by the median, but for so many cells or such a
# share of it. A shadow or a light that creeps over a wall moves some points and not others.
_ALIKE_CELLS, _ALIKE_SHARE, _MOST = 0.25, 0.3, 0.6
_MIN_POINTS = 6
_N_LOOKS = 16
# One camera of seven off by so much costs less than doing without it (`python -m eval.fault_table`: 1.3 and 1.7 cm).
_HARMLESS_M = 0.025
# Pictures given twice, of those that would tell; jumps of brightness against the last picture, and their share. Healthy
# cameras of the development scenes have 0 to 2 % of the first and none of the others.
_REPEATED_SHARE = 0.1
_JUMP, _JUMP_SHARE = 0.1, 0.25
_STILL_SHARE = 0.6  # of the snapshots in which a cell is foreground
# Clocks are looked for as far as silhouettes are, where outlines overlap by half a second, and one must be off by more
# than the half frame between neighbouring pictures, and another for what a lag of one frame costs.
_CLOCKS = SynchronySettings(max_lag_s=MAX_LAG_FRAMES * FRAME_S, least_overlap_s=0.5)
_LATE_FRAMES = 1.5
# What a lag must explain of a camera's masks, share of a mask: late cameras of the development scene 0.012 to 0.13,
# cameras whose clock misleads where somebody sits down 0.001 at most.
_LATE_EXPLAINS = 0.005


@dataclass(frozen=True)
class CameraFault:
    """What is wrong with a camera, from which frame on.

    kind : moved; lag (lag_frames > 0: old pictures, < 0: they come early); rate (the lag grows steadily); frozen;
    black; blind (it sees nobody where the others see a person); misfit (its masks do not fit, for a reason that the
    masks do not tell); scene (camera "": several cameras at once, so the light or the room has changed); calibration
    (it stands elsewhere than its calibration says, all the time); rig (camera "": cameras disagree all the time, and
    it cannot be told which); exchanged (it films what another one, `exchanged_with`, should); repeats (some pictures
    are those before); flicker (its brightness jumps from picture to picture).
    first_frame, last_frame : inclusive.  is_to_end : last_frame is the last of the recording.
    shift_px : how far the picture's background, or else its silhouettes, moved (u, v).
    offset_m : by how much lines of sight miss at the people, of calibration and rig.  turn_deg, shift_m : the rotation,
    or else the shift, that a camera is off by.  share : of the pictures that repeat or jump.
    """

    camera: str
    kind: Kind
    first_frame: int
    last_frame: int
    is_from_start: bool
    is_to_end: bool
    lag_frames: int = 0
    shift_px: tuple[float, float] | None = None
    offset_m: float = 0.0
    turn_deg: float = 0.0
    shift_m: float = 0.0
    exchanged_with: str = ""
    share: float = 0.0

    @property
    def is_harmless(self) -> bool:
        """Whether the camera is worth more than what is wrong with it.

        Clocks that differ by half a frame look like a lag of one frame. Pictures that repeat now and then, and jumps of
        brightness, cost next to nothing (`python -m eval.fault_table`: 0.4 mm).
        """
        if self.kind in ("repeats", "flicker"):
            return True
        return abs(self.lag_frames) == 1 or (self.kind == "calibration" and self.offset_m < _HARMLESS_M)

    @property
    def message(self) -> str:
        """One sentence for the user."""
        who = f"camera {self.camera}"
        if self.kind == "moved":
            return self._moved
        frames = f"{abs(self.lag_frames)} frame{'s' * (abs(self.lag_frames) != 1)}"
        if self.kind == "lag" and self.lag_frames < 0 and not self.is_from_start:
            return f"{who} is {frames} early {self._when}: its file has lost pictures"
        return {
            "lag": f"{who} {'lags' if self.lag_frames > 0 else 'is early by'} {frames} {self._when}",
            "rate": f"{who} runs away from the others {self._when}: another frame rate, or a clock that drifts",
            "frozen": f"{who} repeats one picture {self._when}",
            "black": f"{who} is black {self._when}",
            "blind": f"{who} sees nobody where the others see a person {self._when}: hidden, or not segmented",
            "misfit": f"the masks of {who} do not fit those of the other cameras {self._when}",
            "scene": f"the masks of several cameras stop fitting together at frame {self.first_frame}: "
            "the light or the room has changed",
            "calibration": f"{who} does not stand where its calibration says: its lines of sight miss the people by "
            f"{100 * self.offset_m:.1f} cm, as if it were turned by {self.turn_deg:.1f} degrees or shifted by "
            f"{100 * self.shift_m:.0f} cm{self._far}",
            "exchanged": f"{who} shows what camera {self.exchanged_with} should, and the other way round",
            "repeats": f"{who} gives {100 * self.share:.0f} % of its pictures twice, in place of new ones",
            "flicker": f"the brightness of {who} jumps in {100 * self.share:.0f} % of its pictures",
            "rig": f"the cameras do not agree with each other: their lines of sight miss each other by "
            f"{100 * self.offset_m:.1f} cm at the people, and it cannot be told whose calibration is wrong",
        }[self.kind]

    @property
    def _far(self) -> str:
        return "" if self.shift_px is None else f" (its picture shifts by {np.hypot(*self.shift_px):.0f} px)"

    @property
    def _when(self) -> str:
        if self.is_from_start and self.is_to_end:
            return "all the time"
        if self.is_to_end:
            return f"from frame {self.first_frame} on"
        return f"in frames {self.first_frame} to {self.last_frame}"

    @property
    def _moved(self) -> str:
        who = f"camera {self.camera}"
        if self.is_from_start:
            return f"{who} does not stand where the calibration says{self._far}, {self._when}"
        back = "" if self.is_to_end else f" and back at frame {self.last_frame + 1}"
        return f"{who} moved at frame {self.first_frame}{back}{self._far}"


def find_camera_faults(
    evidence: SilhouetteEvidence, each: Callable[..., Iterable[Any]] = map
) -> tuple[CameraFault, ...]:
    """Faults of all cameras, by first frame; nothing for fewer than five frames or fewer than three cameras.

    each : `map`, perhaps over threads.
    One bad camera at a time is found surely; the hull of the others allows no more. Whoever stands still hides a
    lag, and a camera that turns by less than about a degree shows only in its pictures.
    """
    n_frames, n_cameras = evidence.mask_cells.shape
    if n_frames < _MIN_FRAMES or n_cameras < 3:
        return ()
    unexplained = evidence.uncovered.astype(np.float64)
    found: list[CameraFault] = []
    for c in range(n_cameras):
        for fault, rows in _without_picture(evidence, c):
            found.append(fault)
            unexplained[rows, c] = np.nan
        found += _now_and_then(evidence, c)
    moved = list(each(partial(_background_moves, evidence), range(n_cameras)))
    for c, own in enumerate(moved):
        for first, stop, shift in own:
            found.append(replace(_fault(evidence, c, "moved", first, stop), shift_px=shift))
            unexplained[first:stop, c] = np.nan
    found += _without_common_cause(_doubted(evidence, unexplained), n_cameras)
    return tuple(sorted(found, key=lambda f: (f.first_frame, f.camera)))


def find_faults(
    monitor: ConsistencyMonitor, guessed: Sequence[str] = (), each: Callable[..., Iterable[Any]] = map
) -> tuple[CameraFault, ...]:
    """What `find_camera_faults`, `find_misfits` and `find_exchanged` say of a recording, by first frame.

    A camera that never fits is judged by its outlines, which tell how far it is off; so is one that seems to lag where
    its clock says that it does not.  guessed : cameras whose outlines are guesses: neither they nor others are judged
    by them.  each : `map`, perhaps over threads.
    """
    evidence = monitor.evidence()
    faults = find_camera_faults(evidence, each)
    known = [fault for fault in faults if not _is_refuted(fault, monitor)]
    samples = monitor.mask_samples()
    misfits = find_misfits(monitor.rig, samples, known, monitor.occluders, guessed, each)
    named = {fault.camera for fault in misfits if fault.camera}
    surely = [fault for fault in known if not _is_late_by_a_frame(fault)]
    if named and len(surely) < len(known):
        # The hull that tells who is late had that camera in it, and one frame is what a wrong hull comes to.
        more = find_misfits(monitor.rig, samples, surely, monitor.occluders, guessed, each)
        misfits = more if {fault.camera for fault in more} > named else misfits
    # Two that film each other's place look like two that are turned, or like two that see nobody.
    is_off = len(misfits) == 2 or any(fault.kind == "rig" for fault in misfits)
    if is_off or _n_never_fitting(faults) == 2 or _has_no_volume(evidence):
        misfits = find_exchanged(monitor.rig, evidence, monitor.outlines()) or misfits
    named = {fault.camera for fault in misfits if fault.camera}
    faults = tuple(f for f in faults if f.camera not in named)
    return tuple(sorted(faults + misfits, key=lambda f: (f.first_frame, f.camera)))


def _n_never_fitting(faults: Sequence[CameraFault]) -> int:
    """How many cameras have masks that never fit, or never show anybody where the others see somebody."""
    never = (f for f in faults if f.kind in ("blind", "misfit") and f.is_from_start and f.is_to_end)
    return len({fault.camera for fault in never})


def _is_late_by_a_frame(fault: CameraFault) -> bool:
    return fault.kind == "lag" and abs(fault.lag_frames) == 1 and fault.is_from_start and fault.is_to_end


def find_late(monitor: ConsistencyMonitor, faults: Sequence[CameraFault]) -> tuple[CameraFault, ...]:
    """The cameras that lag or are early for certain, when several are blamed or nobody can be.

    Two cameras that are late make healthy ones look early, as the hull of the others is of two moments. Clocks know
    nothing of volumes: they come from what pairs of cameras see, solved for all of them at once, and whose clock most
    others share is right. Of somebody who hardly moves they tell too much: the lag must explain masks too.
    faults : what is said of the cameras.
    """
    blamed = {f.camera for f in faults if f.kind in ("lag", "rate", "moved", "misfit", "scene", "rig")}
    if "" in blamed:
        blamed = set(monitor.rig.names)
    if len(blamed) < 2:
        return ()
    clocks = {name: clock for name, clock in _clocks(monitor).items() if clock.is_off and name in blamed}
    by_frames = {name: -clock.offset_s / FRAME_S for name, clock in clocks.items()}
    lags = {n: round(lag) for n, lag in by_frames.items() if _LATE_FRAMES < abs(lag) <= MAX_LAG_FRAMES}
    if 2 * len(lags) >= len(monitor.rig):
        return ()
    evidence, names = monitor.evidence(), monitor.rig.names
    first, *_, last = evidence.frames.tolist()
    return tuple(
        CameraFault(name, "lag", first, last, True, True, lag_frames=lag)
        for name, lag in lags.items()
        if _explained_by(evidence, names.index(name), lag) >= _LATE_EXPLAINS
    )


def _explained_by(evidence: SilhouetteEvidence, c: int, lag_frames: int) -> float:
    """How much less of a camera's masks is left unexplained when it lags, mean share over the frames."""
    shares = np.minimum(evidence.uncovered[:, c], _LARGEST_SHARE)
    gain = shares[:, MAX_LAG_FRAMES] - shares[:, MAX_LAG_FRAMES + lag_frames]
    return float(np.nan_to_num(_mean(gain[np.isfinite(gain)])))


def _clocks(monitor: ConsistencyMonitor) -> Mapping[str, ClockEstimate]:
    return synchronise(monitor.rig, monitor.silhouettes(), _CLOCKS).clocks


def _is_refuted(fault: CameraFault, monitor: ConsistencyMonitor) -> bool:
    """Whether a camera seems to lag all the time, and its clock says for certain that it does not: a camera that stands
    elsewhere than its calibration says sees people where they were before."""
    if fault.kind != "lag" or not (fault.is_from_start and fault.is_to_end):
        return False
    clock, lag_s = _clocks(monitor)[fault.camera], FRAME_S * fault.lag_frames
    is_nearer_to_none = abs(clock.offset_s) < 0.5 * abs(lag_s)
    far_s = abs(lag_s + clock.offset_s)
    return clock.is_certain and is_nearer_to_none and far_s > _CLOCKS.certain * clock.offset_std_s


def find_misfits(
    rig: CameraRig,
    samples: Sequence[MaskSample],
    faults: Sequence[CameraFault] = (),
    occluders: Occluders | None = None,
    guessed: Sequence[str] = (),
    each: Callable[..., Iterable[Any]] = map,
) -> tuple[CameraFault, ...]:
    """Cameras that stand elsewhere than their calibration says all the time, of two at most; or that the rig disagrees.

    samples : of the whole clip, in order.  faults : known of cameras, which are not judged then, unless a wrong
    calibration may be the reason.  guessed : cameras whose outlines are guesses, and say nothing.  each : `map`,
    perhaps over threads.
    """
    if len(samples) < _MIN_FRAMES:
        return ()
    silent = {f.camera for f in faults if f.kind != "flicker" and not _may_be_calibration(f)}
    silent |= set(guessed)
    is_well = [name not in silent for name in rig.names]
    samples = [
        replace(sample, masks=[m if w else None for m, w in zip(sample.masks, is_well, strict=True)])
        for sample in samples
    ]
    found = rig_agreement(rig, samples, occluders, each=each)
    whole = CameraFault("", "rig", samples[0].frame, samples[-1].frame, True, True, offset_m=found.offset_m)
    if found.misfits:
        return tuple(_miscalibrated(replace(whole, camera=name), m) for name, m in found.misfits.items())
    return () if found.is_decided or not np.isfinite(found.offset_m) else (whole,)


def find_exchanged(
    rig: CameraRig, evidence: SilhouetteEvidence, outlines: Sequence[Sequence[Array]]
) -> tuple[CameraFault, ...]:
    """Two cameras that film what the other one should, if that explains why people do not fit the calibration.

    outlines : convex hulls of silhouettes, as of `doubt_rig`.
    """
    doubt = doubt_rig(rig, outlines)
    if doubt.mistake != "exchanged":
        return ()
    whole = CameraFault("", "exchanged", int(evidence.frames[0]), int(evidence.frames[-1]), True, True)
    one, other = doubt.cameras
    return (
        replace(whole, camera=one, exchanged_with=other),
        replace(whole, camera=other, exchanged_with=one),
    )


def _has_no_volume(evidence: SilhouetteEvidence) -> bool:
    """Whether most masks of somebody meet no volume that the cameras agree on."""
    is_seen = evidence.mask_cells >= MIN_CELLS
    n_lost = int(np.count_nonzero(is_seen & (evidence.hull_cells < MIN_CELLS)))
    return n_lost > 0.5 * max(int(np.count_nonzero(is_seen)), 1)


def _may_be_calibration(fault: CameraFault) -> bool:
    return fault.kind in ("moved", "misfit") and fault.is_from_start and fault.is_to_end


def _miscalibrated(fault: CameraFault, misfit: Misfit) -> CameraFault:
    return replace(
        fault,
        kind="calibration",
        shift_px=misfit.shift_px,
        offset_m=misfit.offset_m,
        turn_deg=misfit.turn_deg,
        shift_m=misfit.shift_m,
    )


def _without_picture(evidence: SilhouetteEvidence, c: int) -> list[tuple[CameraFault, slice]]:
    """Stretches in which a camera gives no new picture, and the rows in which its masks say nothing."""
    found: list[tuple[CameraFault, slice]] = []
    plain: tuple[tuple[Kind, list[tuple[int, int]]], ...] = (
        ("black", _black(evidence, c)),
        ("frozen", _frozen(evidence, c)),
    )
    for kind, stretches in plain:
        for first, stop in stretches:
            if not any(_overlap(fault, evidence, first, stop) for fault, _ in found):
                found.append((_fault(evidence, c, kind, first, stop), slice(max(first - 1, 0), stop)))
    return found


def _doubted(evidence: SilhouetteEvidence, unexplained: Array) -> list[CameraFault]:
    """Faults that silhouettes tell alone.  unexplained : (T, C, 2 W + 1) shares per lag, NaN = unknown."""
    n_frames, n_cameras = unexplained.shape[:2]
    usual = max(_USUAL_SHARE, _USUAL_FACTOR * _median(np.min(unexplained, axis=2, initial=np.inf)))
    doubted = []
    for c in range(n_cameras):
        for first, stop, states in _odd_stretches(unexplained[:, c], usual):
            fault = _diagnose(evidence, unexplained[:, c], c, first, stop, states, usual)
            is_passing = evidence.is_furnished or 2 * (stop - first) <= n_frames
            is_excused = fault.kind == "moved" or (fault.kind == "misfit" and is_passing)
            if is_excused and _background_stands(evidence, c, first, stop):
                # Its mask holds what the hull of the others lacks: somebody whom too few of them see. What it holds
                # too much takes nothing from the volume; without it, of few cameras, a person loses his shape.
                continue
            # Pictures that a file has lost do not come back, nor does a clock that drifts.
            is_for_good = fault.lag_frames < 0 or fault.kind == "rate"
            if is_for_good and _is_in_time(unexplained[stop:, c], int(states[-1]), usual):
                continue
            # Where pictures were lost, people are elsewhere all at once.
            is_sudden = fault.lag_frames < -1 and not fault.is_from_start
            if is_sudden and not _have_jumped(evidence.change[:, c], _row_of(evidence, fault.first_frame)):
                continue
            # Who comes in is seen by one camera first, and by the hull a few frames later; who leaves, by one last.
            # No lag.
            told = (evidence.frames >= fault.first_frame) & (evidence.frames <= fault.last_frame)
            n_known = np.count_nonzero(np.isfinite(unexplained[told, c, MAX_LAG_FRAMES]))
            lasts = n_known >= min(_LASTING_FRAMES, n_frames // 2)
            if lasts or fault.kind not in ("lag", "misfit"):
                doubted.append(fault)
    return doubted


def usable_cameras(
    faults: Sequence[CameraFault], names: Sequence[str], frames: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Which cameras have no fault in which frames, (T, C) bool; faults of the scene are nobody's.

    Harmless ones are no reason to do without a camera.
    """
    usable = np.ones((len(frames), len(names)), dtype=np.bool_)
    for fault in faults:
        if fault.camera in names and not fault.is_harmless:
            bad = (frames >= fault.first_frame) & (frames <= fault.last_frame)
            usable[bad, list(names).index(fault.camera)] = False
    return usable


def fit_states(unexplained: Array, usual: float) -> tuple[NDArray[np.int64], Array]:
    """Exact piecewise-constant fit of one camera: state per frame (T,), and the cost (T, S) of every state.

    unexplained : (T, 2 W + 1) shares per lag, NaN = unknown; frames without any number cost nothing.
    States 0 .. 2 W are the lags -W .. W, 2 W + 1 is "fits at no lag".
    """
    n_frames, n_lags = unexplained.shape
    in_time = n_lags // 2
    known = np.isfinite(unexplained[:, in_time])
    share = np.where(np.isfinite(unexplained), unexplained, _LARGEST_SHARE)
    cost = np.full((n_frames, n_lags + 1), min(_OFF_SHARE / usual, _OFF_COST) + _LAG_PRICE)
    cost[:, :n_lags] = np.minimum(share / usual, _LARGEST_COST) + _LAG_PRICE
    cost[:, in_time] -= _LAG_PRICE
    cost[~known] = 0.0
    total = cost[0] + np.where(np.arange(n_lags + 1) == in_time, 0.0, _CHANGE_PRICE)
    came_from = np.zeros(cost.shape, dtype=np.int64)
    for t in range(1, n_frames):
        best = int(total.argmin())
        stays = total <= total[best] + _CHANGE_PRICE
        came_from[t] = np.where(stays, np.arange(n_lags + 1), best)
        total = np.minimum(total, total[best] + _CHANGE_PRICE) + cost[t]
    states = np.empty(n_frames, dtype=np.int64)
    states[-1] = total.argmin()
    for t in range(n_frames - 1, 0, -1):
        states[t - 1] = came_from[t, states[t]]
    return states, cost


def _odd_stretches(unexplained: Array, usual: float) -> Iterator[tuple[int, int, NDArray[np.int64]]]:
    """Stretches (first, stop) of one camera that are not in time and worth it, with the states of their frames."""
    states, cost = fit_states(unexplained, usual)
    in_time = unexplained.shape[1] // 2
    known = np.isfinite(unexplained[:, in_time])
    frames = np.arange(len(states))
    for first, stop in _runs(states != in_time, _JOIN_FRAMES):
        inside = states[first:stop]
        saved = (cost[first:stop, in_time] - cost[frames[first:stop], inside])[known[first:stop]]
        # A fault speaks in many frames; a hull that fails now and then does not.
        if saved.sum() < _MIN_GAIN or np.count_nonzero(saved > _LAG_PRICE) < max(
            _MIN_FRAMES, 0.25 * len(saved)
        ):
            continue
        # Before the first movement a lag cannot be seen: then it counts as having been there from the start.
        is_known = np.isfinite(unexplained[:first, min(inside[0], 2 * in_time)]) & known[:first]
        if first and (cost[:first, inside[0]] - cost[:first, in_time])[is_known].sum() <= 0.5 * _CHANGE_PRICE:
            first, inside = 0, np.concatenate([np.full(first, inside[0]), inside])
        yield first, stop, inside


def _diagnose(
    evidence: SilhouetteEvidence,
    unexplained: Array,
    c: int,
    first: int,
    stop: int,
    states: NDArray[np.int64],
    usual: float,
) -> CameraFault:
    """What the odd stretch [first, stop) of a camera is."""
    part = unexplained[first:stop]
    part = part[np.isfinite(part[:, MAX_LAG_FRAMES])]
    with np.errstate(invalid="ignore"):
        share = np.array([_mean(np.minimum(column, _LARGEST_SHARE)) for column in part.T])
    none = share[MAX_LAG_FRAMES]
    if np.mean(part[:, MAX_LAG_FRAMES] >= 1.0) > 0.5:
        return _fault(evidence, c, "blind", first, stop)
    best = int(np.nanargmin(share))
    shift, before_shift, after_shift = _silhouette_shift(evidence.snapshots, evidence, c, first, stop)
    # What is unexplained at the best of times, by shadows and the like, no lag can explain either.
    well = np.concatenate([unexplained[:first, MAX_LAG_FRAMES], unexplained[stop:, MAX_LAG_FRAMES]])
    floor = usual / _USUAL_FACTOR
    if np.count_nonzero(np.isfinite(well)) >= _MIN_FRAMES:
        floor = max(floor, _mean(np.minimum(well, _LARGEST_SHARE)))
    is_lag = best != MAX_LAG_FRAMES and share[best] - floor <= _LAG_LEAVES * (none - floor)
    if is_lag and not after_shift < share[best] - 0.5 * usual:
        begin = _sharpened(evidence.strict[:, c], first, best)
        if begin < stop:  # else the tighter hull contradicts it
            return replace(_fault(evidence, c, "lag", begin, stop), lag_frames=best - MAX_LAG_FRAMES)
    if _is_drift(states) and not after_shift < _of_states(unexplained[first:stop], states) - 0.5 * usual:
        return _fault(evidence, c, "rate", first, stop)
    if after_shift <= _SHIFT_LEAVES * before_shift:
        return replace(_fault(evidence, c, "moved", first, stop), shift_px=shift)
    return _fault(evidence, c, "misfit", first, stop)


def _is_in_time(unexplained: Array, state: int, usual: float) -> bool:
    """Whether frames tell that a camera is in time, and not at the lag of a state of `fit_states`."""
    if state >= unexplained.shape[1]:
        return False
    return float(np.nansum(unexplained[:, state] - unexplained[:, MAX_LAG_FRAMES])) > _MIN_GAIN * usual


def _have_jumped(change: NDArray[np.float32], row: int) -> bool:
    """Whether a mask changes near a row by much more than in the two frames before and the two after, or that cannot be
    told.  change : (T,) share of the mask that is new or gone."""
    padded = np.pad(change.astype(np.float64), 2, constant_values=np.nan)
    around = np.stack([padded[k : k + len(change)] for k in (0, 1, 3, 4)])
    near = slice(max(0, row - _JUMP_FRAMES), row + _JUMP_FRAMES + 1)
    is_told = np.isfinite(change[near]) & np.isfinite(around[:, near]).all(axis=0)
    jumps = change[near] > _LOST_JUMP * around[:, near].mean(axis=0)
    return not is_told.all() or bool(jumps[is_told].any())


def _is_drift(states: NDArray[np.int64]) -> bool:
    """Whether the lag begins small and grows step by step, slower than the time goes: it grows as fast where of one
    moment alone the hull holds what the masks show."""
    pieces = [(int(s) - MAX_LAG_FRAMES, first) for s, first, _ in _pieces(states) if s <= 2 * MAX_LAG_FRAMES]
    if len(pieces) < 3:
        return False
    lags, begin = np.array(pieces).T
    steps = np.diff(lags) * np.sign(lags[-1])
    is_slow = abs(lags[-1] - lags[0]) < _DRIFT_PER_FRAME * (begin[-1] - begin[0])
    return abs(lags[0]) <= 2 and bool(is_slow and np.all((steps > 0) & (steps <= 2)))


def _of_states(unexplained: Array, states: NDArray[np.int64]) -> float:
    """Mean share that the lags of a fit leave, over the frames that it gives a lag."""
    rows = np.flatnonzero(states <= 2 * MAX_LAG_FRAMES)
    return _mean(np.minimum(unexplained[rows, states[rows]], _LARGEST_SHARE))


def _sharpened(strict: NDArray[np.float32], first: int, state: int) -> int:
    """The frame near `first` at which the lag of `state` begins to fit better than none, by the tighter hull.

    That hull is of use once it is known that the other cameras are well.
    """
    if first == 0:
        return 0
    begin = max(0, first - _SHARPEN_FRAMES)
    saved = (
        strict[begin : first + _SHARPEN_FRAMES, MAX_LAG_FRAMES]
        - strict[begin : first + _SHARPEN_FRAMES, state]
    )
    return begin + int(np.argmin(np.concatenate([[0.0], np.cumsum(np.nan_to_num(saved))])))


def _without_common_cause(faults: list[CameraFault], n_cameras: int) -> list[CameraFault]:
    """Faults that begin together in half of the cameras or more become one fault of the scene."""
    left, together = list(faults), []
    for fault in sorted(faults, key=lambda f: f.first_frame):
        near = [f for f in left if abs(f.first_frame - fault.first_frame) <= _SAME_TIME_FRAMES]
        if len({f.camera for f in near}) >= max(2, (n_cameras + 1) // 2):
            left = [f for f in left if f not in near]
            last = max(f.last_frame for f in near)
            together.append(
                replace(
                    near[0],
                    camera="",
                    kind="scene",
                    first_frame=min(f.first_frame for f in near),
                    last_frame=last,
                    lag_frames=0,
                    shift_px=None,
                )
            )
    return left + together


def _black(evidence: SilhouetteEvidence, c: int) -> list[tuple[int, int]]:
    dark = (evidence.brightness[:, c] < _BLACK_LEVEL) & (evidence.contrast[:, c] < _BLACK_CONTRAST)
    bright = np.nanmedian(evidence.brightness) if np.isfinite(evidence.brightness).any() else 0.0
    return [r for r in _runs(dark & (bright > 2 * _BLACK_LEVEL), 1) if r[1] - r[0] >= _MIN_FRAMES]


def _frozen(evidence: SilhouetteEvidence, c: int) -> list[tuple[int, int]]:
    """Stretches in which the picture repeats, or, without pictures, the mask while the others' masks change.

    A picture in which nobody is, and nobody is to be expected, may well stand still.
    """
    still, tells = _stillness(evidence, c)
    # In its first frames a codec still settles on the repeated picture.
    stretches = [r for r in _runs(still, 3) if np.count_nonzero((tells & still)[slice(*r)]) >= _MIN_FRAMES]
    return [(_start_of_stillness(evidence, c, first), stop) for first, stop in stretches]


def _now_and_then(evidence: SilhouetteEvidence, c: int) -> Iterator[CameraFault]:
    """What happens to single pictures of a camera all over the recording."""
    whole = _fault(evidence, c, "repeats", 0, len(evidence.frames))
    still, tells = _stillness(evidence, c)
    for stretch in _frozen(evidence, c):
        tells[slice(*stretch)] = False
    n_repeated = int(np.count_nonzero(tells & still))
    share = n_repeated / max(int(np.count_nonzero(tells)), 1)
    if n_repeated >= _MIN_FRAMES and share >= _REPEATED_SHARE:
        yield replace(whole, share=share)
    brightness = evidence.brightness[:, c].astype(np.float64)
    jumps = np.abs(np.diff(brightness)) > _JUMP * np.maximum(brightness[1:], _BLACK_LEVEL)
    if np.count_nonzero(jumps) >= max(_MIN_FRAMES, _JUMP_SHARE * len(jumps)):
        yield replace(whole, kind="flicker", share=float(jumps.mean()))


def _stillness(evidence: SilhouetteEvidence, c: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Frames (T,) in which a camera gives what it gave before, and those (T,) in which that would tell something."""
    own = evidence.picture_change[:, c]
    if np.isfinite(own).any():
        others = np.delete(evidence.picture_change, c, axis=1)
        liveliest = float(np.nanquantile(own, 0.9))
        usual = min(liveliest, _median(others)) if liveliest > 0 else _median(others)
        others_go_on = np.median(others, axis=1) > 2 * _FROZEN_PICTURE_SHARE * usual
        # Who walks away far off changes little in a picture, but his mask goes with him.
        goes_on = evidence.change[:, c] > _MOVING_MASK_CHANGE
        still = (own < _FROZEN_PICTURE_SHARE * usual) & ~goes_on
    else:
        others = np.delete(evidence.change, c, axis=1)
        with np.errstate(invalid="ignore"):
            others_go_on = np.count_nonzero(others > _MOVING_MASK_CHANGE, axis=1) >= 0.5 * others.shape[1]
            still = evidence.change[:, c] < _FROZEN_MASK_CHANGE
    tells = others_go_on & (np.maximum(evidence.mask_cells[:, c], evidence.expected_cells[:, c]) >= MIN_CELLS)
    return still, tells


def _start_of_stillness(evidence: SilhouetteEvidence, c: int, first: int) -> int:
    """Up to three frames earlier, while the mask already holds still."""
    for _ in range(3):
        if first > 1 and evidence.change[first - 1, c] < 2 * _MOVING_MASK_CHANGE:
            first -= 1
    return first


def _background_moves(evidence: SilhouetteEvidence, c: int) -> list[tuple[int, int, tuple[float, float]]]:
    """Stretches (first, stop, shift in px) in which the picture's background lies elsewhere than at first."""
    shots = [s for s in evidence.snapshots if s.pictures is not None]
    if len(shots) < 2:
        return []
    shifts_of = _Shifts(shots, c)
    edges = shifts_of.edges()
    stretches = []
    for first, stop in zip(edges[::2], [*edges[1::2], len(shots)][: len(edges[::2])], strict=True):
        shifts = [s for i in range(first, stop) if (s := shifts_of.seen.get(i)) is not None]
        if len(shifts) < 2 and stop - first < _MIN_FRAMES:
            continue
        shift = np.median(shifts, axis=0) * SHRINK
        start = _row_of(evidence, shots[first].frame)
        if first:
            start = _first_jump(evidence, c, _row_of(evidence, shots[first - 1].frame) + 1, start)
        end = len(evidence.frames) if stop == len(shots) else _row_of(evidence, shots[stop].frame)
        stretches.append((start, end, (float(shift[0]), float(shift[1]))))
    return stretches


class _Shifts:
    """Shifts of one camera's background against the first snapshot, each found when it is asked for, and once.

    seen : index of a snapshot -> (2,) cells, None where it cannot be told.
    """

    def __init__(self, shots: Sequence[Snapshot], c: int) -> None:
        self._shots, self._c = shots, c
        self.seen: dict[int, Array | None] = {}

    def is_moved(self, i: int) -> bool | None:
        """Whether the background lies elsewhere in snapshot i; None when it cannot be told."""
        if i not in self.seen:
            self.seen[i] = background_shift(self._shots[0], self._shots[i], self._c)
        shift = self.seen[i]
        return None if shift is None else bool(np.hypot(*shift) > _MOVED_CELLS)

    def edges(self) -> list[int]:
        """The snapshots at which the answer changes: a few are looked at, and halvings find the place between."""
        last = len(self._shots) - 1
        looks = np.unique(np.linspace(1, last, min(_N_LOOKS, last)).astype(int))
        answers = [(int(i), self.is_moved(int(i))) for i in looks]
        answers = [(0, False), *((i, a) for i, a in answers if a is not None)]
        edges = []
        for (a, was), (b, now) in pairwise(answers):
            if was == now:
                continue
            while b - a > 1:
                middle = (a + b) // 2
                if self.is_moved(middle) == was:
                    a = middle
                else:
                    b = middle
            edges.append(b)
        return edges


def _background_stands(evidence: SilhouetteEvidence, c: int, first: int, stop: int) -> bool:
    """Whether the pictures of the rows first .. stop say that a camera has not moved: its background stays."""
    shots = [s for s in evidence.snapshots if s.pictures is not None]
    begin, end = int(evidence.frames[first]), int(evidence.frames[stop - 1])
    inside = [s for s in shots[1:] if begin <= s.frame <= end]
    shifts = [background_shift(shots[0], s, c) for s in inside[:: max(1, len(inside) // _N_LOOKS)]]
    stands = [float(np.hypot(*shift)) <= _MOVED_CELLS for shift in shifts if shift is not None]
    return len(stands) >= 2 and all(stands)


def _first_jump(evidence: SilhouetteEvidence, c: int, first: int, last: int) -> int:
    """The frame within first .. last (rows, between two snapshots) in which the picture changes most."""
    if last <= first:
        return last
    return first + int(np.nanargmax(evidence.picture_change[first : last + 1, c]))


def background_shift(before: Snapshot, after: Snapshot, c: int) -> Array | None:
    """Shift (2,) in cells of the background of camera c between two snapshots; None when it cannot be told.

    Corners of the first picture away from both masks are followed into the second (Lucas and Kanade) and back; the
    answer is their median where most agree.
    """
    assert before.pictures is not None
    assert after.pictures is not None
    first, second = before.pictures[c], after.pictures[c]
    person = cv2.dilate(before.masks[c] | after.masks[c], np.ones((5, 5), np.uint8))
    free = ((person == 0) & (first > 0)).astype(np.uint8)
    points = cv2.goodFeaturesToTrack(first, 80, 0.02, 5, mask=free, blockSize=5)
    if points is None or len(points) < _MIN_POINTS:
        return None
    there, ok, _ = cv2.calcOpticalFlowPyrLK(first, second, points, None, winSize=(15, 15), maxLevel=3)
    back, ok_back, _ = cv2.calcOpticalFlowPyrLK(second, first, there, None, winSize=(15, 15), maxLevel=3)
    good = (ok[:, 0] > 0) & (ok_back[:, 0] > 0) & (np.linalg.norm((back - points)[:, 0], axis=1) < 0.3)
    shifts = (there - points)[good, 0].astype(np.float64)
    if len(shifts) < _MIN_POINTS:
        return None
    median = np.median(shifts, axis=0)
    size = float(np.hypot(*median))
    alike = max(_ALIKE_CELLS, _ALIKE_SHARE * size) if size > _MOVED_CELLS else _MOVED_CELLS
    return median if np.mean(np.linalg.norm(shifts - median, axis=1) < alike) >= _MOST else None


def _silhouette_shift(
    snapshots: Sequence[Snapshot], evidence: SilhouetteEvidence, c: int, first: int, stop: int
) -> tuple[tuple[float, float], float, float]:
    """The one shift, px, of a camera's masks against the others' silhouettes; the share outside before and after."""
    begin, end = int(evidence.frames[first]), int(evidence.frames[stop - 1])
    inside = [s for s in snapshots if begin <= s.frame <= end and s.hulls[c].any() and s.masks[c].any()]
    inside = inside[:: max(1, len(inside) // 24)]
    if not inside:
        return (0.0, 0.0), 0.0, np.inf
    h, w = inside[0].masks.shape[1:]
    spectrum = np.zeros((2 * h, w + 1), dtype=np.complex128)
    n_cells = 0
    still = _still_cells(inside, c)
    for shot in inside:
        mask, hull = (shot.masks[c] & ~still).astype(float), (shot.hulls[c] > 0).astype(float)
        n_cells += int(mask.sum())
        pad = (2 * h, 2 * w)
        spectrum += np.conj(np.fft.rfft2(mask, pad)) * np.fft.rfft2(hull, pad)
    covered = np.fft.irfft2(spectrum, (2 * h, 2 * w))
    v, u = np.unravel_index(int(covered.argmax()), covered.shape)
    dv, du = (int(v) + h) % (2 * h) - h, (int(u) + w) % (2 * w) - w
    left = 1.0 - covered / n_cells
    return (-float(du * SHRINK), -float(dv * SHRINK)), float(left[0, 0]), max(0.0, float(left.min()))


def _still_cells(inside: Sequence[Snapshot], c: int) -> NDArray[np.bool_]:
    """Foreground (h, w) of camera c that stays: no person, but the background of a camera that has moved.

    None where it cannot be told from a person, because there are few snapshots or little else moves.
    """
    still: NDArray[np.bool_] = np.mean([shot.masks[c] for shot in inside], axis=0) > _STILL_SHARE
    n_moving = sum(int((s.masks[c] & ~still).sum()) for s in inside)
    if len(inside) < _MIN_FRAMES or n_moving < _MIN_FRAMES * len(inside):
        still[:] = False
    return still


def _fault(evidence: SilhouetteEvidence, c: int, kind: Kind, first: int, stop: int) -> CameraFault:
    return CameraFault(
        camera=evidence.names[c],
        kind=kind,
        first_frame=int(evidence.frames[first]),
        last_frame=int(evidence.frames[stop - 1]),
        is_from_start=first == 0,
        is_to_end=stop == len(evidence.frames),
    )


def _overlap(fault: CameraFault, evidence: SilhouetteEvidence, first: int, stop: int) -> bool:
    return fault.first_frame <= evidence.frames[stop - 1] and fault.last_frame >= evidence.frames[first]


def _row_of(evidence: SilhouetteEvidence, frame: int) -> int:
    return int(np.searchsorted(evidence.frames, frame))


def _runs(flags: NDArray[np.bool_], join: int) -> list[tuple[int, int]]:
    """Stretches (first, stop) of true flags; gaps shorter than `join` do not part them."""
    rows = np.flatnonzero(flags)
    if len(rows) == 0:
        return []
    parts = np.split(rows, np.flatnonzero(np.diff(rows) > join) + 1)
    return [(int(p[0]), int(p[-1]) + 1) for p in parts]


def _pieces(states: NDArray[np.int64]) -> Iterator[tuple[int, int, int]]:
    """(state, first, stop) of the constant pieces."""
    edges = [0, *(np.flatnonzero(np.diff(states)) + 1).tolist(), len(states)]
    for first, stop in pairwise(edges):
        yield int(states[first]), first, stop


def _median(values: NDArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else 0.0


def _mean(values: NDArray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else np.nan

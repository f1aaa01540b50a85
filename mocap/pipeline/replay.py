"""What the report shows of the motion: a replay, curves over time, and a summary of every person in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.data import AngleSeries, landmark_names
from mocap.pipeline.pictures import Sheets
from mocap.pipeline.record import Found
from mocap.pipeline.scene_frames import room_bounds, shown_frames
from mocap.pose.cycles import PERCENT, GaitCycles, cycles_of
from mocap.pose.method import SmoothSettings
from mocap.pose.result import PersonPoses
from mocap.pose.steps import Gait, gait_numbers
from mocap.view.curves import Chart, Curve, on_every_frame
from mocap.view.replay import Replay, ReplayPerson

Array = NDArray[np.float64]

# Speed is measured over so long: shorter spans show the trembling of the poses.
_SPEED_SPAN_S = 0.2
_SIDES = ("left", "right")
# Angles of the report, of both sides together; those of legs over the gait cycle too.
_LEG_CHARTS = (
    ("Hip flexion", "hip_flexion"),
    ("Knee flexion", "knee_flexion"),
    ("Ankle dorsiflexion", "ankle_dorsiflexion"),
)
_CHARTS = (
    *_LEG_CHARTS,
    ("Shoulder flexion", "shoulder_flexion"),
    ("Shoulder elevation", "shoulder_elevation"),
    ("Elbow flexion", "elbow_flexion"),
    ("Wrist flexion", "wrist_flexion"),
)
_GAIT = (
    ("steps", "steps", "{:.0f}"),
    ("cadence_per_min", "cadence", "{:.0f} per minute"),
    ("step_length_m", "step length", "{:.2f} m"),
    ("step_length_asymmetry_percent", "step lengths of the sides differ by", "{:.0f} %"),
    ("step_time_asymmetry_percent", "step times of the sides differ by", "{:.0f} %"),
    ("step_width_m", "step width", "{:.2f} m"),
    ("stance_s", "stance", "{:.2f} s"),
    ("swing_s", "swing", "{:.2f} s"),
    ("stance_percent", "share of stance", "{:.0f} %"),
)
_MIDDLE_CHARTS = (
    ("Trunk flexion", "trunk_flexion"),
    ("Neck flexion", "neck_flexion"),
    ("Pelvis tilt", "pelvis_tilt"),
    ("Pelvis obliquity", "pelvis_obliquity"),
)


def replay_of(found: Found, sheets: Sheets) -> Replay:
    """The replay of a run: persons in every shown frame, and pictures of every camera."""
    frames = np.array(shown_frames(found.session.frames), dtype=np.int64)
    return Replay(
        rig=found.session.rig,
        fps=found.session.fps,
        frames=frames,
        persons=tuple(ReplayPerson(p.person, _places(p, frames)) for p in found.poses),
        bounds_m=room_bounds(found),
        picture_frames=sheets.frames,
        sheets=sheets.files,
        tiles=sheets.tiles,
    )


def _places(poses: PersonPoses, frames: NDArray[np.int64]) -> Array:
    """Landmarks (T, M, 3) in these frames, NaN where there is no pose."""
    out = np.full((len(frames), *poses.landmarks.shape[1:]), np.nan)
    _, rows, own = np.intersect1d(frames, poses.frames, return_indices=True)
    out[rows] = poses.landmarks[own]
    return out


def charts_of(poses: PersonPoses, angles: AngleSeries, gait: Gait, fps: float) -> list[Chart]:
    """Curves of one person: speed, heights, contacts of feet where the body has them, and the angles that it has.

    A single frame has none.
    """
    if len(poses.frames) < 2:
        return []
    charts = [_speed_chart(poses, fps), _height_chart(poses, fps), *_contact_charts(poses, gait, fps)]
    for title, name in _CHARTS:
        curves = [
            _curve(angles, f"{side}_{name}", side, side)
            for side in _SIDES
            if f"{side}_{name}" in angles.names
        ]
        if curves:
            charts.append(on_every_frame(Chart(title, "degrees", poses.frames, fps, tuple(curves))))
    for title, name in _MIDDLE_CHARTS:
        if name in angles.names:
            chart = Chart(title, "degrees", poses.frames, fps, (_curve(angles, name, title, "middle"),))
            charts.append(on_every_frame(chart))
    return charts + _cycle_charts(cycles_of(gait, angles))


def _cycle_charts(found: Sequence[GaitCycles]) -> list[Chart]:
    """The means of leg angles over the gait cycle, both sides together; the band is where 90 % of the cycles lie."""
    charts = []
    for title, name in _LEG_CHARTS:
        curves = []
        for cycles in found:
            if f"{cycles.side}_{name}" in cycles.names:
                mean, between, measured = cycles.mean(f"{cycles.side}_{name}")
                label = f"{cycles.side}, cycles: {len(cycles)}, toe off at {cycles.off_percent.mean():.0f} %"
                std = np.hypot(np.nan_to_num(between), measured)
                curves.append(Curve(label, cycles.side, np.rad2deg(mean), np.rad2deg(std)))
        if curves:
            percent = PERCENT.astype(np.int64)
            charts.append(
                Chart(f"{title} over the gait cycle", "degrees", percent, 1.0, tuple(curves), along="%")
            )
    return charts


def _curve(angles: AngleSeries, name: str, label: str, kind: str) -> Curve:
    a = angles.names.index(name)
    std = None if angles.std is None else np.rad2deg(angles.std[:, a])
    seen = None if angles.observed is None else angles.observed[:, a]
    return Curve(label, kind, np.rad2deg(np.unwrap(angles.values[:, a])), std, seen)


def speeds_m_s(poses: PersonPoses, fps: float) -> tuple[Array, float]:
    """Speed of the pelvis over the floor, (T,) m/s, over spans of 0.2 s, NaN beside gaps, and its standard deviation.

    The deviation is that of what changes from frame to frame (`method.smooth.noise_m`): what stays does not move.
    """
    half = max(1, round(0.5 * _SPEED_SPAN_S * fps))
    out = np.full(len(poses.frames), np.nan)
    at = {int(frame): i for i, frame in enumerate(poses.frames)}
    place = poses.landmarks[:, 0, :2]
    for frame, i in at.items():
        a, b = at.get(frame - half), at.get(frame + half)
        if a is not None and b is not None:
            out[i] = float(np.linalg.norm(place[b] - place[a])) * fps / (2 * half)
    return out, float(np.sqrt(2.0) * SmoothSettings().noise_m * fps / (2 * half))


def _speed_chart(poses: PersonPoses, fps: float) -> Chart:
    speed, std = speeds_m_s(poses, fps)
    curve = Curve("pelvis", "middle", speed, np.full(len(speed), std))
    return on_every_frame(Chart("Speed over the floor", "m/s", poses.frames, fps, (curve,)))


def _height_chart(poses: PersonPoses, fps: float) -> Chart:
    names = landmark_names(poses.landmarks.shape[1])
    curves = []
    for name, kind in (("head", "left"), ("pelvis", "middle")):
        m = names.index(name)
        std = np.sqrt(poses.landmark_covariance[:, m, 2, 2])
        curves.append(Curve(name, kind, poses.landmarks[:, m, 2], std, poses.observed[:, m]))
    return on_every_frame(Chart("Height over the floor", "m", poses.frames, fps, tuple(curves)))


def _contact_charts(poses: PersonPoses, gait: Gait, fps: float) -> list[Chart]:
    """How probable it is that heel or toe of each foot rest on the floor; nothing of a body without feet."""
    if gait.contacts is None:
        return []
    soles = gait.contacts.probability.reshape(len(poses.frames), 2, 2).max(axis=2)
    curves = tuple(Curve(side, side, soles[:, k]) for k, side in enumerate(_SIDES))
    return [on_every_frame(Chart("Foot on the floor", "probability", poses.frames, fps, curves))]


def person_summary(poses: PersonPoses, angles: AngleSeries, gait: Gait, fps: float) -> str:
    """One person in lines of tab-separated text, to be pasted into a table."""
    speed, _ = speeds_m_s(poses, fps)
    steps = np.linalg.norm(np.diff(poses.landmarks[:, 0, :2], axis=0), axis=1)
    steps = steps[np.diff(poses.frames) == 1]
    head = poses.landmarks[:, 2, 2]
    known = np.isfinite(speed)
    lines = [
        f"person\t{poses.person}",
        f"body height\t{poses.body.height_m:.2f} m{'' if poses.height.is_measured else ' (not measured)'}",
        f"followed\t{len(poses.frames)} frames, {len(poses.frames) / fps:.1f} s",
        f"way over the floor\t{float(steps.sum()):.2f} m",
    ]
    if known.any():
        lines.append(f"speed, mean and largest\t{speed[known].mean():.2f} and {speed[known].max():.2f} m/s")
    lines.append(f"top of the head, lowest and highest\t{head.min():.2f} and {head.max():.2f} m")
    lines.append(f"landmarks observed\t{100 * float(poses.observed.mean()):.0f} %")
    numbers = gait_numbers(gait)
    lines += [
        f"{name}\t{words.format(numbers[key])}" for key, name, words in _GAIT if numbers.get(key) is not None
    ]
    lines.append("angle\tmean\tleast\tgreatest\tstandard deviation\tobserved")
    for a, name in enumerate(angles.names):
        values = np.rad2deg(np.unwrap(angles.values[:, a]))
        std = np.nan if angles.std is None else float(np.rad2deg(angles.std[:, a]).mean())
        seen = 1.0 if angles.observed is None else float(angles.observed[:, a].mean())
        lines.append(
            f"{name.replace('_', ' ')}\t{values.mean():z.0f}\t{values.min():z.0f}\t{values.max():z.0f}\t{std:.0f}\t"
            f"{100 * seen:.0f} %"
        )
    return "\n".join(lines)

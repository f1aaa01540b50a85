"""Write docs/pictures/metrics_epsilon.png and metrics_reliability.png, and print the numbers of docs/metrics.md.

python -m docs.make_metrics_pictures          # 2 s; a synthetic case whose truth is known, no files needed
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from mocap.compare.plots import plot_epsilon, plot_reliability
from mocap.data import LANDMARKS, Motion
from mocap.metrics import (
    angle_differences,
    epsilon_search,
    fit_reference_skeleton,
    joint_angles,
    point_errors,
    reliability,
)

PICTURES = Path(__file__).with_name("pictures")
STANDING = {
    "pelvis": (0.0, 0.0, 0.95), "neck": (0.0, 0.0, 1.45), "head": (0.0, 0.0, 1.75),
    "left_shoulder": (0.0, 0.2, 1.42), "left_elbow": (0.05, 0.25, 1.15), "left_wrist": (0.2, 0.25, 0.95),
    "right_shoulder": (0.0, -0.2, 1.42), "right_elbow": (0.05, -0.25, 1.15), "right_wrist": (0.1, -0.25, 0.9),
    "left_hip": (0.0, 0.1, 0.95), "left_knee": (0.1, 0.1, 0.5), "left_ankle": (0.05, 0.1, 0.1),
    "right_hip": (0.0, -0.1, 0.95), "right_knee": (0.05, -0.1, 0.5), "right_ankle": (-0.1, -0.1, 0.1),
}  # fmt: skip
N_FRAMES, NOISE_M, LOST_FRAMES, CLAIM = 300, 0.02, 60, 0.6


def tracked(seed: int = 0) -> tuple[Motion, Motion]:
    """Estimate and truth: landmarks 60 mm off by their definition, with noise, and both wrists lost for two seconds."""
    rng = np.random.default_rng(seed)
    truth = walk(rng)
    offset = rng.normal(size=(15, 3))
    offset *= 0.06 / np.linalg.norm(offset, axis=1, keepdims=True)
    estimate = truth.landmarks + offset + rng.normal(0.0, NOISE_M, truth.landmarks.shape)
    for name, shift in (("left_wrist", 0.3), ("right_wrist", 0.45)):
        lost = estimate[120 : 120 + LOST_FRAMES, LANDMARKS.index(name)]
        lost += rng.normal([shift, 0.0, 0.0], 0.05, lost.shape)
    return Motion(1, truth.frames, truth.time_s, estimate), truth


def claimed(seed: int = 0) -> tuple[Motion, Motion]:
    """Estimate and truth: errors of 5 to 60 mm whose deviations are known, but claimed as 0.6 of what they are."""
    rng = np.random.default_rng(seed)
    truth = walk(rng)
    std = np.repeat(rng.uniform(0.005, 0.06, truth.landmarks.shape[:2])[..., None], 3, axis=2)
    estimate = truth.landmarks + std * rng.standard_normal(std.shape)
    return Motion(1, truth.frames, truth.time_s, estimate, CLAIM * std), truth


def walk(rng: np.random.Generator) -> Motion:
    """A rigid figure on its way, (300, 15, 3) m."""
    frames = np.arange(N_FRAMES)
    landmarks = rng.normal([0.0, 0.0, 1.0], 0.25, (15, 3)) + frames[:, None, None] * np.array(
        [0.0, 0.01, 0.0]
    )
    return Motion(1, frames, frames / 30.0, landmarks)


def angle_gain(seed: int) -> float:
    """Share of the angle error from 20 mm of noise that the fit of the reference skeleton takes off, in random poses.

    The true body has constant sizes because it is itself a fit, to a standing figure thrown about by 80 mm.
    """
    rng = np.random.default_rng(seed)
    standing = np.array([STANDING[name] for name in LANDMARKS])
    truth = fit_reference_skeleton(standing + rng.normal(0.0, 0.08, (60, 15, 3))).landmarks
    noisy = truth + rng.normal(0.0, 0.02, truth.shape)
    angles = joint_angles(truth)
    direct = angle_differences(joint_angles(noisy), angles).mean_deg
    fitted = angle_differences(fit_reference_skeleton(noisy).angles, angles).mean_deg
    assert direct is not None
    assert fitted is not None
    return 1.0 - fitted / direct


def main() -> int:
    """Draw both pictures."""
    estimate, truth = tracked()
    errors = point_errors(estimate.landmarks, truth.landmarks)
    search = epsilon_search(errors)
    assert search is not None
    estimate, truth = claimed()
    assert estimate.std is not None
    honest = reliability(estimate.landmarks, truth.landmarks, estimate.std)
    assert honest is not None
    picture = plot_epsilon(
        errors, search.epsilon_mm, search.lilliefors, search.r2, search.by_lilliefors_mm, search.by_r2_mm
    )
    (PICTURES / "metrics_epsilon.png").write_bytes(picture)
    curves = (honest.level_percent, honest.coverage_percent, honest.claimed_mm, honest.found_mm)
    (PICTURES / "metrics_reliability.png").write_bytes(plot_reliability(*curves))
    share = 100 * np.mean(errors <= search.by_lilliefors_mm)
    print(
        f"epsilon {search.by_lilliefors_mm:.0f} mm by Lilliefors, {search.by_r2_mm:.0f} mm by R2: MMTA {share:.1f} %"
    )
    print(
        f"deviations must be multiplied by {honest.std_factor:.2f}; coverage is off by "
        f"{honest.calibration_error_percent:.0f} points"
    )
    gains = [100 * angle_gain(seed) for seed in range(20)]
    print(f"inverse kinematics takes off {min(gains):.0f} to {max(gains):.0f} % of the angle error")
    return 0


if __name__ == "__main__":
    sys.exit(main())

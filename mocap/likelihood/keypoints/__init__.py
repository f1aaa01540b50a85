"""Keypoints: how well a pose explains the named points that cameras see of one person."""

from mocap.likelihood.keypoints.problem import KeypointProblem, KeypointSettings, KeypointViews

__all__ = ["KeypointProblem", "KeypointSettings", "KeypointViews"]

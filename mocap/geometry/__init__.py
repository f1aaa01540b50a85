"""Projection, epipolar geometry, rotations and twists on plain arrays."""

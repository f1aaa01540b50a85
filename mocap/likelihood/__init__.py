"""Likelihood: how well a pose explains the data of a frame.

voxels : scores of the hull and the problem that filters see.  markers : the same for detected markers, and their fit.
residuals : distances of the flesh to hull and outlines, and the solver that makes them small.  colours : what the
person's pixels say of a pose.
"""

"""Calibrated multi-camera video to 3D human motion: volumes, particle filters, no neural weights."""

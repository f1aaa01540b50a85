"""Parts of the evaluation of person tracking: hulls on disk, trackers by name, scores and tables."""

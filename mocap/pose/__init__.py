"""The pose method: one follower for every kind of evidence.

settings, method : what the room takes, and every number of it.  evidence : what a follower asks of a frame, and who
gives it.
volume, marker : the two observations.  start, marker_start : the first pose.  follow : the loop over frames, its verbs
and the policy of one hypothesis; beam : the policy of several.  limb_search, restart, repair : the three ways of
looking again.  size, smooth, deviation : the person's size, the motion over time, how far off it may be.
person, marker_person : all of it for one person of a clip.  result : what comes out.

Knows no file, no configuration and no clock; `mocap.pipeline.pose_settings` turns the one into the other.
"""

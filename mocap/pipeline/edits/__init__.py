"""Edits of a run: OUT/edits.toml, what somebody who looked at the result knows better, applied when it is run again.

The file is a section of the configuration that lies beside the result, because numbers of persons are those of a run.
Edits of tracks come first, in the order of the file; edits of poses speak of persons as they are called after them.
"""

"""Live: poses from cameras while they film; capture, pairing, and the stages' own steps, one frame after the other."""

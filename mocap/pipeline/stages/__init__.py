"""The stages: each computes its products from those of the stages before, frame by frame where it can."""

"""The products of the stages in the store: one module each, with what writes it and what reads it."""

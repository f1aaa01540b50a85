"""foreground stage."""

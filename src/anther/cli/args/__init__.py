"""What a command is asked: its help and its `Args`. Nothing here imports more than the standard library and tyro, so
that a typo is told at once."""

"""A house: its map over weeks, and shifts of robots in it."""

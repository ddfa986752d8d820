"""A robot before a plant, simulated or real."""

"""Anther: RGB-D views of a plant in; a safe, effective pollination shake, executed and measured, out."""

__version__ = "0.1.0"

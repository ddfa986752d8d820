"""Anther: RGB-D views of a plant in; a safe, effective pollination shake, executed and measured, out."""

from anther.core.libraries import prepare_libraries

__version__ = "0.1.0"

prepare_libraries()

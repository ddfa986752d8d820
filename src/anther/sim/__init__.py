"""Simulation: plants, cameras, a cell, the truth that no stage may see, and the judge that reads it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

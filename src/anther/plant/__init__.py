"""Plant: a skeleton as rods, its material, what it bears and its flowers need; tests on a bench."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

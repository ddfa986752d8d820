"""Robot: devices behind small protocols, safety, arms and their motions, drivers, calibration, cells."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Show: reports, pictures, the 3-D viewer, logs, pages of the history."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

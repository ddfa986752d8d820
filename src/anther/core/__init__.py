"""Core: frames and cameras, checks, errors, files, run folders. Every other room stands on it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

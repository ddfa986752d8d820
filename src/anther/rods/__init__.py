"""Rods: discrete elastic rods, branched, slender, shaken. Knows nothing of plants or robots.

`Rods` (geometry, material, `Section`), `Clamp`, `Drive` and `Loads` (what is held, moved and pulled), then `simulate`
for nonlinear motion (threads run it on all cores), `frequency_response` and `response_map` for small vibrations,
`natural_frequencies` for modes and their damping ratios, `base_response` for a shaking table.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Colour classes of pixels under any lamp: tables from colour to class that adapt to the light.

Where the light holds green, plants are green once the white balance is right. Where it holds none (grow lamps of
660 nm and 450 nm), the colours of plant and surroundings are learned from pixels that geometry is sure of.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from anther.core.geometry import Array

if TYPE_CHECKING:
    from anther.perception.masks import Params

OUTSIDE, OTHER, GREEN, YELLOW, WHITE, GREEN_NO_DEPTH = range(6)
"""Colour class of a pixel. GREEN: like a leaf. OUTSIDE: beyond the workspace or without depth, and not green."""

STEPS, STEP = 64, 4
"""Steps of a table in each channel, and how wide they are [grey levels]: just above the noise of a camera."""


@dataclass(frozen=True, slots=True, eq=False)
class ColourRule:
    """The class of every colour.

    Attributes:
        table: (STEPS, STEPS, STEPS) uint8, OTHER, GREEN, YELLOW or WHITE by red, green and blue.
        alike: colours that differ by less than this in each channel can be of the same thing [grey levels].
        learned: whether the light holds no green, so that GREEN was learned from what geometry calls plant.
    """

    table: NDArray[Any]
    alike: float
    learned: bool = False

    def classes(self, rgb: NDArray[Any]) -> NDArray[np.uint8]:
        """Return the class of each pixel of (..., 3) uint8."""
        return self.table.ravel()[_step(rgb)]


@dataclass(frozen=True, slots=True)
class Light:
    """The light that shines on a scene.

    Attributes:
        gains: white-balance gains of red, green and blue.
        leaf: brightness of well-lit leaves after white balance, 0..255.
        holds_green: whether the green channel gets enough of it to recognize plants.
    """

    gains: tuple[float, float, float]
    leaf: float
    holds_green: bool

    @classmethod
    def on(cls, rgb: NDArray[Any], green: float, colourful: float = np.inf) -> Light:
        """Estimate it from images (V, H, W, 3): shades of grey of all that is neither green nor colourful.

        Shades of grey with Minkowski norm p = 6: Finlayson and Trezzi 2004. Green pixels (excess green > `green`) are
        left out, because a plant before a black cloth is all the light there is to see, and those with a saturation
        (0..1) of `colourful` or more, because ripe tomatoes are no red lamp. Leaves count down to a quarter of the
        brightest green; darker is a black cloth or deep shade. Light without green holds less than
        half as much of it as of its strongest colour.
        """
        sample = rgb[:, ::16, ::16].reshape(-1, 3).astype(np.float64)
        lit = sample[~_is_dark(sample)]
        gains, lamp, grey, balanced = np.ones(3), np.ones(3), lit, lit
        for _ in range(4):
            if len(grey):
                square = grey * grey  # NumPy's own powers take ten times as long
                lamp = np.power(np.mean(square * square * square, axis=0), 1 / 6) + 1e-9
            gains = np.clip(lamp.mean() / lamp, 0.5, 2)
            balanced = lit * gains
            grey = lit[(_excess_green(balanced) < green) & (saturation(balanced) < colourful)]
        leaves = _of_channels(np.maximum, balanced)[_excess_green(balanced) > green]
        if len(leaves):
            leaves = leaves[leaves > 0.25 * np.percentile(leaves, 99)]
        return cls(
            gains=(float(gains[0]), float(gains[1]), float(gains[2])),
            leaf=float(np.percentile(leaves, 90)) if len(leaves) else 128.0,
            holds_green=bool(lamp[1] >= 0.5 * lamp.max()),
        )


def green_rule(light: Light, params: Params) -> ColourRule:
    """Return the rule for light that holds green: excess green 2g - r - b (Woebbecke 1995), petals yellow or white.

    Yellow petals are saturated and half as bright as bright leaves; white ones are not, and nearly as bright.
    """
    level = np.arange(STEPS) * STEP + (STEP - 1) / 2
    r, g, b = np.meshgrid(*(level * gain for gain in light.gains), indexing="ij")
    colour = np.stack([r, g, b], axis=-1)
    high = _of_channels(np.maximum, colour)
    saturated = saturation(colour)
    yellow_value = np.clip(0.5 * light.leaf, 20, 200)
    white_value = np.clip(0.9 * light.leaf, 40, 220)
    table = np.where(_excess_green(colour) >= params.green, GREEN, OTHER)
    if params.white_petals:
        table[(saturated <= 0.25) & (high >= white_value)] = WHITE
    yellow = (r >= 0.9 * g) & (g >= 0.58 * r) & (high >= yellow_value)
    table[(saturated >= 0.45) & yellow] = YELLOW
    table[_is_dark(colour)] = OTHER
    return ColourRule(table.astype(np.uint8), _alike(light.leaf))


def learned_rule(plant: NDArray[Any], rest: NDArray[Any]) -> ColourRule:
    """Return the rule for light without green, from colours (n, 3), (m, 3) uint8 of pixels that are surely either.

    GREEN is what is likelier on the plant than elsewhere; WHITE (a petal) what is twice as bright as the leaves.
    """
    likelier = _density(plant) > _density(rest)
    leaf = float(np.percentile(plant.max(axis=1), 90)) if len(plant) else 128.0
    level = np.arange(STEPS) * STEP + (STEP - 1) / 2
    high = np.maximum.reduce(np.meshgrid(level, level, level, indexing="ij"))
    table = np.where(likelier, GREEN, OTHER)
    table[high >= 2 * leaf] = WHITE
    return ColourRule(table.astype(np.uint8), _alike(leaf), learned=True)


def _step(colours: NDArray[Any]) -> NDArray[np.int64]:
    """Return where in a flat table the colours (..., 3) uint8 stand."""
    r, g, b = np.moveaxis(colours // STEP, -1, 0).astype(np.int64)
    return (r * STEPS + g) * STEPS + b


def _density(colours: NDArray[Any]) -> NDArray[np.float32]:
    """Return how densely (n, 3) uint8 colours fill the steps of a table, smoothed over 1.5 steps; sums to 1."""
    count = np.bincount(_step(colours), minlength=STEPS**3).reshape(STEPS, STEPS, STEPS)
    share = (count / max(1, len(colours))).astype(np.float32)
    return np.asarray(ndimage.gaussian_filter(share, 1.5, mode="constant"), dtype=np.float32)


def _excess_green(colour: NDArray[Any]) -> Array:
    """Return 2g - r - b of the chromaticities of (..., 3)."""
    return 3 * colour[..., 1] / (_of_channels(np.add, colour) + 1e-9) - 1


def saturation(colour: NDArray[Any]) -> NDArray[Any]:
    """Return the saturation, 0..1, of colours (..., 3)."""
    return np.asarray(1 - _of_channels(np.minimum, colour) / (_of_channels(np.maximum, colour) + 1e-9))


def _is_dark(colour: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which (..., 3) are too dark to have a colour, by the sum of the channels."""
    return np.asarray(_of_channels(np.add, colour) < 30)


def _of_channels(combined: np.ufunc, colour: NDArray[Any]) -> NDArray[Any]:
    """Return a sum or an extreme of colours (..., 3); numpy's own, along so short an axis, take ten times as long."""
    return combined(combined(colour[..., 0], colour[..., 1]), colour[..., 2])


def _alike(leaf: float) -> float:
    """Return how much colours of one thing may differ: 18 grey levels where leaves have 150."""
    return float(np.clip(0.12 * leaf, 5, 18))

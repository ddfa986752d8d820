"""One check at the border: shape, dtype, finiteness and range of arrays and numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from anther.core.errors import bad_input


def check_array(
    name: str,
    value: Any,
    shape: tuple[int | None, ...],
    *,
    dtype: DTypeLike = np.float64,
    finite: bool = True,
) -> NDArray[Any]:
    """Return `value` as a read-only array of the given shape and dtype.

    Args:
        name: what the array is called in the error message.
        value: anything numpy can turn into an array. It is not copied when it already fits.
        shape: expected shape; None stands for any length.
        dtype: dtype of the result.
        finite: whether NaN and infinity are refused.

    Raises:
        InputError: wrong shape, not numeric, or not finite.
    """
    try:
        array = _cast(np.asarray(value), np.dtype(dtype))
    except (TypeError, ValueError) as error:
        raise bad_input(
            name, given=type(value).__name__, allowed=f"numbers of shape {_wanted(shape)}", do=str(error)
        ) from error
    if array.shape != shape and not _fits(array.shape, shape):
        allowed = f"shape {_wanted(shape)}"
        raise bad_input(name, given=f"shape {array.shape}", allowed=allowed, do="Check the array's axes.")
    if finite and array.dtype.kind == "f" and not np.isfinite(array).all():
        count = int((~np.isfinite(array)).sum())
        raise bad_input(
            name, given=f"{count} NaN or infinite values", allowed="finite numbers", do="Remove or repair them."
        )
    view = array.view()
    view.flags.writeable = False
    return view


def _fits(given: tuple[int, ...], shape: tuple[int | None, ...]) -> bool:
    return len(given) == len(shape) and all(n is None or n == m for n, m in zip(shape, given, strict=True))


def _wanted(shape: tuple[int | None, ...]) -> str:
    return "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"


def _cast(given: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the array in a dtype, unless numpy would drop imaginary parts or make up integers."""
    if given.dtype.kind == "c" and dtype.kind != "c":
        raise TypeError("Complex numbers.")
    if dtype.kind in "iu" and given.dtype.kind == "f" and not np.isfinite(given).all():
        raise ValueError("NaN or infinite where integers are wanted.")
    return np.asarray(given, dtype=dtype)


def check_range(name: str, value: float, lower: float, upper: float, unit: str = "") -> float:
    """Return `value` if `lower <= value <= upper`.

    Raises:
        InputError: the value is outside the range or NaN.
    """
    if not lower <= value <= upper:
        unit = f" {unit}" if unit else ""
        raise bad_input(
            name,
            given=f"{value:g}{unit}",
            allowed=f"{lower:g} <= {name} <= {upper:g}{unit}",
            do="Check value and unit.",
        )
    return float(value)


MOST_BYTES = 2.5e9
"""Most memory of one array that a computation makes: some 20 times what the largest scanned plant asks for."""


def check_room(what: str, size: float, do: str) -> None:
    """Check that `what` asks for no more than MOST_BYTES [bytes], before the memory is filled.

    Raises:
        InputError: it asks for more.
    """
    if size > MOST_BYTES:
        raise bad_input(what, given=f"{size / 1e9:.1f} GB", allowed=f"at most {MOST_BYTES / 1e9:g} GB", do=do)


def check_transform(name: str, value: Any, count: int | None = None) -> NDArray[np.float64]:
    """Return `value` as read-only rigid transforms, (4, 4) or, with `count` or a 3-d input, (V, 4, 4).

    Raises:
        InputError: not finite, wrong shape, or the rotation is not orthonormal with determinant +1.
    """
    stack = count is not None or np.ndim(value) == 3
    T = check_array(name, value, (count, 4, 4) if stack else (4, 4))
    R = T[..., :3, :3]
    # np.allclose takes five times as long, and a plan asks hundreds of times
    identity = np.eye(4)
    skewed, bottom = np.abs(np.swapaxes(R, -1, -2) @ R - identity[:3, :3]), np.abs(T[..., 3, :] - identity[3])
    rigid = np.all(skewed <= 1e-6 + 1e-5 * identity[:3, :3]) and np.all(bottom <= 1e-9 + 1e-5 * identity[3])
    rigid = rigid and np.all(np.linalg.det(R) > 0)
    if not rigid:
        raise bad_input(
            name,
            given="a matrix that is not a rigid transform",
            allowed="rotation (orthonormal, det +1) and translation, last row 0 0 0 1",
            do="Check scale, handedness and row order.",
        )
    return T

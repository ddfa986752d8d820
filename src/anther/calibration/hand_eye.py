"""The result: where the camera sits on the flange, and how far it can be trusted. V views."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.checks import check_array, check_transform
from anther.errors import bad_input
from anther.files import read_object, understood, write_json
from anther.geometry import Array, Intrinsics, inverse

KIND, SCHEMA = "hand-eye", 2


class MethodError(NamedTuple):
    """How well one method did.

    Attributes:
        name: "tsai", "park", "horaud", "daniilidis", or "result".
        rotation_apart, translation_apart: by how much its T_flange_cam differs from the result's [rad], [m].
        pixel_rms: RMS distance of the corners of the used views [px].
        left_out_pixel, left_out_rotation, left_out_translation: RMS over views, each predicted from all others
            [px], [rad], [m]; NaN with three views.
    """

    name: str
    rotation_apart: float
    translation_apart: float
    pixel_rms: float
    left_out_pixel: float
    left_out_rotation: float
    left_out_translation: float


@dataclass(frozen=True, slots=True, eq=False)
class HandEye:
    """Where the camera sits on the flange, and how well the views agree with it.

    Attributes:
        T_flange_cam: (4, 4).
        T_base_board: (4, 4) where the board stood.
        intrinsics: of the camera.
        distortion: (5,) of the lens, k1, k2, p1, p2, k3 as in OpenCV; 0 where there is none.
        images: (V) names of the views.
        used: (V,) whether the view took part; the others are outliers.
        pixel_residuals: (V,) RMS distance between the corners seen and expected [px].
        rotation_residuals: (V,) angle between the board seen in each view alone and the board's common pose [rad].
        translation_residuals: (V,) distance between their centres [m].
        left_out_errors: (V, 3) the same three, each view predicted from all others; NaN for outliers.
        rotation_error, translation_error: standard error of T_flange_cam in its worst direction [rad], [m].
        pixel_noise: standard deviation of a corner's pixel coordinate [px].
        arm_rotation_error, arm_translation_error: standard deviation of the arm's pose errors, as they look from
            the views [rad], [m] per axis.
        methods: the closed forms beside the result.
        method: what was done.
        notes: what the user should know.
    """

    T_flange_cam: Array
    T_base_board: Array
    intrinsics: Intrinsics
    distortion: Array
    images: tuple[str, ...]
    used: NDArray[Any]
    pixel_residuals: Array
    rotation_residuals: Array
    translation_residuals: Array
    left_out_errors: Array
    rotation_error: float
    translation_error: float
    pixel_noise: float
    arm_rotation_error: float
    arm_translation_error: float
    methods: tuple[MethodError, ...]
    method: str
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.images)
        for name in ("T_flange_cam", "T_base_board"):
            object.__setattr__(self, name, check_transform(name, getattr(self, name)))
        for name in ("pixel_residuals", "rotation_residuals", "translation_residuals"):
            object.__setattr__(self, name, check_array(name, getattr(self, name), (n,)))
        left_out = check_array("left_out_errors", self.left_out_errors, (n, 3), finite=False)
        object.__setattr__(self, "left_out_errors", left_out)
        object.__setattr__(self, "distortion", check_array("distortion", self.distortion, (5,)))
        object.__setattr__(self, "used", check_array("used views", self.used, (n,), dtype="bool"))

    def board_in_camera(self, T_base_flange: Array) -> Array:
        """Return T_cam_board (V, 4, 4) as the calibration has it for (V, 4, 4) flange poses."""
        return inverse(T_base_flange @ self.T_flange_cam) @ self.T_base_board

    def save(self, path: Path | str) -> None:
        """Write a JSON file (docs/calibration.md)."""
        values = {name: getattr(self, name) for name in self.__slots__}
        values |= {"intrinsics": asdict(self.intrinsics), "methods": [row._asdict() for row in self.methods]}
        write_json(path, {"kind": KIND, "schema": SCHEMA, **values})

    @classmethod
    def load(cls, path: Path | str) -> HandEye:
        """Read what `save` wrote.

        Raises:
            InputError: the file is missing, truncated or holds something else.
        """
        stored = read_object(path)
        if (stored.get("kind"), stored.get("schema")) != (KIND, SCHEMA):
            raise bad_input(
                str(path),
                given="something else, or another schema number",
                allowed=f"a calibration written by anther calibrate, schema {SCHEMA}",
                do="Calibrate again.",
            )
        with understood(path, "a whole file", "Restore it."):
            values = {name: stored[name] for name in cls.__slots__}
            values["intrinsics"] = Intrinsics(**values["intrinsics"])
            values["methods"] = tuple(MethodError(**_with_nan(row)) for row in values["methods"])
            values["images"], values["notes"] = tuple(values["images"]), tuple(values["notes"])
            values["left_out_errors"] = np.array(values["left_out_errors"], dtype=np.float64).reshape(-1, 3)
            return cls(**values)


def _with_nan(row: dict[str, Any]) -> dict[str, Any]:
    return {name: float("nan") if value is None else value for name, value in row.items()}

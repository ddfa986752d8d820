"""What compiles says so, once, and only where it takes long."""

from __future__ import annotations

import gc
import sys

import numpy as np
import pytest

from anther.core.compiling import COMPILED, inlined, njit, read_only


def compile_two() -> None:
    for number in range(2):
        njit(lambda x, more=number: x + more)(1.0)


def test_long_compiling_is_told_once(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(COMPILED, "_told", False)
    monkeypatch.setattr(COMPILED, "patience", 0.0)
    before = COMPILED.kernels, COMPILED.seconds
    compile_two()
    assert capsys.readouterr().err.count("compiling for this machine") == 1
    assert COMPILED.kernels == before[0] + 2
    assert COMPILED.seconds > before[1]
    assert gc.isenabled()


def test_short_compiling_is_not_told(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(COMPILED, "_told", False)
    monkeypatch.setattr(COMPILED, "patience", 1e9)
    compile_two()
    assert capsys.readouterr().err == ""


def test_a_terminal_sees_how_far_it_is_and_then_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(COMPILED, "patience", 0.0)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    compile_two()
    said = capsys.readouterr().err
    assert f"{COMPILED.kernels} kernels" in said
    assert "\n" not in said
    assert said.endswith("\r\033[K")


def test_a_kernel_is_compiled_once_with_its_parts_whatever_the_order_of_its_input() -> None:
    half = inlined(lambda x: 0.5 * x)
    mean = njit(lambda pair: half(pair[0, 0] + pair[0, 1]))
    before, pair = COMPILED.kernels, np.array([[1.0, 5.0], [0.0, 0.0]])
    frozen = pair.copy()
    frozen.flags.writeable = False
    for given in (pair, np.asfortranarray(pair), np.repeat(pair, 2, axis=1)[:, ::2], frozen, pair.tolist()):
        assert mean(read_only(given)) == 3.0
    assert COMPILED.kernels == before + 1
    assert pair.flags.writeable

"""What compiled code prints does not mix with what Anther prints."""

import os

import pytest

from anther.core.libraries import silent_stdout


def fail_loudly() -> None:
    with silent_stdout():
        os.write(1, b"[WARN]: Seidel: solver fails\n")
        raise RuntimeError


def test_what_compiled_code_prints_is_dropped_and_all_else_is_kept(capfd: pytest.CaptureFixture[str]) -> None:
    print("before", flush=False)
    with pytest.raises(RuntimeError):
        fail_loudly()
    print("after", flush=True)
    assert capfd.readouterr().out == "before\nafter\n"

"""Create the virtual environment given as the first argument, with pip in it, using only the standard library.

Debian splits pip and ensurepip from python3. So this tries, in order: venv with ensurepip; the system's own pip;
a pip wheel from the index that PIP_INDEX_URL names. No step needs root.
"""

import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
import urllib.parse
import urllib.request
import venv
from pathlib import Path


def succeeds(command: list[object]) -> bool:
    """Whether a command exits with 0."""
    return subprocess.run([str(word) for word in command], check=False, capture_output=True).returncode == 0


def has_pip(python: Path) -> bool:
    """Whether this interpreter exists and can run pip."""
    return python.exists() and succeeds([python, "-m", "pip", "--version"])


def release_files(index: str, package: str) -> list[tuple[str, str, str]]:
    """Return (name, url, sha256) of every file of a package on a simple index."""
    url = f"{index.rstrip('/')}/{package}/"
    request = urllib.request.Request(url, headers={"Accept": "application/vnd.pypi.simple.v1+json, text/html;q=0.5"})
    with urllib.request.urlopen(request) as reply:
        base, kind, body = reply.url, reply.headers.get_content_type(), reply.read().decode()
    if kind.endswith("json"):
        files = [(f["filename"], f["url"], f["hashes"]["sha256"]) for f in json.loads(body)["files"]]
    else:
        links = re.findall(r'href="([^"#]+)#sha256=([0-9a-f]{64})"', body)
        files = [(urllib.parse.unquote(link.rsplit("/", 1)[-1]), link, sha) for link, sha in links]
    return [(name, urllib.parse.urljoin(base, link), sha) for name, link, sha in files]


def newest_pip_wheel(index: str) -> tuple[str, str]:
    """Return (url, sha256) of the newest pip wheel on a simple index."""
    wheels = [f for f in release_files(index, "pip") if re.fullmatch(r"pip-\d+(\.\d+)+-py3-none-any\.whl", f[0])]
    return max(wheels, key=lambda f: [int(n) for n in f[0].split("-")[1].split(".")])[1:]


def install_pip_from_index(python: Path, index: str) -> None:
    """Fetch pip's wheel, check its hash, and let it install itself: a wheel can be run in place."""
    url, sha256 = newest_pip_wheel(index)
    with urllib.request.urlopen(url) as reply:
        wheel = reply.read()
    if hashlib.sha256(wheel).hexdigest() != sha256:
        sys.exit(f"make_env: {url} does not match its sha256; try again.")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / url.rsplit("/", 1)[-1]
        path.write_bytes(wheel)
        subprocess.run([python, f"{path}/pip", "install", "--quiet", str(path)], check=True)


def main() -> None:
    """Make the environment, or leave it alone when it already works."""
    home = Path(sys.argv[1])
    python = home / "bin" / "python"
    if has_pip(python):
        return
    if sys.version_info < (3, 11):  # noqa: UP036  the one file that an older Python may meet
        sys.exit(f"make_env: this is Python {sys.version.split()[0]}; Anther needs 3.11: make PYTHON=python3.11 demo")
    try:
        import ensurepip  # noqa: F401, PLC0415
    except ImportError:
        venv.create(home, clear=True, with_pip=False)
    else:
        venv.create(home, clear=True, with_pip=True)
        return
    if succeeds([sys.executable, "-m", "pip", "--python", python, "install", "pip"]):
        return
    index = os.environ.get("PIP_INDEX_URL")
    if not index:
        sys.exit(
            "make_env: this Python has neither ensurepip nor pip. Set PIP_INDEX_URL to a package index; try again."
        )
    install_pip_from_index(python, index)


if __name__ == "__main__":
    main()

"""Run an experiment or benchmark and keep its metrics with the command, the commit and the machine beside them.

python tools/record.py experiments/real_plants.py [OPTIONS]   ->   docs/results/real_plants.json
"""

import os
import platform
import subprocess
import sys
import tempfile
from datetime import UTC, datetime
from pathlib import Path

from anther.files import read_json, write_json


def main(script: str, *options: str) -> None:
    """Run the script with --json and write docs/results/<script>.json."""
    with tempfile.TemporaryDirectory() as folder:
        metrics = Path(folder) / "metrics.json"
        subprocess.run([sys.executable, script, *options, "--json", str(metrics)], check=True)
        commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=True)
        record = {
            "command": " ".join(["python", script, *options]),
            "commit": commit.stdout.strip(),
            "date": datetime.now(UTC).date().isoformat(),
            "machine": f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}",
            "metrics": read_json(metrics),
        }
        write_json(Path("docs/results") / f"{Path(script).stem}.json", record)


if __name__ == "__main__":
    main(*sys.argv[1:])

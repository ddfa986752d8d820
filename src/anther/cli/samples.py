"""Write small sample inputs: views, a cloud, a skeleton, a bag, pictures of a board, measurements of a stem."""

from __future__ import annotations

from anther.cli.args.samples import Args
from anther.cli.output import free
from anther.cli.sample_data import SAMPLES, write_samples


def run(args: Args) -> None:
    """Write the samples and say what they are."""
    free(*(args.out / name for name in SAMPLES), overwrite=args.overwrite)
    for path in write_samples(args.out):
        print(f"{path!s:24} {SAMPLES[path.name]}")
    print("docs/commands.md has a command for each.")

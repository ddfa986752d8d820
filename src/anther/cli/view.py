"""Show a run or a skeleton in 3-D, write it for other programs, or show a trial in Foxglove as it goes on."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from anther.cli.args.view import Args
from anther.cli.output import free
from anther.cli.run_folder import LOG
from anther.core.checks import check_range
from anther.core.errors import StageFailure, bad_input
from anther.core.files import existing
from anther.core.runs import FILES, kept
from anther.perception.formats.skeletons import WRITES, read_skeleton, write_skeleton
from anther.perception.skeleton import Skeleton
from anther.perception.stem import Stem, find_stem
from anther.plant.imported import main_stem, node_named, read_source, upright
from anther.show.results import RunResults, read_run

SCENE = (".html", ".htm")


def run(args: Args) -> None:
    """Read the run and show or write it."""
    check_range("port", 1 if args.port is None else args.port, 1, 65535)
    if args.source.is_dir() and any(given is not None for given in (args.units, args.up, args.root, args.stem_tip)):
        names = "--units, --up, --root or --stem-tip"
        raise bad_input(names, given="with a run folder", allowed="skeleton files", do="Leave it out.")
    suffix = None if args.to is None else args.to.suffix.lower()
    if args.live:
        return _show(args)
    if suffix not in (None, *SCENE, *WRITES):
        raise bad_input(
            "to", given=str(args.to), allowed=" ".join((".html", *WRITES)), do="Choose one of these suffixes."
        )
    if args.to is not None:
        free(args.to, overwrite=args.overwrite)
    if args.to is not None and suffix not in SCENE:
        return _write(args, args.to)
    from anther.show import viewer  # needs the extra `view`

    check_range("exaggeration", args.exaggeration, 0, 1000)
    results = skeleton_results(args) if args.source.is_file() else read_run(args.source)
    if args.to is None:
        viewer.serve(results, args.port or 8080, exaggeration=args.exaggeration)
        return None
    viewer.write_html(args.to, results, exaggeration=args.exaggeration)
    return print(f"scene: {args.to}")


def skeleton_results(args: Args) -> RunResults:
    """Return what can be shown of an imported skeleton: its lines and, if one is found, its main stem."""
    source, skeleton = read_source(args.source, units=args.units, up=args.up, radius=args.radius, root=args.root)
    tip = None if args.stem_tip is None else source.node(node_named("--stem-tip", args.stem_tip, source))
    stem = None
    with suppress(StageFailure):
        stem = main_stem(skeleton, tip)
    return RunResults(args.source, {"capture": str(args.source)}, skeleton=skeleton, stem=stem, numbers=source.numbers)


def _write(args: Args, to: Path) -> None:
    """Write the skeleton, and say what was written."""
    skeleton, labels, notes = labelled_skeleton(args)
    write_skeleton(to, skeleton, labels)
    apart = "organs not told apart (--find-stem does it)"
    organs = apart if labels is None else f"{labels.count('stem')} stem nodes"
    print("\n".join([f"{to}: {len(skeleton.nodes)} nodes; {organs}", *(f"note: {note}" for note in notes)]))


def labelled_skeleton(args: Args) -> tuple[Skeleton, list[str] | None, tuple[str, ...]]:
    """Return (skeleton, organ name a node, or None where nothing tells, notes) of a run folder or skeleton file.

    Its radii are replaced by --radius; with --find-stem or --stem-tip the stem is found anew instead of taking the
    labels that are there.
    """
    labels: list[str] | None = None
    notes: tuple[str, ...] = ()
    if not existing(args.source).is_dir():
        file = upright(read_skeleton(args.source, args.units), args.up)
        file = file if args.root is None else file.rooted_at(node_named("--root", args.root, file))
        skeleton, notes = file.skeleton(args.radius), file.notes
        labels = None if file.labels is None else list(file.labels)
        if args.stem_tip is not None:
            tip = file.node(node_named("--stem-tip", args.stem_tip, file))
            return skeleton, main_stem(skeleton, tip).organ_names(), notes
    else:
        skeleton = Skeleton.load(kept(args.source, "skeleton"))
        if (args.source / FILES["stem"]).exists():
            labels = Stem.load(args.source / FILES["stem"]).organ_names()
    return skeleton, find_stem(skeleton).organ_names() if args.find_stem else labels, notes


def _show(args: Args) -> None:
    """Serve the trial's log until Ctrl-C."""
    from anther.show.log.live import show  # needs the extra `log`

    path = args.source / LOG
    if args.to is not None:
        raise bad_input("to", given="with --live", allowed="one of them", do="Leave one out.")

    def ready(port: int) -> None:
        how = f"Open ws://localhost:{port} in Foxglove or Lichtblick (Open connection)"
        print(f"{how}. So may any page that a browser here has open. Ctrl-C ends this, not the trial.")
        if not path.exists():
            print(f"waiting for {path} ...")

    proposed = 8765  # by Foxglove's app
    show(path, args.port or proposed, ready=ready)

"""Record how many flowers of a plant, or of one visit to it, set fruit: what the dose-response is learned from."""

from __future__ import annotations

from anther.cli.args.outcome import Args
from anther.core.errors import InputError, bad_input
from anther.history import Outcome, find_visit, read_plants, read_trials, record_outcome


def run(args: Args) -> None:
    """Record the count and say to what it belongs."""
    species, plant, visit = _meant(args)
    outcome = Outcome(species, plant, args.flowers, args.fruit, args.date, visit, args.note)
    number = record_outcome(outcome, args.history)
    what = "never visited" if args.control else "all visits since its last count" if visit is None else f"visit {visit}"
    share = f"{args.fruit} of {args.flowers} flowers set ({args.fruit / args.flowers:.0%})"
    print(f"outcome {number}: {species} '{plant}' ({what}), {args.date}: {share}")


def _meant(args: Args) -> tuple[str, str, int | None]:
    """Return (species, plant, visit or None) that the words mean."""
    kind, _, name = args.of.partition(":") if args.of.startswith(("plant:", "visit:")) else ("", "", args.of)
    plants = [] if kind == "visit" else read_plants(name, args.history, species=args.species)
    visit = find_visit(int(name), args.history) if kind != "plant" and name.isdecimal() and not args.control else None
    if args.control:
        if args.species is None:
            raise bad_input("control", given="no species", allowed="--species CROP", do="Name the crop.")
        if plants and read_trials(args.history, species=args.species, plant=name):
            raise _unclear(args, "a plant that was visited", "a plant that never was", "Leave --control out.")
        return args.species, name, None
    if visit is not None and not plants:
        return visit.species, visit.plant, visit.id
    if len(plants) == 1 and visit is None:
        return *plants[0], None
    if plants and visit is not None:
        raise _unclear(args, f"visit {name} and a plant", f"plant:{name} or visit:{name}", "Say which.")
    if plants:
        raise _unclear(args, f"plants of {', '.join(s for s, _ in plants)}", "one plant", "Add --species.")
    raise _unclear(args, "nothing", "a plant or visit that `anther history` lists", "Or --control.")


def _unclear(args: Args, given: str, allowed: str, do: str) -> InputError:
    return bad_input(f"'{args.of}'", given=given, allowed=allowed, do=do)

"""Records: frozen dataclasses whose fields state shape, unit and bounds; checked, read-only, and saved without pickle.

A field says what it holds in its annotation::

    @dataclass(frozen=True, slots=True, eq=False)
    class Skeleton(Stored):
        KIND, SCHEMA = "skeleton", 3
        nodes: Annotated[Array, Shape("J", 3), Range(unit="m")]
        parent: Annotated[NDArray[np.int64], Shape("J")]
        notes: tuple[str, ...] = ()

        def _check(self) -> None: ...  # what no field can say alone

A letter of a shape stands for one length in the whole record; the first field that has it sets it.
"""

from __future__ import annotations

import json
import math
import types
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from datetime import date, datetime
from functools import cache, reduce
from operator import or_
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from anther.core.checks import check_array, check_range, check_transform
from anther.core.errors import bad_input
from anther.core.files import read_npz, read_object, understood, write_json, write_npz


class Shape:
    """Shape of an array: lengths, or letters for lengths that several fields share.

    Attributes:
        sizes: an int or a letter each; None: any length.
        missing: whether values may be NaN: not measured.
        rigid: whether the last two axes are rigid transforms (4, 4).
    """

    __slots__ = ("missing", "rigid", "sizes")

    def __init__(self, *sizes: int | str | None, missing: bool = False, rigid: bool = False) -> None:
        self.sizes, self.missing, self.rigid = sizes, missing, rigid

    def checked(self, name: str, value: Any, dtype: np.dtype[Any], lengths: dict[str, int]) -> np.ndarray[Any, Any]:
        """Return a read-only array of this shape; letters not in `lengths` yet are added to it."""
        wanted = tuple(lengths.get(size) if isinstance(size, str) else size for size in self.sizes)
        array = check_array(name, value, wanted, dtype=dtype, finite=not self.missing)
        lengths |= {size: n for size, n in zip(self.sizes, array.shape, strict=True) if isinstance(size, str)}
        return check_transform(name, array) if self.rigid else array


@dataclass(frozen=True, slots=True)
class Range:
    """What a number, or every number of an array or tuple, may be, and its unit; "" for a pure number."""

    least: float = -math.inf
    most: float = math.inf
    unit: str = ""

    def check(self, name: str, value: Any) -> None:
        """Check a value.

        Raises:
            InputError: it is outside, NaN or no number.
        """
        if (self.least, self.most) == (-math.inf, math.inf):
            return
        if isinstance(value, np.ndarray):
            seen = value[np.isfinite(value)]
            for extreme in (seen.min(), seen.max()) if seen.size else ():
                check_range(name, float(extreme), self.least, self.most, self.unit)
        elif isinstance(value, tuple | list):
            for number in value:
                self.check(name, number)
        else:
            check_range(name, value, self.least, self.most, self.unit)


UNSAVED = "unsaved"
"""Mark of a field that no file keeps; it has a default."""
Share = Annotated[float, Range(0, 1)]
"""A share or a probability."""
Spread = Annotated[float, Range(0, 3)]
"""Standard deviation of a natural logarithm."""


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a record: its kind without marks and None, whether it may be None, and its marks."""

    name: str
    kind: Any
    optional: bool
    shape: Shape | None
    range: Range | None
    saved: bool
    flat: Flat | None

    @property
    def key(self) -> str:
        """Its name in a flat table, which ends in its unit."""
        return _key_of(self.name, self.range.unit if self.range else "")

    @property
    def rows(self) -> bool:
        """Whether it holds any number of records."""
        inner: tuple[Any, ...] = get_args(self.kind) if get_origin(self.kind) is tuple else ()
        return inner[1:] == (...,) and is_dataclass(inner[0])

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of an array: as the annotation says; float64 where it does not."""
        kinds = get_args(get_args(self.kind)[1]) if get_origin(self.kind) is np.ndarray else ()
        return np.dtype(kinds[0] if kinds and isinstance(kinds[0], type) else np.float64)

    def checked(self, name: str, value: Any, lengths: dict[str, int]) -> Any:
        """Return a value as the record holds it."""
        if value is None and self.optional:
            return value
        if self.shape is not None:
            value = self.shape.checked(name, value, self.dtype, lengths)
        elif get_origin(self.kind) is tuple:
            if not isinstance(value, list | tuple):
                raise bad_input(name, given=repr(value)[:40], allowed="a list", do="Correct it.")
            value = tuple(value) if isinstance(value, list) else value
        else:
            _check_kind(name, value, self.kind)
        if self.range is not None:
            self.range.check(name, value)
        return value


@cache
def fields_of(record: type) -> tuple[Field, ...]:
    """Return what the fields of a dataclass, those its constructor takes, state."""
    hints = get_type_hints(record, include_extras=True)
    return tuple(_field(f.name, hints[f.name]) for f in fields(record) if f.init)


Mark = TypeVar("Mark")


def _field(name: str, hint: Any) -> Field:
    kind, optional = hint, False
    marks: list[Any] = []
    while True:
        if get_origin(kind) is Annotated:
            kind, *more = get_args(kind)
            marks += more
        elif _is_union(kind) and type(None) in get_args(kind):
            optional = True
            kind = reduce(or_, [part for part in get_args(kind) if part is not type(None)])
        else:
            break

    def first(mark: type[Mark]) -> Mark | None:
        return next((m for m in marks if isinstance(m, mark)), None)

    return Field(name, kind, optional, first(Shape), first(Range), UNSAVED not in marks, first(Flat))


def _is_union(kind: Any) -> bool:
    return get_origin(kind) in (Union, types.UnionType)


_SIMPLE = {bool: bool | np.bool_, int: int | np.integer, float: float | int | np.floating | np.integer, str: str}
"""Kind of a field -> what may be in it."""


def _check_kind(name: str, value: Any, kind: Any) -> None:
    """Check that a text, number, truth value, moment or choice is one."""
    if get_origin(kind) is Literal:
        if value not in get_args(kind):
            allowed = ", ".join(map(repr, get_args(kind)))
            raise bad_input(name, given=repr(value)[:40], allowed=allowed, do="Choose one of these.")
        return
    wanted = _SIMPLE.get(kind) or (kind if kind in (date, datetime) else None)
    if wanted is not None and (not isinstance(value, wanted) or (isinstance(value, bool) and kind is not bool)):
        raise bad_input(name, given=repr(value)[:40], allowed=f"a value of type {kind.__name__}", do="Correct it.")


class Record:
    """Base of frozen dataclasses that check what their fields state; arrays become read-only.

    Attributes:
        CALLED: what stands in error messages before the name of the field, as "stem" in "stem arc length"; where it is
            empty or ends in a dot, the name follows as it is written.
    """

    __slots__ = ()
    CALLED: ClassVar[str] = ""

    def __post_init__(self) -> None:
        lengths: dict[str, int] = {}
        for field in fields_of(type(self)):
            value = getattr(self, field.name)
            dotted = self.CALLED == "" or self.CALLED.endswith(".")
            name = field.name if dotted else f" {field.name.replace('_', ' ')}"
            checked = field.checked(f"{self.CALLED}{name}", value, lengths)
            if checked is not value:
                object.__setattr__(self, field.name, checked)
        self._check()

    def _check(self) -> None:
        """Check what no field states alone."""


class Stored(Record):
    """A record that is one file: JSON where the name ends in .json, else .npz; both name kind and schema number.

    Attributes:
        KIND, SCHEMA: of the file. The number changes with what the fields are or mean.
    """

    __slots__ = ()
    KIND: ClassVar[str]
    SCHEMA: ClassVar[int]

    def save(self, path: Path | str) -> None:
        """Write the file, whole or not at all.

        Raises:
            InputError: it cannot be written.
        """
        tree = encode(self)
        if Path(path).suffix == ".json":
            write_json(path, {"kind": self.KIND, "schema": self.SCHEMA, **tree})
        else:
            arrays = dict(_taken_out(tree))
            write_npz(path, self.KIND, self.SCHEMA, fields=json.dumps(tree), **arrays)

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read what `save` wrote.

        Raises:
            InputError: missing, truncated, of another kind or schema number, or with a value that cannot be.
        """
        with understood(path):
            return decode(read_tree(path, cls.KIND, cls.SCHEMA), cls)


def read_tree(path: Path | str, kind: str, schema: int) -> dict[str, Any]:
    """Return the values in a file that `Stored.save` wrote, by the names of the fields.

    Raises:
        InputError: missing, truncated, or of another kind or schema number.
    """
    if Path(path).suffix == ".json":
        tree = read_object(path)
        found = (tree.pop("kind", None), tree.pop("schema", None))
        if found != (kind, schema):
            given = f"kind '{str(found[0])[:40]}', schema {str(found[1])[:40]}"
            do = "Write it again with this version of Anther."
            raise bad_input(str(path), given=given, allowed=f"kind '{kind}', schema {schema}", do=do)
        return tree
    arrays = read_npz(path, kind, schema)
    tree = json.loads(str(arrays.pop("fields")))
    for place, array in arrays.items():
        *way, last = place.split(".")
        holder: Any = tree
        for key in way:
            holder = holder[_key(holder, key)]
        holder[_key(holder, last)] = array
    return tree


def _key(holder: Any, key: str) -> Any:
    return int(key) if isinstance(holder, list) else key


def _taken_out(tree: Any, place: str = "") -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    """Yield (place, array) of every array in a tree, and take it out of there; places are joined by dots."""
    for key, value in list(tree.items() if isinstance(tree, dict) else enumerate(tree)):
        if isinstance(value, np.ndarray):
            yield f"{place}{key}", value
            tree[key] = None
        elif isinstance(value, dict | list):
            yield from _taken_out(value, f"{place}{key}.")


def encode(value: Any) -> Any:
    """Return a value as JSON can hold it, but for its arrays: a record is an object, NaN is null."""
    if is_dataclass(value):
        return {f.name: encode(getattr(value, f.name)) for f in fields_of(type(value)) if f.saved}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = cast(Any, value)._asdict()
    if isinstance(value, dict):
        return {str(key): encode(part) for key, part in value.items()}
    if isinstance(value, tuple | list):
        return [encode(part) for part in value]
    return value if isinstance(value, np.ndarray) else _encoded_scalar(value)


def _encoded_scalar(value: Any) -> Any:
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    if isinstance(value, date):
        return value.isoformat()
    return str(value) if isinstance(value, Path) else value


def decode(value: Any, kind: Any, name: str = "") -> Any:
    """Return what `encode` was given, of the kind that an annotation states.

    Raises:
        InputError, ValueError, TypeError, KeyError: it is not of this kind (`files.understood` says where).
    """
    field = _field(name, kind)
    kind = field.kind
    if value is None:
        return _decoded_null(field)
    if isinstance(value, np.ndarray) or kind is Any or field.shape is not None:
        return value
    if _is_union(kind):
        return _first_that_fits(value, get_args(kind), name)
    if is_dataclass(kind) or hasattr(kind, "_fields"):
        return _decoded_record(value, cast(type, kind), name or cast(type, kind).__name__)
    if get_origin(kind) in (tuple, dict):
        return _decoded_parts(value, get_origin(kind), get_args(kind), name)
    return np.array(value) if get_origin(kind) is np.ndarray else _decoded_scalar(value, kind, name)


def _decoded_null(field: Field) -> float | None:
    if field.kind is float and not field.optional:
        return math.nan
    if not field.optional and field.kind is not Any:
        raise bad_input(field.name, given="null", allowed="a value", do="Restore it.")
    return None


def _first_that_fits(value: Any, kinds: tuple[Any, ...], name: str) -> Any:
    for kind in kinds[:-1]:
        try:
            return decode(value, kind, name)
        except (TypeError, ValueError, KeyError):
            continue
    return decode(value, kinds[-1], name)


def _decoded_record(value: Any, kind: type, name: str) -> Any:
    if not isinstance(value, dict):
        raise bad_input(name, given=repr(value)[:40], allowed="an object", do="Restore it.")
    hints = get_type_hints(kind, include_extras=True)
    stated = {f.name: f.saved for f in fields_of(kind)} if is_dataclass(kind) else dict.fromkeys(hints, True)
    if unlike := [key for key in value if key not in stated]:
        raise bad_input(name, given=f"'{unlike[0]}'", allowed=", ".join(stated), do="Correct it.")
    if lacks := [key for key, saved in stated.items() if saved and key not in value]:
        raise bad_input(name, given=f"no '{lacks[0]}'", allowed=", ".join(stated), do="Restore the file.")
    return kind(**{key: decode(part, hints[key], key) for key, part in value.items()})


def _decoded_parts(value: Any, origin: Any, kinds: tuple[Any, ...], name: str) -> Any:
    wanted = dict if origin is dict else (list, tuple)
    if not isinstance(value, wanted):
        allowed = "an object" if origin is dict else "a list"
        raise bad_input(name, given=repr(value)[:40], allowed=allowed, do="Correct it.")
    if isinstance(value, dict):
        return {key: decode(part, kinds[1], name) for key, part in value.items()}
    kinds = (kinds[0],) * len(value) if kinds[1:] == (...,) else kinds
    return tuple(decode(part, kind, name) for part, kind in zip(value, kinds, strict=True))


def _decoded_scalar(value: Any, kind: Any, name: str) -> Any:
    if kind is Path:
        return Path(value)
    if kind in (datetime, date):
        return kind.fromisoformat(value)
    if kind is float and value in ("inf", "-inf"):
        return float(value)
    _check_kind(name, value, kind)
    return float(value) if kind is float else value


@dataclass(frozen=True, slots=True)
class Flat:
    """Mark of a field that holds a record whose values stand beside its own in a flat table, with a prefix."""

    prefix: str = ""


def flat(record: Any) -> dict[str, Any]:
    """Return a record as one flat object: units in the names, what a `Flat` record lacks left out, NaN null.

    What the class lists as `DERIVED`, name -> (type, function of the record), follows its fields.
    """
    kind, values = type(record), {}
    for field in fields_of(kind):
        value = getattr(record, field.name)
        if field.flat is None:
            values[field.key] = [flat(part) for part in value] if field.rows else encode(value)
        elif value is not None:
            values |= {f"{field.flat.prefix}{key}": part for key, part in flat(value).items()}
    return values | {name: encode(of(record)) for name, (_, of) in getattr(kind, "DERIVED", {}).items()}


def unflat(values: dict[str, Any], kind: type[Any]) -> Any:
    """Return the record of which `flat` made `values`; fields that are missing have their default.

    Raises:
        InputError, ValueError, TypeError, KeyError: a name is unknown, or a value is of another kind.
    """
    if unlike := sorted(set(values) - set(flat_columns(kind))):
        raise bad_input(kind.__name__.lower(), given=f"'{unlike[0]}'", allowed="what `flat` writes", do="Correct it.")
    hints, made = get_type_hints(kind, include_extras=True), {}
    for field in fields_of(kind):
        if field.flat is not None:
            prefix = field.flat.prefix
            inner = {prefix + key: key for key in flat_columns(field.kind)}
            part = {inner[key]: value for key, value in values.items() if key in inner}
            made[field.name] = unflat(part, field.kind) if part else None
        elif field.rows and field.key in values:
            made[field.name] = tuple(unflat(dict(row), get_args(field.kind)[0]) for row in values[field.key])
        elif field.key in values:
            made[field.name] = decode(values[field.key], hints[field.name], field.name)
    return kind(**made)


@cache
def flat_columns(kind: type[Any], only: tuple[str, ...] | None = None) -> dict[str, Any]:
    """Return name -> type of what `flat` gives of a record; with `only`, of these fields and derived values."""
    columns: dict[str, Any] = {}
    for field in fields_of(kind):
        if only is not None and field.name not in only:
            continue
        inner = {field.key: field.kind} if field.flat is None else flat_columns(field.kind)
        columns |= {f"{field.flat.prefix if field.flat else ''}{key}": of for key, of in inner.items()}
    derived = getattr(kind, "DERIVED", {}).items()
    return columns | {name: of for name, (of, _) in derived if only is None or name in only}


def _key_of(name: str, unit: str) -> str:
    """Return a name with its unit: length_m, frequency_hz, acceleration_ms2, stiffness_n_m."""
    short = unit.replace("m/s2", "ms2").replace(" ", "").replace("/", "_").lower()
    return f"{name}_{short}" if short else name

"""The base of every file model, kinds of numbers, and messages for values out of bounds."""

import json
from collections.abc import Iterator
from itertools import islice
from typing import Annotated, Any, ClassVar, Final, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, model_validator

from wcsim.core.reading import escape, read_module_toml
from wcsim.errors import meant

# Of numbers that nothing else bounds: nothing that is computed from them overflows.
_LARGEST: Final = 1e9
Positive = Annotated[float, Field(gt=0.0, le=_LARGEST, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, le=_LARGEST, allow_inf_nan=False)]
PositiveShare = Annotated[float, Field(gt=0.0, le=1.0)]
TopSpeed = Annotated[float, Field(gt=0.1, le=5.0)]
Finite = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST, allow_inf_nan=False)]
Word = Annotated[str, Field(max_length=400)]
Text = Annotated[str, Field(max_length=16_384)]  # paths, commands, attributions
Texts = Annotated[tuple[Text, ...], Field(max_length=64)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
Seed = Annotated[int, Field(ge=0, lt=1 << 31)]  # as large as SUMO takes them
_BOUNDS: Final = {"gt": "more than", "ge": "at least", "lt": "less than", "le": "at most"}
_UNITS: Final[dict[str, str]] = read_module_toml(__file__)
# Of a table: with more keys a message names the nearest alone.
_MOST_KEYS: Final = 16
_OUT_OF_BOUNDS: Final = (
    "greater_than",
    "greater_than_equal",
    "less_than",
    "less_than_equal",
    "finite_number",
)


def within(low: float, high: float) -> Any:
    """A bound for `Annotated`: a number from `low` to `high`, both of them allowed."""
    return Field(ge=low, le=high)


def exclude_if(default: Any) -> Any:
    """A mark for `Annotated`: a field is not written while it has this value."""
    # A setting that is younger than the first files: without it their digests would change.
    return Field(exclude_if=lambda value: value == default)


Share = Annotated[float, within(0.0, 1.0)]
UserMass = Annotated[float, within(25.0, 150.0)]


class Model(BaseModel):
    """Base of all models. They are frozen and reject unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    # Words that are taken in the place of its table.
    stand_ins: ClassVar[tuple[str, ...]] = ()

    @model_validator(mode="before")
    @classmethod
    def _with_few_unknown_keys(cls, data: Any) -> Any:
        # Pydantic reports each error in a kilobyte: a megabyte of wrong items would take gigabytes.
        if not isinstance(data, dict) or len(data) <= len(cls.model_fields) + _MOST_KEYS:
            return data
        unknown = islice((key for key in data if key not in cls.model_fields), _MOST_KEYS)
        return {
            **{key: data[key] for key in cls.model_fields if key in data},
            **{key: data[key] for key in unknown},
        }

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> Any:
        """As usual, but lists and tables are given up at their first item that is wrong."""
        schema: Any = handler(source)
        # Each error takes a kilobyte, and one says what is wrong with the list.
        waiting = [schema]
        while waiting:
            part = waiting.pop()
            if isinstance(part, dict):
                if part.get("type") in ("tuple", "list", "dict"):
                    part["fail_fast"] = True
                waiting += part.values()
            elif isinstance(part, list):
                waiting += part
        return schema


def format_validation_error(model: type[BaseModel], item: Any) -> str:
    """The message of pydantic's error: the key, the fault, the value with its unit, the bounds."""
    key = escape(".".join(str(part) for part in item["loc"]), 200) or "(file)"
    if item["type"] == "extra_forbidden":
        return f"unknown key {key!r}: remove it or correct its name" + _known(model, item["loc"])
    if item["type"] == "missing":
        keys = item["input"] if isinstance(item["input"], dict) else {}
        beside = escape(", ".join(map(str, keys)), 200)
        return f"{key}: is missing" + (f"; expected it beside {beside}" if beside else "")
    value = json.dumps(item["input"], default=str)[:80]
    if item["type"] in ("tuple_type", "list_type"):
        return f"{key}: expected a list, got {value}; write the whole list, as {key}=[...]"
    if item["type"] == "model_type":
        return f"{key}: got {value}; {_table(model, item)}"
    if item["type"] not in _OUT_OF_BOUNDS:
        return f"{key}: {item['msg']}, got {value}"
    names = [part for part in item["loc"] if isinstance(part, str)]
    unit = _UNITS.get(names[-1].rpartition("_")[2], "") if names else ""
    limits = [f"{_BOUNDS[name]} {limit:g}" for name, limit in _bounds(model, item["loc"]).items()]
    bounds = " and ".join(limits) or "a finite number"
    received = f"{key}: {item['msg']}, got {value} {unit}".rstrip()
    return received + f"; expected {bounds} {unit}".rstrip()


def _known(model: type[BaseModel], loc: tuple[str | int, ...]) -> str:
    """The known keys beside an unknown one: the one that looks like it, or all of a few."""
    keys = list(_first_model(_at(model, loc[:-1])).model_fields)
    near = meant(str(loc[-1]), keys)
    if near or not keys or len(keys) > _MOST_KEYS:
        return near
    return f"; expected one of: {', '.join(keys)}"


def _table(model: type[BaseModel], item: Any) -> str:
    """What is expected in place of a value that is no table, and the nearest word for it."""
    kind = _first_model(_at(model, item["loc"]))
    words = getattr(kind, "stand_ins", ())
    keys = list(kind.model_fields)
    table = f"a table of {', '.join(keys)}" if 0 < len(keys) <= _MOST_KEYS else "a table of keys"
    expected = f"expected {', '.join(words)}, or {table}" if words else f"expected {table}"
    return expected + (meant(item["input"], words) if isinstance(item["input"], str) else "")


def _bounds(model: type[BaseModel], loc: tuple[str | int, ...]) -> dict[str, float]:
    """The bounds of the number at `loc` of a model, by their names in pydantic."""
    # Pydantic's fields have `metadata`, types inside a list have `__metadata__`.
    held = [
        note
        for kind in _parts(_at(model, loc))
        for note in getattr(kind, "metadata", getattr(kind, "__metadata__", ()))
    ]
    notes = [note for extra in held for note in (extra, *getattr(extra, "metadata", ()))]
    return {
        name: getattr(note, name)
        for note in notes
        for name in _BOUNDS
        if getattr(note, name, None) is not None
    }


def _at(model: type[BaseModel], loc: tuple[str | int, ...]) -> Any:
    """The field or type at `loc` of a model."""
    here: Any = model
    for part in loc:
        if isinstance(part, int):
            fixed = next((get_args(kind) for kind in _parts(here) if get_origin(kind) is tuple), ())
            here = fixed[part] if part < len(fixed) and Ellipsis not in fixed else here
            continue
        here = _first_model(here).model_fields.get(part, here)
    return here


def _parts(kind: Any) -> Iterator[Any]:
    """A type (or a field) and, one after the other, all types inside it."""
    yield kind
    inner = getattr(kind, "annotation", None)
    for part in get_args(kind) if inner is None else (inner,):
        yield from _parts(part)


def _first_model(kind: Any) -> Any:
    """The first model in a type or field; without one the base, which has no fields."""
    for part in _parts(kind):
        if isinstance(part, type) and issubclass(part, BaseModel):
            return part
    return Model

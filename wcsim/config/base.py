"""The base of every file model, the kinds of numbers in them, and the words for a value that is out of bounds."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import islice
from typing import Annotated, Any, ClassVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, model_validator

from wcsim.core.reading import escaped, own_data
from wcsim.errors import meant


def within(low: float, high: float) -> Any:
    """A bound for `Annotated`: a number from `low` to `high`, both of them allowed."""
    return Field(ge=low, le=high)


_LARGEST = 1e9  # of numbers that nothing else bounds: nothing that is computed of them overflows
Positive = Annotated[float, Field(gt=0.0, le=_LARGEST, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, le=_LARGEST, allow_inf_nan=False)]
Share = Annotated[float, within(0.0, 1.0)]
PositiveShare = Annotated[float, Field(gt=0.0, le=1.0)]
UserMass = Annotated[float, within(25.0, 150.0)]
TopSpeed = Annotated[float, Field(gt=0.1, le=5.0)]
Finite = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST, allow_inf_nan=False)]
Word = Annotated[str, Field(max_length=400)]
Text = Annotated[str, Field(max_length=16_384)]  # paths, commands, attributions
Texts = Annotated[tuple[Text, ...], Field(max_length=64)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
Seed = Annotated[int, Field(ge=0, lt=1 << 31)]  # as large as SUMO takes them

_BOUNDS = {"gt": "more than", "ge": "at least", "lt": "less than", "le": "at most"}
_UNITS: dict[str, str] = own_data(__file__)
_OUT_OF_BOUNDS = (
    "greater_than",
    "greater_than_equal",
    "less_than",
    "less_than_equal",
    "finite_number",
)


_MOST_KEYS = 16  # of a table that are all named where one is unknown


class Model(BaseModel):
    """Base of all models. They are frozen and reject unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    stand_ins: ClassVar[tuple[str, ...]] = ()  # words that are taken in the place of its table

    # Pydantic tells every error of a file in a kilobyte each: of a megabyte of wrong items that were gigabytes.

    @model_validator(mode="before")
    @classmethod
    def _with_few_unknown_keys(cls, data: Any) -> Any:
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


def fault(model: type[BaseModel], item: Any) -> str:
    """One error of pydantic in words: the key, what is wrong, what was got with its unit, and its bounds."""
    key = escaped(".".join(str(part) for part in item["loc"]), 200) or "(file)"
    if item["type"] == "extra_forbidden":
        return f"unknown key {key!r}: remove it or correct its name" + _known(model, item["loc"])
    if item["type"] == "missing":
        beside = (
            escaped(", ".join(map(str, item["input"])), 200)
            if isinstance(item["input"], dict)
            else ""
        )
        return f"{key}: is missing" + f"; expected it beside {beside}" * bool(beside)
    got = json.dumps(item["input"], default=str)[:80]
    if item["type"] in ("tuple_type", "list_type"):
        return f"{key}: expected a list, got {got}; write the whole list, as {key}=[...]"
    if item["type"] == "model_type":
        return f"{key}: got {got}; {_table(model, item)}"
    if item["type"] not in _OUT_OF_BOUNDS:
        return f"{key}: {item['msg']}, got {got}"
    names = [part for part in item["loc"] if isinstance(part, str)]
    unit = _UNITS.get(names[-1].rpartition("_")[2], "") if names else ""
    limits = [f"{_BOUNDS[name]} {limit:g}" for name, limit in _bounds(model, item["loc"])]
    bounds = " and ".join(limits) or "a finite number"
    return (
        f"{key}: {item['msg']}, got {got} {unit}".rstrip() + f"; expected {bounds} {unit}".rstrip()
    )


def _known(model: type[BaseModel], loc: tuple[str | int, ...]) -> str:
    """The keys of the table that an unknown key stands in: the one that it looks like, or all where they are few."""
    keys = list(
        next((kind.model_fields for kind in _parts(_at(model, loc[:-1])) if _is_model(kind)), {})
    )
    near = meant(str(loc[-1]), keys)
    return (
        near
        if near or not keys or len(keys) > _MOST_KEYS
        else f"; expected one of: {', '.join(keys)}"
    )


def _table(model: type[BaseModel], item: Any) -> str:
    """What is expected where something else stands than a table, and the word for it that is nearest."""
    kind = next((kind for kind in _parts(_at(model, item["loc"])) if _is_model(kind)), Model)
    words, keys = getattr(kind, "stand_ins", ()), list(kind.model_fields)
    table = f"a table of {', '.join(keys)}" if 0 < len(keys) <= _MOST_KEYS else "a table of keys"
    expected = f"expected {', '.join(words)}, or {table}" if words else f"expected {table}"
    return expected + (meant(item["input"], words) if isinstance(item["input"], str) else "")


def _bounds(model: type[BaseModel], loc: tuple[str | int, ...]) -> list[tuple[str, float]]:
    """The bounds (their name in pydantic, the limit) of the number at `loc` of a model; empty when there are none."""
    held = [
        note
        for kind in _parts(_at(model, loc))
        for note in getattr(kind, "metadata", getattr(kind, "__metadata__", ()))
    ]
    notes = [note for extra in held for note in (extra, *getattr(extra, "metadata", ()))]
    found = {
        name: getattr(note, name)
        for note in notes
        for name in _BOUNDS
        if getattr(note, name, None) is not None
    }
    return list(found.items())


def _at(model: type[BaseModel], loc: tuple[str | int, ...]) -> Any:
    """The field or type at `loc` of a model."""
    here: Any = model
    for part in loc:
        if isinstance(part, int):
            fixed = next((get_args(kind) for kind in _parts(here) if get_origin(kind) is tuple), ())
            here = fixed[part] if part < len(fixed) and Ellipsis not in fixed else here
            continue
        fields: dict[str, Any] = next(
            (kind.model_fields for kind in _parts(here) if _is_model(kind)), {}
        )
        if part in fields:
            here = fields[str(part)]
    return here


def _parts(kind: Any) -> Iterator[Any]:
    """A type (or a field) and, one after the other, all types inside it."""
    yield kind
    inner = getattr(kind, "annotation", None)
    for part in get_args(kind) if inner is None else (inner,):
        yield from _parts(part)


def _is_model(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)

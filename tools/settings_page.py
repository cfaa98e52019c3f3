"""`docs/settings.md`: all settings of a run, made from their models."""

from __future__ import annotations

import ast
import inspect
import json
import re
import textwrap
from collections.abc import Iterator
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from tools.pages import table
from wcsim.config import RunConfig
from wcsim.config.scene import SceneExpectations, SceneFile, SceneSeat, TownFile

HEAD = """# All settings of a run

These keys work in `--set section.key=value`, in a `--config` file and in a preset (`wcsim/config/presets/`). Unknown
keys and values out of bounds are rejected. The end of a name is its unit; only names in `_deg` are angles in degrees.
An item of a list has a number: `cameras.0.width_px=80`.

The last of these wins: preset, `--config`, `--set`, options of the command, what learner and network fix. `chair.plant`
and `chair.profile` change several values of the preset; whatever else sets one of these wins.

Other files: [plants](chair.md#every-field), [suites](suites.md), [towns and scenes](#files-of-towns-and-scenes).

This page is generated: `python -m tools.pages`.
"""
FILES = """# Files of towns and scenes

A town is a SUMO scenario with a `town.toml`. A scene is a folder of SUMO's plain XML with a `scene.toml`
([how to make them](authoring.md)). A key with the default "none" is required.
"""
_SIGNS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤", "min_length": "length ≥", "max_length": "length ≤"}
_COMMENT = re.compile(r"(?:^ *|  )# (?!fmt)(.*)", re.MULTILINE)
_LARGEST = 1e9  # stands for no bound, see wcsim/config/base.py


def page() -> str:
    """The page, in Markdown."""
    own, others = ([_section(name, model) for name, model in each] for each in (sections(), file_sections()))
    return "\n".join([HEAD, *own, FILES, *others])


def sections() -> list[tuple[str, type[BaseModel]]]:
    """Every table of a run's configuration: its name in a file, its model."""
    found: list[tuple[str, type[BaseModel]]] = []
    for name, field in RunConfig.model_fields.items():
        found += _below(f"[[{name}]]" if get_origin(field.annotation) is tuple else f"[{name}]", field)
    return found


def file_sections() -> list[tuple[str, type[BaseModel]]]:
    """The tables of the files of towns and scenes."""
    return [
        ("town.toml", TownFile),
        ("scene.toml", SceneFile),
        ("[[seats]] of scene.toml", SceneSeat),
        ("[expect] of scene.toml", SceneExpectations),
    ]


def keys(model: type[BaseModel]) -> list[tuple[str, FieldInfo, str]]:
    """The keys of a table that are no tables themselves, each with its one line of meaning; "" where it has none."""
    said = meanings(model)
    return [(name, field, said.get(name, "")) for name, field in model.model_fields.items() if _model_of(field) is None]


def meanings(model: type[BaseModel]) -> dict[str, str]:
    """By field: its description, or the comment behind it, or else the one on lines of their own right above it."""
    found = {name: field.description for name, field in model.model_fields.items() if field.description}
    for base in model.__bases__:
        found |= meanings(base) if issubclass(base, BaseModel) and base.model_fields else {}
    source = textwrap.dedent(inspect.getsource(model))
    lines = source.splitlines()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            first = node.lineno - 1
            behind = _COMMENT.findall("\n".join(lines[first : node.end_lineno]))
            while lines[first - 1].lstrip().startswith("#"):
                first -= 1
            above = _COMMENT.findall("\n".join(lines[first : node.lineno - 1]))
            found.setdefault(node.target.id, " ".join(behind or above))
    return found


def _section(name: str, model: type[BaseModel]) -> str:
    cells = [
        (f"`{key}`", _kind(field.annotation), _bounds(field), _default(field), said.replace("|", "\\|"))
        for key, field, said in keys(model)
    ]
    rows = table(("key", "type", "bounds", "default", "meaning"), cells) if cells else []
    return "\n".join([f"## `{name}`", " ".join((inspect.getdoc(model) or "").split()), "", *rows, ""])


def _below(name: str, field: FieldInfo) -> Iterator[tuple[str, type[BaseModel]]]:
    model = _model_of(field)
    if model is None:
        return
    yield name, model
    inner = name.strip("[]")
    for key, part in model.model_fields.items():
        yield from _below(f"[{inner}.{key}]", part)


def _model_of(field: FieldInfo) -> type[BaseModel] | None:
    """The model of a table; None for a plain value."""
    parts = [field.annotation, *_inside(field.annotation)]
    return next((part for part in parts if isinstance(part, type) and issubclass(part, BaseModel)), None)


def _inside(kind: Any) -> Iterator[Any]:
    for part in get_args(kind):
        yield part
        yield from _inside(part)


def _kind(kind: Any) -> str:
    """A type in the words of a file."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _kind(parts[0])
    if origin is Literal:
        return ", ".join(f"`{part}`" for part in parts)
    if origin in (Union, UnionType):
        return " or ".join(_kind(part) for part in parts if part is not NoneType)
    if origin is tuple:
        if Ellipsis in parts:
            return f"list of {_kind(parts[0])}"
        return f"[{', '.join(_kind(part) for part in parts)}]"
    if origin is dict:
        return f"table of {_kind(parts[1])}"
    return {float: "number", int: "integer", str: "text", bool: "true or false"}.get(
        kind, getattr(kind, "__name__", "")
    )


def _bounds(field: FieldInfo) -> str:
    """Its bounds; of a list or a table those of its items too."""
    return ", ".join(dict.fromkeys([*_limits(field.metadata), *_inner_limits(field.annotation)]))


def _inner_limits(kind: Any) -> Iterator[str]:
    if get_origin(kind) is Annotated:
        yield from _limits([note for held in get_args(kind)[1:] for note in (held, *getattr(held, "metadata", ()))])
    for part in get_args(kind):
        yield from _inner_limits(part)


def _limits(notes: list[Any]) -> Iterator[str]:
    for note in notes:
        for name, sign in _SIGNS.items():
            limit = getattr(note, name, None)
            if limit is not None and abs(limit) != _LARGEST:
                yield f"{sign} {limit:g}"


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "none"
    value = field.get_default(call_default_factory=True)
    return "" if value is None else f"`{json.dumps(value)}`"

"""Shows what a field's own line says of it (shape, unit, meaning) on the pages of names; used by mkdocstrings."""

from __future__ import annotations

import ast
import io
import tokenize
from functools import cache
from pathlib import Path
from typing import Any

import griffe


class FieldComments(griffe.Extension):
    """A field of a class without a text of its own has the comment at the end of its line."""

    def on_attribute_instance(self, *, node: ast.AST | griffe.ObjectNode, attr: griffe.Attribute, **_: Any) -> None:
        """Called by griffe for each variable that it reads."""
        if attr.docstring is not None or attr.parent is None or not attr.parent.is_class:
            return
        if not isinstance(node, ast.AnnAssign | ast.Assign) or not isinstance(attr.filepath, Path):
            return
        comments = _comments(attr.filepath)
        said = next((comments[line] for line in range(node.lineno, _end(node) + 1) if line in comments), "")
        if said:
            attr.docstring = griffe.Docstring(said, parent=attr)


def _end(node: ast.stmt) -> int:
    return node.end_lineno or node.lineno


@cache
def _comments(path: Path) -> dict[int, str]:
    """By line: its comment; those for tools are none."""
    tokens = tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline)
    found = {token.start[0]: token.string.lstrip("# ") for token in tokens if token.type == tokenize.COMMENT}
    return {line: text for line, text in found.items() if not text.startswith(("fmt", "noqa", "type:"))}

"""Settings from a file and from the command line."""

import ast
from collections.abc import Iterable
from dataclasses import fields, replace
import difflib
from pathlib import Path
from typing import Any

from mv_slapse.config import Settings
from mv_slapse.errors import UsageError
from mv_slapse.storage import yaml_files


def read_settings(path: str | Path, settings: Settings | None = None) -> Settings:
    """Return settings changed by a YAML file ``section: {name: value}``.

    A node's parameter file will do as well: sections are looked for under ``ros__parameters``,
    and what only nodes have is left out.

    Raises
    ------
    UsageError
        Where the file cannot be read, or names a setting that does not exist.
    """
    try:
        content = yaml_files.load(path)
    except (OSError, ValueError) as error:
        raise UsageError(f'{path} cannot be read as a settings file: '
                         f'{" ".join(str(error).split())}') from None
    if not isinstance(content, dict):
        raise UsageError(f'{path} is not a settings file; write "section: {{name: value}}"')
    settings = settings or Settings()
    for section, values in _sections(content):
        for name, value in values.items():
            settings = change(settings, f'{section}.{name}', value)
    return settings


def override(settings: Settings, assignments: Iterable[str]) -> Settings:
    """Return settings changed by texts like ``scene.camera_height=1.65``.

    Raises
    ------
    UsageError
        Naming the text, and what there is to choose from.
    """
    for assignment in assignments:
        name, equals, text = assignment.partition('=')
        if not equals:
            raise UsageError(f'--set {assignment!r}: write it as section.name=value')
        settings = change(settings, name.strip(), _literal(text.strip()))
    return settings


def change(settings: Settings, name: str, value: Any) -> Settings:
    """Return settings of which one, ``section.name``, has another value."""
    known = [f'{part.name}.{field.name}' for part in fields(settings)
             for field in fields(getattr(settings, part.name))]
    if name not in known:
        near = difflib.get_close_matches(name, known, 3)
        raise UsageError(f'there is no setting {name}; '
                         + (f'did you mean {" or ".join(near)}?' if near else
                            'docs/parameters.md lists all'))
    section, _, item = name.partition('.')
    part = getattr(settings, section)
    new = _as(name, value, getattr(part, item))
    return replace(settings, **{section: replace(part, **{item: new})})


def _sections(content: dict) -> Iterable[tuple[str, dict]]:
    known = {field.name for field in fields(Settings)}
    for key, value in content.items():
        if isinstance(value, dict) and isinstance(value.get('ros__parameters'), dict):
            for name, part in value['ros__parameters'].items():
                section, dot, item = name.partition('.')
                if section in known and (dot or isinstance(part, dict)):
                    yield section, {item: part} if dot else part
        elif isinstance(value, dict):
            yield key, value
        else:
            raise UsageError(f'setting {key!r} stands outside a section; write '
                             '"section: {name: value}"')


def _literal(text: str) -> Any:
    try:
        return ast.literal_eval({'true': 'True', 'false': 'False'}.get(text.lower(), text))
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return text


def _float(name: str, value: int) -> float:
    try:
        return float(value)
    except OverflowError:
        raise UsageError(f'setting {name} cannot be so large: it has {len(str(value))} digits'
                         ) from None


def _as(name: str, value: Any, old: Any) -> Any:
    """Return the value with the type of the one it replaces."""
    if isinstance(old, float) and isinstance(value, int) and not isinstance(value, bool):
        return _float(name, value)
    if isinstance(old, tuple) and isinstance(value, list):
        return tuple(value)
    if type(value) is not type(old):
        raise UsageError(f'setting {name} takes a {type(old).__name__}, not {value!r}')
    return value

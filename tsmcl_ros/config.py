"""
Configuration: frozen dataclasses whose fields are documented, ranged and validated once.

Nodes declare ROS parameters from them, scripts build argparse options, YAML is read and dumped,
and errors quote them; no name, default or range is written twice.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, MISSING, replace
from difflib import get_close_matches
import math
from pathlib import Path
import sys
import types
import typing
from typing import Any, TypeVar

from tsmcl_ros.types import ConfigError
import yaml

C = TypeVar('C', bound='Config')

# What reading YAML may raise: numbers and dates that are none are ValueErrors.
_UNREADABLE = (yaml.YAMLError, ValueError)
_DEEPEST = 20
_MOST_BITS = 14_000  # of a whole number, which is within the 4300 digits that Python writes
_TAGS = (None, '!', 'tag:yaml.org,2002:str')
_LARGEST_FILE = 2**18  # bytes; all parameters with their documentation are a tenth of it


@dataclass(frozen=True)
class Parameter:
    """One documented field of a config: the source of ROS parameters, options and YAML."""

    name: str
    attribute: str
    type: type[Any]
    default: Any
    doc: str
    unit: str = ''
    low: float | None = None
    high: float | None = None
    above: float | None = None
    choices: tuple[Any, ...] = ()
    live: bool = False
    ids: bool = False

    @property
    def allowed(self) -> str:
        """Say in words which values are allowed."""
        kind = {float: 'a number', int: 'a whole number', bool: 'true or false', str: 'a text',
                tuple: 'a list of texts'}[self.type]
        return self.bounds if self.choices else ' '.join([kind, self.bounds]).strip()

    @property
    def bounds(self) -> str:
        """Say in words which of the type's values are allowed, '' if all are."""
        if self.choices:
            return 'one of ' + ', '.join(map(str, self.choices))
        unit = f' {self.unit}' if self.unit else ''
        return ' and '.join(
            f'{word} {bound:g}{unit}'
            for word, bound in (('at least', self.low), ('above', self.above),
                                ('at most', self.high))
            if bound is not None
        )

    def refuse(self, value: Any) -> ConfigError:
        """Return the error that names this parameter, the value, and what is allowed."""
        try:
            shown = repr(value)
        except ValueError:  # Longer ones Python does not write.
            shown = 'a number of thousands of digits'
        return ConfigError(f'{self.name}: {shown} is not allowed, must be {self.allowed}')

    def convert(self, value: Any) -> Any:
        """
        Return the value as this parameter's type.

        Only lossless conversions are made: a whole number where a number or an id is wanted, a
        list where a tuple is.

        Raises
        ------
        ConfigError
            If the value has another type, or lies outside what is allowed.

        """
        if self.type is float and type(value) is int and abs(value) <= sys.float_info.max:
            value = float(value)
        elif self.type is tuple and isinstance(value, (list, tuple)):
            value = tuple(str(item) if self.ids and type(item) is int else item for item in value)
        if type(value) is not self.type:
            raise self.refuse(value)
        if self.type is tuple and not all(isinstance(item, str) for item in value):
            raise self.refuse(value)
        if self.choices and value not in self.choices:
            raise self.refuse(value)
        if self.type in (int, float):
            fits = (
                (self.low is None or value >= self.low)
                and (self.above is None or value > self.above)
                and (self.high is None or value <= self.high)
                and (value.bit_length() <= _MOST_BITS if self.type is int
                     else math.isfinite(value))
            )
            if not fits:
                raise self.refuse(value)
        return value

    def parse(self, text: str) -> Any:
        """Return the value that a command line's or a parameter override's text stands for."""
        if self.type is str:
            return self.convert(text)
        if self.type is tuple:
            return self.convert([item for item in text.split(',') if item])
        try:
            value = _read_yaml(text)
            if self.type is float and isinstance(value, str):
                value = float(value)
        except _UNREADABLE:
            raise self.refuse(text) from None
        return self.convert(value)


def param(default: Any, doc: str, **constraints: Any) -> Any:
    """
    Return a dataclass field that carries its documentation and its allowed values.

    Parameters
    ----------
    default
        A float, int, bool, str, or tuple of str; its type is the parameter's.
    doc
        One line.
    **constraints
        `unit`, `low` and `high` (inclusive), `above` (exclusive), `choices`, `live` if it may
        change while what it configures runs, `ids` if whole numbers may stand among a list's
        texts, and `name` where ROS users know it by one that is
        no identifier (`initial_pose.x`).

    """
    return field(default=default, metadata={'doc': doc, **constraints})


class Config:
    """Base of all configs: a frozen dataclass whose every field is made by `param`."""

    def __post_init__(self) -> None:
        """Refuse, never clamp, what the fields do not allow."""
        for parameter in parameters(type(self)):
            value = parameter.convert(getattr(self, parameter.attribute))
            object.__setattr__(self, parameter.attribute, value)
        self.check()

    def check(self) -> None:
        """Refuse combinations of values; raise ConfigError. Overridden where there are any."""


def parameters(cls: type[Config]) -> tuple[Parameter, ...]:
    """Return the documented fields of a config class, in order."""
    found = []
    hints = typing.get_type_hints(cls)
    for item in fields(cls):  # type: ignore[arg-type]
        if item.default is MISSING or 'doc' not in item.metadata:
            raise TypeError(f'{cls.__name__}.{item.name} is not made by param()')
        kind = hints[item.name]
        origin = typing.get_origin(kind)
        kind = origin if isinstance(origin, type) and origin is not types.UnionType else kind
        named = {'name': item.name, **item.metadata}
        found.append(Parameter(attribute=item.name, type=kind, default=item.default, **named))
    return tuple(found)


def build(cls: type[C], values: Mapping[str, Any]) -> C:
    """
    Return a config from those of the values that it has fields for.

    Use `refuse_unknown` to hold that each value has a place somewhere.
    """
    return cls(**{
        item.attribute: values[item.name] for item in parameters(cls) if item.name in values
    })


def adjust(configs: Iterable[Config], values: Mapping[str, Any]) -> None:
    """
    Change live parameters of configs in place, for all who share these.

    Frozen as configs are otherwise, a live parameter is to be read where it is used, not copied.

    Parameters
    ----------
    configs
        Values that they have no fields for are left aside.
    values
        By name.

    Raises
    ------
    ConfigError
        If a value is not allowed, or a parameter that is not live would change; then none does.

    """
    changes = []
    for config in configs:
        items = [item for item in parameters(type(config)) if item.name in values]
        wanted = replace(config, **{  # type: ignore[type-var]
            item.attribute: values[item.name] for item in items})
        for item in items:
            old, new = (getattr(which, item.attribute) for which in (config, wanted))
            if new != old and not item.live:
                raise ConfigError(
                    f'{item.name} cannot change from {old!r} to {new!r} while it is in use')
            changes.append((config, item.attribute, new))
    for config, attribute, new in changes:
        object.__setattr__(config, attribute, new)


def refuse_unknown(values: Iterable[str], classes: Iterable[type[Config]], source: str) -> None:
    """
    Hold that every name is a field of one of the classes.

    Raises
    ------
    ConfigError
        Naming the source, the unknown name, and the nearest known ones.

    """
    known = sorted({item.name for cls in classes for item in parameters(cls)})
    for name in values:
        if name not in known:
            near = get_close_matches(name, known, 3) or known
            raise ConfigError(
                f'{source}: unknown parameter {name!r}, did you mean {" or ".join(near)}?'
                if len(near) <= 3
                else f'{source}: unknown parameter {name!r}, known are {", ".join(near)}'
            )


def add_arguments(parser: argparse.ArgumentParser, *classes: type[Config]) -> None:
    """
    Give the parser one `--option` a parameter; those not given are absent from the result.

    A parameter that several classes inherit becomes an option once.
    """
    seen: set[str] = set()
    for cls in classes:
        group = parser.add_argument_group(cls.__name__.removesuffix('Config').lower())
        for item in parameters(cls):
            if item.name in seen:
                continue
            seen.add(item.name)
            unit = f' [{item.unit}]' if item.unit else ''
            group.add_argument(
                f'--{item.name.replace("_", "-")}',
                dest=item.name,
                metavar=item.type.__name__.upper(),
                default=argparse.SUPPRESS,
                help=f'{item.doc}{unit}; {item.allowed} (default: {item.default})'
                     .replace('%', '%%'),
            )


def given_arguments(namespace: argparse.Namespace, *classes: type[Config]) -> dict[str, Any]:
    """
    Return the parameters that the command line gave, converted.

    Raises
    ------
    ConfigError
        If a value is not allowed.

    """
    return {
        item.name: item.parse(getattr(namespace, item.name))
        for cls in classes
        for item in parameters(cls)
        if hasattr(namespace, item.name)
    }


def load_yaml(path: str | Path, node: str = '') -> dict[str, Any]:
    """
    Return the parameters that a ROS parameter file holds for a node.

    The sections `/**` and the node's own name are read, the latter wins; nested keys are joined
    by dots as ROS does.

    Raises
    ------
    ConfigError
        If the file is missing or is not a ROS parameter file.

    """
    try:
        with Path(path).open('rb') as file:
            content = file.read(_LARGEST_FILE + 1)
        if len(content) > _LARGEST_FILE:
            raise ConfigError(
                f'{path}: is larger than a parameter file may be, {_LARGEST_FILE} bytes')
        document = _read_yaml(content.decode())
    except OSError as error:
        raise ConfigError(f'{path}: cannot read the parameter file: {error.strerror}') from None
    except _UNREADABLE as error:
        reason = ' '.join(str(error).split())
        raise ConfigError(f'{path}: is not a YAML file: {reason}') from None
    values: dict[str, Any] = {}
    for name in ('/**', node, f'/{node}', f'/**/{node}'):
        if not isinstance(document, dict):
            break
        section = document.get(name)
        if isinstance(section, dict) and isinstance(section.get('ros__parameters'), dict):
            values.update(_flatten(section['ros__parameters']))
    if not values:
        raise ConfigError(
            f'{path}: holds no parameters, expected "/**:" with "ros__parameters:" below it'
        )
    return values


class _Loader(yaml.SafeLoader):  # type: ignore[misc]
    """Reads what ROS's own parser of parameters reads: no aliases, no tags but !!str."""

    _depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Refuse what makes small files grow without bound, and types that are told."""
        event = self.peek_event()
        problem = ''
        if isinstance(event, yaml.AliasEvent):
            problem = f'the alias *{event.anchor} is not allowed, parameters have none'
        elif getattr(event, 'tag', None) not in _TAGS:
            problem = f'the tag {event.tag} is not allowed, must be !!str or none'
        elif self._depth > _DEEPEST:
            problem = f'more than {_DEEPEST} levels are not allowed'
        if problem:
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


def _read_yaml(text: str) -> Any:
    """Return what a YAML document holds; raise one of `_UNREADABLE` if it cannot be read."""
    return yaml.load(text, _Loader)


def dump_yaml(*configs: Config, commented: bool = True) -> str:
    """
    Return a ROS parameter file, by default commented from the fields' documentation.

    A parameter that several configs inherit stands in it once.
    """
    lines: dict[str, str] = {}
    for config in configs:
        for item in parameters(type(config)):
            unit = f' [{item.unit}]' if item.unit else ''
            comment = f'  # {item.doc}{unit}; {item.allowed}' if commented else ''
            value = _inline(getattr(config, item.attribute))
            lines.setdefault(item.name, f'    {item.name}: {value}{comment}')
    return '\n'.join(['/**:', '  ros__parameters:', *lines.values()]) + '\n'


def _inline(value: Any) -> str:
    """Return a parameter's value as YAML on one line; texts in quotes keep theirs escaped."""
    text: str = yaml.safe_dump(
        list(value) if isinstance(value, tuple) else value,
        default_flow_style=True,
        default_style='"' if isinstance(value, (str, tuple)) else None,
        width=math.inf,
    )
    return text.splitlines()[0]


def _flatten(section: Mapping[str, Any], prefix: str = '') -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in section.items():
        if isinstance(value, dict):
            flat.update(_flatten(value, f'{prefix}{key}.'))
        else:
            flat[f'{prefix}{key}'] = value
    return flat

"""Parameter files, and values from command lines."""

from __future__ import annotations

from contextlib import suppress
from random import Random

from harness import number, Scratch, Target, text, TEXTS
from tsmcl_ros.config import build, dump_yaml, load_yaml, parameters, refuse_unknown
from tsmcl_ros.inputs import InputConfig
from tsmcl_ros.localizer import CONFIGS
from tsmcl_ros.scripts.wiring import Remapping
from tsmcl_ros.types import ConfigError

_folder = Scratch()
_CLASSES = (InputConfig, *CONFIGS)
_ITEMS = [(cls, item) for cls in _CLASSES for item in parameters(cls)]
_BOMB = 'a: &a [x, x]\n' + '\n'.join(
    f'{new}: &{new} [*{old}, *{old}, *{old}, *{old}, *{old}, *{old}]'
    for old, new in zip('abcdefgh', 'bcdefghi', strict=True))
_SCALARS = (
    '1', '-1.5', 'true', 'no', '~', '.nan', '.inf', '1e3', '2001-01-01', '1:30:00', '9' * 5000,
    '0x' + 'f' * 5000, '[]', '{}', '[a, [b]]', '{a: 1}', "''", '2001-99-99', '!!timestamp x',
    '!!python/object/apply:os.system [id]', '!!int ""', '!!bool x', '!!binary x', '!!set {a}',
    '*a', '&a 1', '<<: 1', '0001-01-01T00:00:00+23:59', '0b_', '=', '? [a]', '"\\x1b[2J"',
    '|\n   x', '[' * 500, '{a: ' * 300)


def _file(rng: Random) -> bytes:
    kind = rng.random()
    if kind < 0.03:
        return f'{_BOMB}\n/**:\n  ros__parameters:\n    x: *i\n'.encode()
    if kind < 0.06:
        return b'a: &a {b: 1}\n/**:\n  ros__parameters: &p\n    <<: *a\n    x: *p\n'
    lines = ['/**:', '  ros__parameters:']
    for _ in range(rng.randrange(1, 7)):
        _, item = rng.choice(_ITEMS)
        value = rng.choice(_SCALARS) if rng.random() < 0.4 else f'{number(rng):g}'
        name = item.name if rng.random() < 0.9 else repr(text(rng, 'a.b'))
        lines.append(f'    {name}: {value}')
    return '\n'.join(lines).encode()


def _load(data: bytes) -> None:
    path = _folder / 'parameters.yaml'
    path.write_bytes(data)
    values = load_yaml(path, 'localizer')
    refuse_unknown(values, _CLASSES, str(path))
    for cls in _CLASSES:
        dump_yaml(build(cls, values))


def _override(rng: Random) -> bytes:
    value = rng.choice((*_SCALARS, *TEXTS)) if rng.random() < 0.6 else f'{number(rng):g}'
    return bytes([rng.randrange(len(_ITEMS))]) + value.encode()


def _parse(data: bytes) -> None:
    """Take a value as a command line gives it, for the parameter that the first byte says."""
    cls, item = _ITEMS[(data or b'\0')[0] % len(_ITEMS)]
    written = data[1:].decode(errors='surrogateescape').replace('\0', '')
    build(cls, {item.name: item.parse(written)})


def _remap(data: bytes) -> None:
    Remapping(data.decode(errors='surrogateescape').split('\n'))


TARGETS = (
    Target('yaml', _load, _file, [value.encode() for value in _SCALARS], 0.4),
    Target('override', _parse, _override, (b'[', b']', b'{', b'\n', b': ', b'!!', b'&a'), 0.6),
    Target('remapping', _remap, lambda rng: f'beacons:={text(rng, "/uwb/scan")}'.encode(),
           (b':=', b'\n', b'/', b'~', b'__ns', b'('), 1),
)
with suppress(ConfigError):
    _parse(b'')

"""Traces of SUMO, ns-2 and BonnMotion, plain, compressed, and cut while compressed."""

from __future__ import annotations

import gzip
from random import Random

from harness import number, Scratch, Target, text
from tsmcl_ros.traces import follow, TraceConfig

_folder = Scratch()


def _read(data: bytes, elevation: bool = False) -> None:
    """Read a trace whose first byte says how."""
    path = _folder / 'trace'
    way, data = (data or b'\0')[0], data[1:]
    path.write_bytes(gzip.compress(data, 1) if way & 4 else data)
    if way & 56 == 56:
        path.write_bytes(path.read_bytes()[:-9])
    follow('trace', TraceConfig(
        trace=str(path), trace_start=1.0, trace_duration=float(way >> 6),
        trace_elevation=bool(way & 1), trace_local_origin=bool(way & 2)), 2)


def _way(rng: Random, written: str) -> bytes:
    return bytes([rng.randrange(256)]) + written.encode()


def _fcd(rng: Random) -> bytes:
    begin = text(rng, '<?xml version="1.0" encoding="UTF-8"?>')
    if rng.random() < 0.1:
        begin += ('<!DOCTYPE fcd-export [<!ENTITY a "aaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;">'
                  '<!ENTITY c SYSTEM "file:///etc/passwd">]>')
    if rng.random() < 0.05:
        begin = f'<?xml version="1.0" encoding="{rng.choice(("utf-7", "idna", "x", "utf-16"))}"?>'
    steps = []
    for time in range(rng.randrange(2, 5)):
        vehicles = ''.join(
            f'<vehicle id="{text(rng, name)}" x="{number(rng):g}" y="{number(rng):g}" '
            f'z="{number(rng):g}" angle="{number(rng):g}"/>' for name in 'abc')
        steps.append(f'<timestep time="{time if rng.random() < 0.95 else number(rng):g}">'
                     f'{vehicles}</timestep>')
    return _way(rng, f'{begin}<fcd-export>{"".join(steps)}</fcd-export>')


def _ns2(rng: Random) -> bytes:
    lines = [f'$node_({node}) set {axis}_ {number(rng):g}' for node in range(3) for axis in 'XYZ'
             if rng.random() < 0.97]
    for time in range(rng.randrange(6)):
        target = ' '.join(f'{number(rng):g}' for _ in range(rng.choice((2, 3))))
        lines.append(f'$ns_ at {time}.5 "$node_({rng.randrange(3)}) setdest {target} '
                     f'{abs(number(rng, 0, 30)):g}"{rng.choice(("", ";"))}')
    return _way(rng, '\n'.join(lines))


def _bonnmotion(rng: Random) -> bytes:
    width = rng.choice((2, 3))
    return _way(rng, '\n'.join(
        ' '.join(f'{time} ' + ' '.join(f'{number(rng):g}' for _ in range(width))
                 for time in range(rng.randrange(3, 7)))
        for _ in range(3)))


_XML = (b'<timestep time="5">', b'</timestep>', b'<vehicle id="a"/>', b'<', b'>', b'&amp;', b'&a;',
        b'&#0;', b'&#x10FFFF;', b'<![CDATA[', b'<!--', b'<?x?>', b'<!DOCTYPE a>', b'x="1"', b'"')
_TCL = (b'$node_(', b'$god_ ', b'$ns_ at 1 "', b'set X_ ', b'setdest ', b'"', b';', b'\n', b'#',
        b'9' * 5000, b'1e308', b'-1', b'nan')

TARGETS = (
    Target('fcd', _read, _fcd, _XML, 7),
    Target('ns2', _read, _ns2, _TCL, 5),
    Target('bonnmotion', _read, _bonnmotion, (b'\n', b' ', b'1e308', b'#', b'nan', b'\0'), 4),
)

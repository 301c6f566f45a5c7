"""Traces of others, whose vehicles ours can follow: SUMO's, ns-2's and BonnMotion's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from tsmcl_ros.config import Config, param
from tsmcl_ros.model.mobility import Replay, Trace
from tsmcl_ros.traces.bonnmotion import read_bonnmotion
from tsmcl_ros.traces.fcd import read_fcd
from tsmcl_ros.traces.files import Lines
from tsmcl_ros.traces.ns2 import read_ns2
from tsmcl_ros.types import ConfigError

# What a trace may be; `trace` is whichever of the others the file looks like.
READERS: dict[str, Callable[..., Trace]] = {
    'fcd': read_fcd, 'ns2': read_ns2, 'bonnmotion': read_bonnmotion,
}
KINDS = ('trace', *READERS)


@dataclass(frozen=True)
class TraceConfig(Config):
    """Parameters of the replay of a trace."""

    trace: str = param('', 'file that the vehicles follow, plain or gzip: fcd-export of SUMO, '
                       'movements of ns-2 or of BonnMotion')
    trace_start: float = param(40.0, 'time in the trace at which to begin', unit='s', low=0,
                               high=1e9)
    trace_duration: float = param(
        0.0, 'time that the vehicles must be there; 0 for as long as the longest-lived ones are',
        unit='s', low=0, high=1e9)
    trace_elevation: bool = param(False, 'use the height z of the vehicles: three dimensions')
    trace_local_origin: bool = param(
        False, 'move the origin to the corner of the ways, as UTM coordinates want it')


def follow(
    kind: str, config: TraceConfig, vehicles: int, rng: np.random.Generator | None = None,
) -> Replay:
    """
    Return a mobility that replays as many vehicles of a trace of a kind, one of `KINDS`.

    Nothing is drawn from `rng`: every mobility is made by these last three arguments.

    Raises
    ------
    ConfigError
        If no trace is named.
    LogError
        See the readers.

    """
    if not config.trace:
        raise ConfigError("trace: '' is not allowed, must be the path of a trace")
    trace = READERS[recognise(config.trace) if kind == 'trace' else kind](
        config.trace, vehicles, config.trace_start, config.trace_duration,
        elevation=config.trace_elevation, local_origin=config.trace_local_origin)
    return Replay(trace, config.trace_start)


FOLLOW: dict[str, Callable[..., Replay]] = {kind: partial(follow, kind) for kind in KINDS}


def recognise(path: str | Path) -> str:
    """
    Return the kind of a trace, one of `READERS`, by how its first line begins.

    Raises
    ------
    LogError
        If the file cannot be read.

    """
    first = next(iter(Lines(Path(path))), '')
    return {'<': 'fcd', '$': 'ns2'}.get(first[:1], 'bonnmotion')

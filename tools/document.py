"""
Write docs/parameters.md from the config dataclasses, where parameters are defined.

    python tools/document.py
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import inspect
from pathlib import Path
import re
from typing import Any, NamedTuple

from tsmcl_ros.config import Config, Parameter, parameters
from tsmcl_ros.inputs import InputConfig
from tsmcl_ros.localizer import CONFIGS
from tsmcl_ros.methods import METHODS
from tsmcl_ros.nodes.anchor import Anchor
from tsmcl_ros.nodes.fleet import Fleet
from tsmcl_ros.nodes.localizer import LocalizerNode
from tsmcl_ros.nodes.recorder import Recorder
from tsmcl_ros.nodes.replay import Replay
from tsmcl_ros.nodes.simulator import Simulator
from tsmcl_ros.world import MOBILITY, MobilityConfig

PARAMETERS = Path(__file__).resolve().parent.parent / 'docs' / 'parameters.md'


class Executable(NamedTuple):
    """What takes parameters, and which of them can change while it runs; None if it takes none."""

    name: str
    configs: tuple[type[Config], ...]
    adjustable: tuple[str, ...] | None


EXECUTABLES = (
    *(Executable(node.default_name, node.configs, node.adjustable)
      for node in (LocalizerNode, Fleet, Anchor, Simulator, Recorder, Replay)),
    Executable('localize_bag', (InputConfig, *CONFIGS), None),
)
METHOD_CONFIGS = {name: method.Config for name, method in METHODS.items()}
MOBILITY_CONFIGS = {name: config for name, (config, _) in MOBILITY.items()}

INTRODUCTION = """\
# Parameters

Written from the sources by `python tools/document.py`; a test holds that it is up to date.

A node takes its parameters by `--ros-args -p NAME:=VALUE` or `--params-file FILE`, `localize_bag`
as options (`--max-particles 500`) or by `--params FILE`, `demo` by `--config FILE`, which has a
section for each of `anchor`, `simulator` and `fleet`. [config/](../config) holds examples. An
unknown name or a value that is not allowed ends the program with one line that says what is
allowed; nothing is clamped.

The column *live* says which can change while the node runs (`ros2 param set`). `localizer` and
`fleet` are lifecycle nodes: their other parameters can change while they are unconfigured, and
hold from the next `configure` on. Every node has ROS's own `use_sim_time` too.
"""


def document() -> str:
    """Return the text of docs/parameters.md."""
    takers: dict[type[Config], list[Executable]] = {}
    for executable in EXECUTABLES:
        for config in executable.configs:
            takers.setdefault(config, []).append(executable)
    sections = [INTRODUCTION, _contents()]
    for config, nodes in takers.items():
        if config not in METHOD_CONFIGS.values():
            sections.append(_section(config, nodes, takers))
        elif config is METHOD_CONFIGS['ts_mcl']:
            sections.append(_variants(
                'Methods', 'What the methods take, see [their pages](methods/README.md).',
                'method', METHOD_CONFIGS, nodes))
    return '\n'.join(sections)


def _contents() -> str:
    """Return which executable takes which groups."""
    return _table(['executable', 'takes'], [
        [f'`{executable.name}`', _links(dict.fromkeys(map(_title, executable.configs)))]
        for executable in EXECUTABLES])


def _links(titles: Mapping[str, Any]) -> str:
    return ', '.join(f'[{title.lower()}](#{title.lower().replace(" ", "-")})' for title in titles)


def _title(config: type[Config]) -> str:
    if config in METHOD_CONFIGS.values():
        return 'Methods'
    words = re.findall('[A-Z][a-z]*', config.__name__.removesuffix('Config'))
    return ' '.join(words).capitalize()


def _section(
    config: type[Config], nodes: Sequence[Executable], takers: Mapping[type[Config], Any],
) -> str:
    """Return a config's parameters; of those that it has from another one, which are changed."""
    about = (inspect.getdoc(config) or '').partition('\n')[0]
    if config is MobilityConfig:
        return _variants(_title(config), about, 'mobility', MOBILITY_CONFIGS, nodes)
    inherited: tuple[Parameter, ...] = ()
    for base in config.__mro__[1:]:
        if base in takers:
            inherited = parameters(base)
            about += f' As {_links({_title(base): None})}, but for'
            break
    rows = [[*_cells(item), _live(item, nodes), _escaped(item.doc)]
            for item in parameters(config) if item not in inherited]
    return _headed(_title(config), f'{about}{":" if inherited else ""}', nodes, _table(
        ['parameter', 'type', 'unit', 'default', 'allowed', 'live', 'what'], rows))


def _variants(
    title: str, about: str, what: str, configs: Mapping[str, type[Config]],
    nodes: Sequence[Executable],
) -> str:
    """Return the parameters of alternatives, and which of these have each."""
    having: dict[Parameter, list[str]] = {}
    for name, config in configs.items():
        for item in parameters(config):
            having.setdefault(item, []).append(name)
    rows = [[*_cells(item), _live(item, nodes),
             ', '.join(names), _escaped(item.doc)] for item, names in having.items()]
    return _headed(title, about, nodes, _table(
        ['parameter', 'type', 'unit', 'default', 'allowed', 'live', what, 'what'], rows))


def _headed(title: str, about: str, nodes: Sequence[Executable], table: str) -> str:
    names = ', '.join(f'`{node.name}`' for node in nodes)
    return f'## {title}\n\n{about} Taken by {names}.\n\n{table}' if not about.endswith(':') else \
        f'## {title}\n\nTaken by {names}. {about}\n\n{table}'


def _cells(item: Parameter) -> list[str]:
    """Return name, type, unit, default and what is allowed."""
    default = f'[{", ".join(item.default)}]' if item.type is tuple else f'{item.default}'
    default = default.lower() if item.type is bool else default
    kind = {float: 'double', int: 'integer', bool: 'bool', str: 'string', tuple: 'string array'}
    return [f'`{item.name}`', kind[item.type], item.unit, f'`{default or chr(39) * 2}`',
            item.bounds.removeprefix('one of ')]


def _live(item: Parameter, nodes: Sequence[Executable]) -> str:
    """Return in which nodes, if not in all that have it, it can change while they run."""
    live = {node.name: item.name in node.adjustable for node in nodes
            if node.adjustable is not None}
    return 'yes' if live and all(live.values()) else ', '.join(
        f'`{name}`' for name, can in live.items() if can)


def _escaped(text: str) -> str:
    return text.replace('|', r'\|').replace('*', r'\*')


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return '\n'.join(
        f'| {" | ".join(row)} |' for row in (head, ['---'] * len(head), *rows)) + '\n'


if __name__ == '__main__':
    PARAMETERS.write_text(document(), encoding='utf-8')

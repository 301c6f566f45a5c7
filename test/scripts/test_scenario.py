"""Scenario files: which there are, and that their nodes would take them."""

from __future__ import annotations

from pathlib import Path

import pytest
from tsmcl_ros.config import build, load_yaml, refuse_unknown
from tsmcl_ros.nodes.anchor import Anchor
from tsmcl_ros.nodes.fleet import Fleet
from tsmcl_ros.nodes.simulator import Simulator
from tsmcl_ros.scripts.demo import _read
from tsmcl_ros.scripts.scenario import LOCALIZER, RANGE_FREE, read_scenario
from tsmcl_ros.types import ConfigError

CONFIG = Path(__file__).parents[2] / 'config'
SCENARIOS = [path for path in sorted(CONFIG.glob('*.yaml')) if '\nsimulator:' in path.read_text()]


@pytest.mark.parametrize('path', SCENARIOS, ids=lambda path: path.stem)
@pytest.mark.parametrize('node', [Anchor, Simulator, Fleet])
def test_every_scenario_holds_parameters_that_its_nodes_take(path: Path, node: type) -> None:
    values = load_yaml(path, node.default_name)
    refuse_unknown(values, node.configs, path.name)
    for config in node.configs:
        build(config, values)


def test_the_cooperative_scenarios_have_132_vehicles_among_18_anchors_and_5() -> None:
    for name, anchors in (('cooperative', 18), ('cooperative_sparse', 5)):
        scenario = read_scenario(CONFIG / f'{name}.yaml')
        assert len(scenario.anchor['anchor_positions']) == anchors
        assert scenario.simulator['vehicles'] == 132
        assert scenario.simulator['cooperation'] is True
        assert scenario.others == {'anchors alone': {'use_vehicles': False}}


def test_options_win_over_the_scenario_and_it_over_their_defaults() -> None:
    path = str(CONFIG / 'cooperative.yaml')
    options, _ = _read(['--config', path, '--vehicles', '7'])
    assert (options.vehicles, options.duration, options.method) == (7, 30.0, 'ts_mcl')
    assert _read([])[1] is RANGE_FREE


def test_other_localizers_get_what_all_localizers_know() -> None:
    scenario = RANGE_FREE._replace(fleet={**LOCALIZER, 'cloud_period': 1.0})
    assert scenario.localizer == LOCALIZER


def test_what_is_said_for_all_nodes_goes_to_those_that_have_it(tmp_path: Path) -> None:
    path = tmp_path / 'scenario.yaml'
    path.write_text('/**:\n  ros__parameters:\n    anchor_rows: 2\n    odom_std: 9.0\n'
                    'simulator:\n  ros__parameters:\n    area_x: 8.0\n')
    scenario = read_scenario(path)
    assert scenario.anchor == {'anchor_rows': 2}
    assert scenario.simulator == {'anchor_rows': 2, 'area_x': 8.0}
    assert scenario.fleet == {'odom_std': 9.0}
    assert list(scenario.others) == ['mcl']


@pytest.mark.parametrize(('text', 'complaint'), [
    ('simulator:\n  ros__parameters:\n    vehicles: 3\n', 'holds no parameters'),
    ('/**:\n  ros__parameters:\n    vehicels: 3\n', "unknown parameter 'vehicels'")])
def test_a_file_that_is_no_scenario_is_refused(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / 'scenario.yaml'
    path.write_text(text)
    with pytest.raises(ConfigError, match=complaint):
        read_scenario(path)


def test_the_fleet_runs_with_the_parameters_of_the_range_free_file() -> None:
    assert load_yaml(CONFIG / 'range_free.yaml', 'fleet') == LOCALIZER | {'method': 'ts_mcl'}

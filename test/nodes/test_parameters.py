from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from rclpy.parameter import Parameter
from tsmcl_ros import messages
from tsmcl_ros.bag import Writer
from tsmcl_ros.config import Config, param, parameters
from tsmcl_ros.nodes.anchor import Anchor
from tsmcl_ros.nodes.fleet import Fleet
from tsmcl_ros.nodes.localizer import LocalizerNode
from tsmcl_ros.nodes.recorder import Recorder
from tsmcl_ros.nodes.replay import Replay
from tsmcl_ros.nodes.runtime import Node
from tsmcl_ros.nodes.simulator import Simulator
from tsmcl_ros.types import ConfigError

Ros = Callable[..., None]


@dataclass(frozen=True)
class CarConfig(Config):
    """Parameters of a test."""

    speed: float = param(1.0, 'how fast', unit='m/s', low=0, high=5)
    wheels: int = param(4, 'how many', low=1)
    colour: str = param('red', 'of the roof', choices=('red', 'blue'))
    passengers: tuple[str, ...] = param((), 'who is in')
    seats: tuple[str, ...] = param(('1',), 'which are taken', ids=True)

    def check(self) -> None:
        if self.wheels == 1 and self.speed > 1:
            raise ConfigError(f'speed: {self.speed:g} m/s is too fast for one wheel')


class Car(Node):
    default_name = 'car'
    configs = (CarConfig,)
    adjustable = ('speed', 'colour')


@contextmanager
def car() -> Iterator[Car]:
    node = Car()
    yield node
    node.close()


def test_without_overrides_the_defaults_of_the_config_hold(ros: Ros) -> None:
    ros()
    with car() as node:
        assert node.settings == {'speed': 1.0, 'wheels': 4, 'colour': 'red', 'passengers': (),
                                 'seats': ('1',)}


def test_overrides_from_the_command_line_hold_and_whole_numbers_serve_as_numbers(
    ros: Ros,
) -> None:
    ros('-p', 'speed:=3', '-p', 'passengers:=[ann, bob]', '-p', 'colour:=blue')
    with car() as node:
        assert node.settings['speed'] == 3.0
        assert node.settings['passengers'] == ('ann', 'bob')
        assert node.get_parameter('colour').value == 'blue'


@pytest.mark.parametrize(
    ('given', 'meant'), [('[]', ()), ('ann', ('ann',)), ('ann,bob', ('ann', 'bob'))],
)
def test_a_list_of_texts_may_be_empty_or_written_without_brackets(
    ros: Ros, given: str, meant: tuple[str, ...],
) -> None:
    ros('-p', f'passengers:={given}')
    with car() as node:
        assert node.settings['passengers'] == meant


@pytest.mark.parametrize(
    ('given', 'meant'), [('7', ('7',)), ('[2, 3]', ('2', '3')), ('2,b', ('2', 'b'))],
)
def test_a_list_of_ids_may_be_written_as_numbers(
    ros: Ros, given: str, meant: tuple[str, ...],
) -> None:
    ros('-p', f'seats:={given}')
    with car() as node:
        assert node.settings['seats'] == meant


def test_parameter_files_are_read(ros: Ros, tmp_path) -> None:
    path = tmp_path / 'car.yaml'
    path.write_text('car:\n  ros__parameters:\n    speed: 2.5\n')
    ros('--params-file', str(path))
    with car() as node:
        assert node.settings['speed'] == 2.5


@pytest.mark.parametrize(('override', 'complaint'), [
    ('speed:=9.0', 'speed: 9.0 is not allowed, must be a number at least 0 m/s and at most 5 m/s'),
    ('speed:=fast', "speed: 'fast' is not allowed"),
    ('colour:=green', "colour: 'green' is not allowed, must be one of red, blue"),
    ('passengers:=[1, 2]', 'passengers: (1, 2) is not allowed, must be a list of texts'),
    ('passengers:=1', 'passengers: 1 is not allowed, must be a list of texts'),
    ('passengers:=true', 'passengers: True is not allowed, must be a list of texts'),
    ('seats:=[1.5]', 'seats: (1.5,) is not allowed, must be a list of texts'),
    ('sped:=1.0', "--ros-args: unknown parameter 'sped', did you mean speed?"),
])
def test_an_override_that_is_not_allowed_is_refused_with_what_is(
    ros: Ros, override: str, complaint: str,
) -> None:
    ros('-p', override)
    with pytest.raises(ConfigError) as caught:
        Car()
    assert complaint in str(caught.value)


def test_a_combination_that_is_not_allowed_is_refused_at_start(ros: Ros) -> None:
    ros('-p', 'wheels:=1', '-p', 'speed:=2.0')
    with pytest.raises(ConfigError, match='too fast for one wheel'):
        Car()


def test_a_parameter_set_while_running_reaches_the_settings(ros: Ros) -> None:
    ros()
    with car() as node:
        [result] = node.set_parameters([Parameter('speed', value=4.0)])
        assert result.successful
        assert node.settings['speed'] == 4.0


@pytest.mark.parametrize(('name', 'value', 'reason'), [
    ('colour', 'green', 'must be one of red, blue'),
    ('speed', 6.0, 'out of range'),
    ('wheels', 3, 'read-only'),
    ('use_sim_time', True, 'use_sim_time cannot change while the node runs'),
])
def test_a_value_that_is_not_allowed_is_refused_with_a_reason_and_changes_nothing(
    ros: Ros, name: str, value: object, reason: str,
) -> None:
    ros()
    with car() as node:
        before = dict(node.settings)
        [result] = node.set_parameters([Parameter(name, value=value)])
        assert not result.successful
        assert reason in result.reason
        assert node.settings == before


def test_a_combination_that_is_not_allowed_is_refused_while_running(ros: Ros) -> None:
    ros('-p', 'wheels:=1')
    with car() as node:
        [result] = node.set_parameters([Parameter('speed', value=2.0)])
        assert not result.successful
        assert 'too fast for one wheel' in result.reason


def test_descriptors_tell_what_a_parameter_means_and_allows(ros: Ros) -> None:
    ros()
    with car() as node:
        speed = node.describe_parameter('speed')
        assert speed.description == 'how fast [m/s]'
        assert speed.floating_point_range[0].from_value == 0.0
        assert speed.floating_point_range[0].to_value == 5.0
        assert node.describe_parameter('wheels').read_only
        colour = node.describe_parameter('colour')
        assert colour.additional_constraints == 'one of red, blue'
        wheels = node.describe_parameter('wheels').additional_constraints
        assert wheels == 'a whole number at least 1; not while running'


@pytest.mark.parametrize('kind', [Anchor, Simulator, LocalizerNode, Fleet, Recorder, Replay])
def test_every_parameter_is_described_and_ranged_where_its_config_has_bounds(
    ros: Ros, tmp_path: Path, kind: type[Node],
) -> None:
    with Writer(tmp_path / 'bag') as bag:
        bag.topic('/talk', messages.CLOCK)
        bag.write('/talk', 1.0, messages.encode_clock(1.0))
    ros(*{Recorder: ['-p', f'output:={tmp_path / "out"}'],
          Replay: ['-p', f'bag:={tmp_path / "bag"}']}.get(kind, []))
    with closing(kind()) as node:
        for config in kind.configs:
            for item in parameters(config):
                told = node.describe_parameter(item.name)
                assert told.description.startswith(item.doc)
                assert item.allowed in told.additional_constraints
                assert node.get_parameter(item.name).get_parameter_value().type == told.type != 0
                bounds = [*told.floating_point_range, *told.integer_range]
                low = item.low if item.low is not None else item.above
                assert len(bounds) == (low is not None or item.high is not None)
                assert low is None or bounds[0].from_value == low
                assert item.high is None or bounds[0].to_value == item.high

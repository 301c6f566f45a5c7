"""Configs: what they accept and refuse, and that nothing is lost on the way through YAML."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

from hypothesis import given, settings, strategies
import pytest
from tsmcl_ros.config import (
    add_arguments,
    adjust,
    build,
    Config,
    dump_yaml,
    given_arguments,
    load_yaml,
    param,
    Parameter,
    parameters,
    refuse_unknown,
)
from tsmcl_ros.types import ConfigError


@dataclass(frozen=True)
class EngineConfig(Config):
    """A config with a field of each kind."""

    power: float = param(5.0, 'how strong', unit='kW', above=0.0, high=100.0)
    cylinders: int = param(4, 'how many', low=1)
    turbo: bool = param(False, 'whether it has one')
    fuel: str = param('petrol', 'what it burns', choices=('petrol', 'diesel'))
    label: str = param('', 'what it is called')
    parts: tuple[str, ...] = param((), 'what it is made of')
    start_x: float = param(0.0, 'where it stands', unit='m', name='start.x')

    def check(self) -> None:
        """Refuse diesel with a turbo."""
        if self.turbo and self.fuel == 'diesel':
            raise ConfigError('turbo: not with fuel diesel')


@dataclass(frozen=True)
class WheelConfig(Config):
    """Another one."""

    radius: float = param(0.3, '100 % round', unit='m', above=0.0)


def parameter(name: str) -> Parameter:
    return next(item for item in parameters(EngineConfig) if item.name == name)


def parse(*words: str) -> dict[str, Any]:
    parser = argparse.ArgumentParser()
    add_arguments(parser, EngineConfig, WheelConfig)
    return given_arguments(parser.parse_args(words), EngineConfig, WheelConfig)


# Validation


@dataclass(frozen=True)
class MeterConfig(Config):
    pace: float = param(1.0, 'how fast', low=0.0, live=True)
    units: str = param('km', 'of what')


@dataclass(frozen=True)
class TripConfig(Config):
    pace: float = param(1.0, 'how fast', low=0.0, live=True)

    def check(self) -> None:
        if self.pace > 3:
            raise ConfigError('pace: too fast for a trip')


def test_that_defaults_are_accepted() -> None:
    assert EngineConfig().power == 5.0


def test_that_a_whole_number_is_taken_for_a_number() -> None:
    power = EngineConfig(power=7).power
    assert power == 7.0
    assert type(power) is float


def test_that_a_list_of_texts_becomes_a_tuple() -> None:
    assert EngineConfig(parts=['a', 'b']).parts == ('a', 'b')  # type: ignore[arg-type]


@pytest.mark.parametrize(('name', 'value', 'allowed'), [
    ('power', 0.0, 'a number above 0 kW and at most 100 kW'),
    ('power', 100.5, 'a number above 0 kW and at most 100 kW'),
    ('power', math.nan, 'a number above 0 kW and at most 100 kW'),
    ('power', '7', 'a number above 0 kW and at most 100 kW'),
    ('power', True, 'a number above 0 kW and at most 100 kW'),
    ('start_x', math.inf, 'a number'),
    ('start_x', 10**400, 'a number'),
    ('cylinders', 0, 'a whole number at least 1'),
    ('cylinders', 4.0, 'a whole number at least 1'),
    ('cylinders', True, 'a whole number at least 1'),
    ('turbo', 1, 'true or false'),
    ('fuel', 'water', 'one of petrol, diesel'),
    ('label', 3, 'a text'),
    ('parts', 'ab', 'a list of texts'),
    ('parts', ('a', 1), 'a list of texts'),
])
def test_that_a_value_outside_is_refused_by_name_and_value(
    name: str, value: Any, allowed: str,
) -> None:
    with pytest.raises(ConfigError) as error:
        EngineConfig(**{name: value})
    shown = {'start_x': 'start.x'}.get(name, name)
    assert str(error.value) == f'{shown}: {value!r} is not allowed, must be {allowed}'


def test_that_combinations_are_checked() -> None:
    with pytest.raises(ConfigError, match='not with fuel diesel'):
        EngineConfig(turbo=True, fuel='diesel')


def test_that_a_field_not_made_by_param_is_a_mistake_of_the_programmer() -> None:
    @dataclass(frozen=True)
    class Bare(Config):
        power: float = 5.0

    with pytest.raises(TypeError, match=r'Bare\.power is not made by param'):
        parameters(Bare)


def test_that_whole_numbers_have_no_largest() -> None:
    assert EngineConfig(cylinders=10**400).cylinders == 10**400


# Names


def test_that_build_takes_what_it_has_fields_for() -> None:
    config = build(EngineConfig, {'power': 7, 'start.x': 1.5, 'radius': 2.0})
    assert (config.power, config.start_x) == (7.0, 1.5)


def test_that_live_parameters_change_for_all_who_share_the_config() -> None:
    meter, trip = MeterConfig(), TripConfig()
    adjust([meter, trip], {'pace': 2, 'units': 'km', 'unknown': 1})
    assert (meter.pace, meter.units, trip.pace) == (2.0, 'km', 2.0)


@pytest.mark.parametrize(('values', 'complaint'), [
    ({'pace': -1.0}, 'pace: -1.0 is not allowed'),
    ({'pace': 2.0, 'units': 'miles'}, "units cannot change from 'km' to 'miles'"),
    ({'pace': 4.0}, 'pace: too fast for a trip'),
])
def test_that_of_changes_that_are_not_allowed_none_is_made(
    values: dict[str, Any], complaint: str,
) -> None:
    meter, trip = MeterConfig(), TripConfig()
    with pytest.raises(ConfigError, match=complaint):
        adjust([meter, trip], values)
    assert (meter, trip) == (MeterConfig(), TripConfig())


def test_that_known_names_pass() -> None:
    refuse_unknown(['power', 'start.x', 'radius'], [EngineConfig, WheelConfig], 'here')


def test_that_an_unknown_name_is_refused_with_the_nearest_known_ones() -> None:
    with pytest.raises(ConfigError, match=r"^here: unknown parameter 'powr', did you mean power"):
        refuse_unknown(['powr'], [EngineConfig, WheelConfig], 'here')


def test_that_an_unknown_name_like_no_other_is_refused_with_all_known_ones() -> None:
    known = 'cylinders, fuel, label, parts, power, radius, start.x, turbo'
    with pytest.raises(ConfigError, match=f"^here: unknown parameter 'qqq', known are {known}$"):
        refuse_unknown(['qqq'], [EngineConfig, WheelConfig], 'here')


# The command line


def test_that_only_given_options_appear() -> None:
    assert parse() == {}
    assert parse('--power', '7', '--radius', '1') == {'power': 7.0, 'radius': 1.0}


@pytest.mark.parametrize(('name', 'text', 'value'), [
    ('power', '1e1', 10.0),
    ('power', '1e-5', 1e-5),
    ('cylinders', '8', 8),
    ('turbo', 'true', True),
    ('turbo', 'false', False),
    ('fuel', 'diesel', 'diesel'),
    ('label', '12', '12'),
    ('label', 'true', 'true'),
    ('parts', 'a,b', ('a', 'b')),
    ('parts', '', ()),
    ('start.x', '-3', -3.0),
])
def test_that_options_are_read_as_their_parameter_s_type(name: str, text: str, value: Any) -> None:
    read = parse(f'--{name}={text}')
    assert read == {name: value}
    assert type(read[name]) is type(value)


@pytest.mark.parametrize(('name', 'text'), [
    ('power', 'strong'), ('power', ''), ('power', '[1'), ('power', '2026-01-01'),
    ('power', 'nan'), ('power', 'inf'), ('power', '1' + '0' * 400),
    ('cylinders', '4.5'), ('cylinders', 'four'), ('turbo', '2'), ('fuel', 'water'),
])
def test_that_a_bad_option_is_refused_by_name(name: str, text: str) -> None:
    with pytest.raises(ConfigError, match=rf'^{name}: .* is not allowed, must be '):
        parse(f'--{name}={text}')


def test_that_help_tells_doc_unit_range_and_default() -> None:
    parser = argparse.ArgumentParser()
    add_arguments(parser, EngineConfig, WheelConfig)
    text = ' '.join(parser.format_help().split())
    assert 'how strong [kW]; a number above 0 kW and at most 100 kW (default: 5.0)' in text
    assert '100 % round' in text


# YAML


def write(folder: Path, text: str) -> Path:
    path = folder / 'parameters.yaml'
    path.write_text(text, encoding='utf-8')
    return path


@settings(max_examples=30)
@given(
    power=strategies.floats(0.0, 100.0, exclude_min=True),
    cylinders=strategies.integers(1, 10**12),
    turbo=strategies.booleans(),
    label=strategies.text(),
    parts=strategies.lists(strategies.text(), max_size=40),
    start_x=strategies.floats(allow_nan=False, allow_infinity=False),
)
def test_that_what_is_dumped_is_loaded_unchanged(
    tmp_path_factory: pytest.TempPathFactory, **values: Any,
) -> None:
    config = EngineConfig(**values)
    path = write(tmp_path_factory.getbasetemp(), dump_yaml(config, WheelConfig(radius=2.0)))
    loaded = load_yaml(path)
    refuse_unknown(loaded, [EngineConfig, WheelConfig], str(path))
    assert build(EngineConfig, loaded) == config
    assert build(WheelConfig, loaded).radius == 2.0


def test_that_the_dump_is_commented_from_the_fields() -> None:
    assert '    power: 5.0  # how strong [kW]; a number above 0 kW' in dump_yaml(EngineConfig())


def test_that_the_dump_needs_no_comments() -> None:
    assert '    power: 5.0\n' in dump_yaml(EngineConfig(), commented=False)


def test_that_a_parameter_of_two_configs_is_dumped_once() -> None:
    assert dump_yaml(EngineConfig(), EngineConfig()) == dump_yaml(EngineConfig())


def test_that_a_node_s_own_section_wins_over_the_common_one(tmp_path: Path) -> None:
    path = write(tmp_path, '\n'.join((
        '/**: {ros__parameters: {power: 1.0, cylinders: 2}}',
        'engine: {ros__parameters: {power: 3.0}}',
        'other: {ros__parameters: {power: 4.0}}',
    )))
    assert load_yaml(path, 'engine') == {'power': 3.0, 'cylinders': 2}
    assert load_yaml(path) == {'power': 1.0, 'cylinders': 2}


def test_that_nested_keys_are_joined_by_dots(tmp_path: Path) -> None:
    path = write(tmp_path, '/**: {ros__parameters: {start: {x: 1.0}}}')
    assert load_yaml(path) == {'start.x': 1.0}


def test_that_a_missing_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / 'absent.yaml'
    with pytest.raises(ConfigError) as error:
        load_yaml(path)
    assert str(error.value) == f'{path}: cannot read the parameter file: No such file or directory'


@pytest.mark.parametrize('text', [
    'power: [1', 'power: !!python/object:os.system x', 'power: 2026-13-45', '[' * 500, '\0',
])
def test_that_a_file_that_is_no_yaml_is_named(tmp_path: Path, text: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as error:
        load_yaml(path)
    assert str(error.value).startswith(f'{path}: is not a YAML file: ')
    assert '\n' not in str(error.value)


def test_that_a_file_in_another_encoding_is_named(tmp_path: Path) -> None:
    path = tmp_path / 'latin.yaml'
    path.write_bytes('label: Stra\xdfe'.encode('latin-1'))
    with pytest.raises(ConfigError, match='is not a YAML file'):
        load_yaml(path)


@pytest.mark.parametrize('text', [
    '', 'power: 1.0', '- power', '/**: {power: 1.0}', '/**: {ros__parameters: 3}',
    'other: {ros__parameters: {power: 1.0}}',
])
def test_that_a_file_without_parameters_says_what_was_expected(tmp_path: Path, text: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as error:
        load_yaml(path, 'engine')
    assert str(error.value).startswith(f'{path}: holds no parameters, expected "/**:"')


BOMB = '\n'.join(['a: &a {x: 1}', *(
    f'{new}: &{new} {{p: *{old}, q: *{old}, r: *{old}, s: *{old}}}'
    for old, new in zip('abcdefghijklmno', 'bcdefghijklmnop', strict=True))])


@pytest.mark.parametrize(('text', 'error'), [
    (f'{BOMB}\n/**: {{ros__parameters: *p}}', r'the alias \*a is not allowed, parameters have no'),
    ('/**: {ros__parameters: &a {<<: *a, x: *a}}', r'the alias \*a is not allowed'),
    ('/**: !!python/object/apply:os.system [id]',
     'the tag tag:yaml.org,2002:python/object/apply:os.system is not allowed, must be !!str'),
    ('/**: !!timestamp x', 'timestamp is not allowed, must be !!str or none'),
    ('/**: 2001-99-99', 'is not a YAML file: month must be in 1..12'),
    ('/**: ' + '[' * 5000, 'is not a YAML file: more than 20 levels are not allowed'),
    ('/**: ' + 'x' * 2**18, 'is larger than a parameter file may be, 262144 bytes'),
])
def test_a_parameter_file_that_grows_or_computes_is_refused(
        tmp_path: Path, text: str, error: str) -> None:
    path = tmp_path / 'hostile.yaml'
    path.write_text(text)
    with pytest.raises(ConfigError, match=error):
        load_yaml(path)


def test_a_text_of_digits_may_be_told_to_be_one(tmp_path: Path) -> None:
    path = tmp_path / 'parameters.yaml'
    path.write_text('/**: {ros__parameters: {name: !!str 7}}')
    assert load_yaml(path) == {'name': '7'}


@pytest.mark.parametrize('text', ['!!bool x', '*a', '0001-01-01T00:00:00+23:59', '9' * 5000])
def test_a_value_that_yaml_stumbles_over_is_refused(text: str) -> None:
    power = next(item for item in parameters(EngineConfig) if item.name == 'power')
    with pytest.raises(ConfigError, match='power: .* is not allowed, must be a number above 0'):
        power.parse(text)


def test_a_number_that_python_does_not_write_is_refused() -> None:
    power = next(item for item in parameters(EngineConfig) if item.name == 'power')
    with pytest.raises(ConfigError, match='power: a number of thousands of digits is not allowed'):
        power.parse('0x' + 'f' * 5000)


def test_a_whole_number_of_thousands_of_digits_is_refused() -> None:
    error = 'cylinders: a number of thousands of digits is not allowed, must be a whole number'
    with pytest.raises(ConfigError, match=error):
        EngineConfig(cylinders=2**20_000)

"""ROS parameters, declared from the config dataclasses: nothing is said twice."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
import sys
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from tsmcl_ros.config import build, Config, Parameter, parameters, refuse_unknown
from tsmcl_ros.types import ConfigError

_INTEGER_LIMIT = 2**63 - 1
# Parameters that rclpy looks after itself.
_OF_ROS = ('use_sim_time', 'start_type_description_service', 'qos_overrides.')


def declare(
    node: Node, overrides: Mapping[str, RosParameter], configs: Sequence[type[Config]],
    adjustable: Sequence[str] = (), fixed: Callable[[], str] | None = None,
    changed: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """
    Declare the parameters of some configs on a node, and return their values.

    The returned dict is kept up to date when an adjustable parameter is set, after the configs
    have accepted the new value.

    Parameters
    ----------
    node
        The node.
    overrides
        What `-p` and `--params-file` gave the node, by name.
    configs
        Where the parameters come from.
    adjustable
        Names of those that can be set at any time.
    fixed
        Returns why the others cannot be set at present, '' if they can. Without it they never
        can, and ROS knows them as read-only.
    changed
        Called after some were set, when the returned dict is up to date.

    Returns
    -------
    dict of str to Any
        Value by parameter name, as `tsmcl_ros.config.build` takes them.

    Raises
    ------
    ConfigError
        If an override has no parameter, or its value is not allowed.

    """
    refuse_unknown(
        (name for name in overrides if not name.startswith(_OF_ROS)), configs, '--ros-args',
    )
    known = {item.name: item for config in configs for item in parameters(config)}
    values = {
        name: _convert(item, overrides[name].value) if name in overrides else item.default
        for name, item in known.items()
    }
    _check(configs, values)
    for name, item in known.items():
        descriptor = _descriptor(item, name in adjustable, read_only=fixed is None)
        if values[name] == ():
            _declare_empty(node, name, descriptor)
        else:
            value = list(values[name]) if item.type is tuple else values[name]
            node.declare_parameter(name, value, descriptor, ignore_override=True)

    reason = fixed or str

    def refuse(changes: list[RosParameter]) -> SetParametersResult:
        if any(change.name == 'use_sim_time' for change in changes):
            return SetParametersResult(
                successful=False, reason='use_sim_time cannot change while the node runs')
        try:
            wanted = _converted(changes, known)
            _check(configs, values | wanted)
            for name, value in wanted.items():
                if name not in adjustable and value != values[name] and (why := reason()):
                    raise ConfigError(f'{name} cannot change {why}')
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(refuse)

    def take(changes: list[RosParameter]) -> None:
        values.update(_converted(changes, known))
        changed()

    node.add_post_set_parameters_callback(take)
    return values


def live(configs: Sequence[type[Config]]) -> tuple[str, ...]:
    """Return the names of the configs' live parameters."""
    return tuple(item.name for config in configs for item in parameters(config) if item.live)


def select(values: Mapping[str, Any], configs: Sequence[type[Config]]) -> dict[str, Any]:
    """Return those of the values that some configs have parameters for."""
    return {
        item.name: values[item.name] for config in configs for item in parameters(config)
    }


def _converted(
    changes: Sequence[RosParameter], known: Mapping[str, Parameter],
) -> dict[str, Any]:
    return {
        change.name: _convert(known[change.name], change.value)
        for change in changes if change.name in known
    }


def _convert(item: Parameter, value: Any) -> Any:
    """Return what a ROS parameter's value means to a config."""
    if item.type is tuple:
        if value is None:  # as ROS reads an empty list, whose type it cannot tell
            return ()
        if isinstance(value, str):
            return item.parse(value)
        if type(value) is int and item.ids:
            return item.convert([value])
        # Numbers come in arrays of Python's.
        return item.convert(list(value) if isinstance(value, array) else value)
    return item.convert(value)


def _declare_empty(node: Node, name: str, descriptor: ParameterDescriptor) -> None:
    """Declare an empty list of texts, which rclpy would take for one of bytes."""
    # It has to have a value: who asks for all parameters gets none if one has not.
    kind = RosParameter.Type.STRING_ARRAY
    node.declare_parameter(name, kind, ignore_override=True)
    node.set_parameters([RosParameter(name, kind, [])])
    descriptor.type = kind.value
    node.set_descriptor(name, descriptor)


def _check(configs: Sequence[type[Config]], values: Mapping[str, Any]) -> None:
    for config in configs:
        build(config, values)


def _descriptor(item: Parameter, adjustable: bool, read_only: bool) -> ParameterDescriptor:
    unit = f' [{item.unit}]' if item.unit else ''
    descriptor = ParameterDescriptor(
        description=f'{item.doc}{unit}',
        additional_constraints=item.allowed + ('' if adjustable else '; not while running'),
        read_only=read_only and not adjustable,
    )
    # ROS knows inclusive bounds only; the config refuses the rest.
    low = item.low if item.low is not None else item.above
    if low is None and item.high is None:
        return descriptor
    if item.type is float:
        descriptor.floating_point_range = [FloatingPointRange(
            from_value=-sys.float_info.max if low is None else float(low),
            to_value=sys.float_info.max if item.high is None else float(item.high),
        )]
    elif item.type is int:
        descriptor.integer_range = [IntegerRange(
            from_value=-_INTEGER_LIMIT if low is None else int(low),
            to_value=_INTEGER_LIMIT if item.high is None else int(item.high),
        )]
    return descriptor

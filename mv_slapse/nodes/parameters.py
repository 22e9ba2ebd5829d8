"""ROS parameters from settings dataclasses: the dataclass is the only list of them."""

from collections.abc import Callable, Iterable
import dataclasses
import difflib
import sys
from typing import Any

from mv_slapse.errors import UsageError
from mv_slapse.nodes.settings import all_names, is_live
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

INT64_MAX = 2**63 - 1
Groups = Iterable[tuple[str, type]]


def declare(node: Node, groups: Groups) -> dict[type, Any]:
    """Declare a parameter for each setting of the groups, and warn about those that are none.

    Parameters
    ----------
    node : Node
    groups : iterable of (str, type)
        Prefix of the parameters' names, and the settings class.

    Returns
    -------
    settings : dict
        An instance of each settings class with the values that the parameters hold.

    Raises
    ------
    UsageError
        Where a value has the wrong type or is out of bounds.
    """
    settings = {kind: _declare_group(node, prefix, kind) for prefix, kind in groups}
    for warning in unknown(node):
        node.get_logger().warning(warning)
    return settings


def follow(node: Node, groups: Groups, on_change: Callable[[set[type]], None]):
    """Let the parameters that may change live do so.

    ``node.settings`` holds the new values when ``on_change`` is called with the settings classes
    in which something has changed.
    """
    items = {_name(prefix, item): (kind, item) for prefix, kind in groups
             for item in dataclasses.fields(kind)}

    def convert(changes: list[Parameter]) -> list[Parameter]:
        """Take integers for floats: 2 is a length as good as 2.0."""
        return [_as_float(change) if change.name in items
                and isinstance(items[change.name][1].default, float) else change
                for change in changes]

    def check(changes: list[Parameter]) -> SetParametersResult:
        """Refuse what the settings do."""
        try:
            _replaced(node.settings, items, changes)
        except UsageError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def apply(changes: list[Parameter]):
        """Take the new values."""
        replaced = _replaced(node.settings, items, changes)
        node.settings.update(replaced)
        if replaced:
            on_change(set(replaced))

    node.add_pre_set_parameters_callback(convert)
    node.add_on_set_parameters_callback(check)
    node.add_post_set_parameters_callback(apply)


def unknown(node: Node) -> list[str]:
    """Return a warning for each parameter that was given and is none, with the nearest name.

    What another node of this package knows is none of them: they may share a file.
    """
    given = getattr(node, '_parameter_overrides', {})
    known = all_names()
    strange = [name for name in given if not node.has_parameter(name) and name not in known]
    return [_warning(name, difflib.get_close_matches(name, known, 1)) for name in sorted(strange)]


def describe(kind: type, item: dataclasses.Field) -> ParameterDescriptor:
    """Return the description, the bounds and the read-only flag of a setting."""
    descriptor = ParameterDescriptor(description=item.metadata['doc'],
                                     read_only=not is_live(kind, item.name))
    low, high = item.metadata['low'], item.metadata['high']
    if low is None and high is None:
        return descriptor
    if isinstance(item.default, float):
        largest = sys.float_info.max
        descriptor.floating_point_range = [FloatingPointRange(
            from_value=float(-largest if low is None else low),
            to_value=float(largest if high is None else high))]
    elif isinstance(item.default, int):
        descriptor.integer_range = [IntegerRange(
            from_value=-INT64_MAX if low is None else int(low),
            to_value=INT64_MAX if high is None else int(high))]
    return descriptor


def _name(prefix: str, item: dataclasses.Field) -> str:
    return f'{prefix}.{item.name}' if prefix else item.name


def _declare_group(node: Node, prefix: str, kind: type) -> Any:
    return kind(**{item.name: _declare(node, _name(prefix, item), kind, item)
                   for item in dataclasses.fields(kind)})


def _declare(node: Node, name: str, kind: type, item: dataclasses.Field) -> Any:
    default = list(item.default) if isinstance(item.default, tuple) else item.default
    given = getattr(node, '_parameter_overrides', {}).get(name)
    numbers = given is not None and isinstance(item.default, float)
    try:
        if numbers and given.type_ == Parameter.Type.INTEGER:
            value = node.declare_parameter(name, float(given.value), describe(kind, item),
                                           ignore_override=True).value
        else:
            value = node.declare_parameter(name, default, describe(kind, item)).value
    except InvalidParameterTypeException as error:
        raise UsageError(f'parameter {name} has the wrong type, it needs a '
                         f'{type(item.default).__name__} such as {default!r}: {error}') from None
    except InvalidParameterValueException as error:
        raise UsageError(f'parameter {name}, {item.metadata["doc"]}: {error}') from None
    return tuple(value) if isinstance(item.default, tuple) else value


def _as_float(change: Parameter) -> Parameter:
    if change.type_ != Parameter.Type.INTEGER:
        return change
    return Parameter(change.name, Parameter.Type.DOUBLE, float(change.value))


def _replaced(settings: dict[type, Any], items: dict[str, tuple[type, dataclasses.Field]],
              changes: list[Parameter]) -> dict[type, Any]:
    """Return the settings in which parameters change something."""
    values: dict[type, dict[str, Any]] = {}
    for change in changes:
        if change.name in items:
            kind, item = items[change.name]
            values.setdefault(kind, {})[item.name] = change.value
    return {kind: dataclasses.replace(settings[kind], **changed)
            for kind, changed in values.items()}


def _warning(name: str, near: list[str]) -> str:
    hint = f'did you mean {near[0]}?' if near else 'docs/parameters.md lists all'
    return f'parameter {name} is unknown and not used: {hint}'

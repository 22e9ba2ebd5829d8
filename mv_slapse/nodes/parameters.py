"""ROS parameters from settings dataclasses: the dataclass is the only list of them."""

from collections.abc import Iterable
import dataclasses
import sys
from typing import Any

from mv_slapse.errors import UsageError
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

INT64_MAX = 2**63 - 1


def declare(node: Node, groups: Iterable[tuple[str, type]]) -> dict[type, Any]:
    """Declare a read-only parameter for each setting of the groups.

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
    return {kind: _declare_group(node, prefix, kind) for prefix, kind in groups}


def describe(item: dataclasses.Field) -> ParameterDescriptor:
    """Return the description, the bounds and the read-only flag of a setting."""
    descriptor = ParameterDescriptor(description=item.metadata['doc'], read_only=True)
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


def _declare_group(node: Node, prefix: str, kind: type) -> Any:
    values = {item.name: _declare(node, f'{prefix}.{item.name}' if prefix else item.name, item)
              for item in dataclasses.fields(kind)}
    return kind(**values)


def _declare(node: Node, name: str, item: dataclasses.Field) -> Any:
    default = list(item.default) if isinstance(item.default, tuple) else item.default
    try:
        value = node.declare_parameter(name, default, describe(item)).value
    except InvalidParameterTypeException as error:
        raise UsageError(f'parameter {name} has the wrong type, it needs a '
                         f'{type(item.default).__name__} such as {default!r}: {error}') from None
    except InvalidParameterValueException as error:
        raise UsageError(f'parameter {name}, {item.metadata["doc"]}: {error}') from None
    return tuple(value) if isinstance(item.default, tuple) else value

"""Small YAML files from anywhere: no aliases, no depth, no size that could fill the memory."""

from pathlib import Path
from typing import Any

import yaml

LARGEST = 1 << 17  # bytes; a camera file has 1 kB, all settings 20 kB
DEEPEST = 20  # lists and dicts in one another


class _Loader(yaml.SafeLoader):
    """The safe loader without aliases, which let a few lines stand for gigabytes."""

    def __init__(self, text: str):
        super().__init__(text)
        self._depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose what is not too deep and no alias."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError('aliases (*name) are not allowed; write the value out')
        self._depth += 1
        if self._depth > DEEPEST:
            raise yaml.YAMLError(f'values lie more than {DEEPEST} deep in one another')
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


def load(path: str | Path, largest: int = LARGEST) -> Any:
    """Return the content of a YAML file of ``largest`` bytes at most.

    Raises
    ------
    OSError
        Where it cannot be read.
    ValueError
        Where it is no YAML, too large, too deep, or has aliases; the message says which.
    """
    with Path(path).open('rb') as file:
        content = file.read(largest + 1)
    if len(content) > largest:
        raise ValueError(f'it has more than {largest} bytes')
    try:
        loader = _Loader(content.decode())
        try:
            return loader.get_single_data()
        finally:
            loader.dispose()
    except (yaml.YAMLError, ArithmeticError, TypeError, AttributeError) as error:
        raise ValueError(' '.join(str(error).split())) from error

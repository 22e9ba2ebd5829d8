"""Values as JSON has words for them."""

from collections.abc import Mapping
from math import isfinite
from typing import Any


def plain(value: Any) -> Any:
    """Return a value without what JSON has no word for: numpy types, infinite numbers."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    value = value.item() if hasattr(value, 'item') else value
    return None if isinstance(value, float) and not isfinite(value) else value

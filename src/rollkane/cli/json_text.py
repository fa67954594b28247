"""What commands print and write as JSON."""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, cast


def json_text(value: Any) -> str:
    """A value as JSON, arrays as lists; what is not finite as null."""
    return json.dumps(_finite(value), indent=2, allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        parts = cast(Mapping[Any, Any], value)
        return {str(name): _finite(part) for name, part in parts.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_finite(part) for part in cast(Sequence[Any], value)]
    bad = isinstance(value, float) and not math.isfinite(value)
    return None if bad else value

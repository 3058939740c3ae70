"""Values and tables as JSON holds them, with all their digits."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd


def plain_values(value: Any) -> Any:
    """Return values that JSON can hold; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(key): plain_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_values(item) for item in value]
    value = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(value, float) and not np.isfinite(value) else value


def plain_rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Return a table as records that begin with its index."""
    return plain_values(table.reset_index().to_dict("records"))

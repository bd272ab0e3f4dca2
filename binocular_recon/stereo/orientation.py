# SPDX-License-Identifier: Apache-2.0
"""Turn what belongs to a pair so that its baseline lies along the rows, and back."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

Kind = TypeVar('Kind', bound=np.generic)
Result = TypeVar('Result')


def turn(image: npt.NDArray[Kind], turns: int) -> npt.NDArray[Kind]:
    """Return an image turned by quarter turns, counter-clockwise; itself if ``turns`` is 0."""
    return image if turns == 0 else np.ascontiguousarray(np.rot90(image, turns))


def turn_back(result: Result, turns: int) -> Result:
    """Return a dataclass whose images (H, W) belong to turned images, for the original ones."""
    if turns == 0:
        return result
    values: dict[str, Any] = {
        spec.name: turn(value, -turns)
        for spec in dataclasses.fields(result)  # type: ignore[arg-type]
        if isinstance(value := getattr(result, spec.name), np.ndarray)
    }
    return dataclasses.replace(result, **values)  # type: ignore[type-var]

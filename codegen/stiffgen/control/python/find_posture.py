"""Search for a posture of a pose. NAME_find_posture.h for NumPy arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _c
from ._structs import of_shape

_NO_POSTURE = -4
"""NAME_FIND_POSTURE_E_NO_POSTURE."""
_TAKES_TOOL = any(row[1] == "tool_pose" for row in _c.FIELDS)


def find_posture(
    pose: ArrayLike,
    start: ArrayLike,
    *,
    tool_pose: ArrayLike | None = None,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
) -> NDArray[np.float64] | None:
    """Return joint positions (n) [rad or m] that have the tip at a pose (4, 4); None if none is found: one may exist.

    The search begins at ``start`` (n), then ever farther from it, and stays between ``lower`` and ``upper`` (n), by
    default the robot's limits less 0.1 or a tenth of the range. With several tips, ``pose`` is (tips, 4, 4).
    ``tool_pose`` (4, 4) is the tool's, of robots that take it at run time alone. Pass the result to :class:`Follow` as
    posture. Raises ValueError for a pose that is none, a start that is not finite, or bounds in the wrong order.
    """
    if (tool_pose is None) == _TAKES_TOOL:
        raise TypeError("tool_pose must be given" if _TAKES_TOOL else "this robot has no tool_pose")
    n, poses = (_c.MOTORS,), (4, 4) if _c.TIPS == 1 else (_c.TIPS, 4, 4)
    given, first = of_shape("pose", pose, poses, one=False), of_shape("start", start, n, one=False)
    tools = np.zeros(poses) if tool_pose is None else of_shape("tool_pose", tool_pose, poses, one=False)
    bounds, posture = None, np.empty(n)
    if lower is not None or upper is not None:
        if lower is None or upper is None:
            raise TypeError("give both lower and upper, or neither")
        bounds = np.concatenate([of_shape("lower", lower, n), of_shape("upper", upper, n)])
    numbers = np.concatenate([given.ravel(), tools.ravel(), first])
    code = _c.find_posture(numbers, bounds, posture)
    if code == _NO_POSTURE:
        return None
    if code:
        raise ValueError(_c.find_posture_error_text(code))
    return posture

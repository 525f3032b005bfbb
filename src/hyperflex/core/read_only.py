"""Read-only arrays: kernels receive arrays that they only read in this form, because they are compiled for one type."""

from typing import Any, TypeVar

import numpy as np

_T = TypeVar("_T", bound=tuple[Any, ...])


def read_only(parts: _T) -> _T:
    """Return a NamedTuple with views of its arrays that cannot be written to."""
    return type(parts)(*(_view(each) if isinstance(each, np.ndarray) else each for each in parts))


def _view(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    if not array.flags.writeable:
        return array
    view = array.view()
    view.setflags(write=False)
    return view

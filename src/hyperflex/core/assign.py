"""Assignment of whole arrays of one shape.

``out[:] = values`` does the same but checks the shapes, and numba compiles this check and its message again at each
use: a hundred times the code of the loop.
"""

from hyperflex.core.jit import non_allocating


@non_allocating
def assign(out, values):  # type: ignore[no-untyped-def]
    """Write `values` (m,) to `out` (m,)."""
    for i in range(out.shape[0]):
        out[i] = values[i]


@non_allocating
def assign_rows(out, values):  # type: ignore[no-untyped-def]
    """Write `values` (m, k) to `out` (m, k)."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = values[i, j]

"""Linear algebra on one thread: the matrices of a fit are small, and threads that wait for each other cost more."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep numpy's and scipy's linear algebra on one thread within the block, or the function that this decorates."""
    import scipy.linalg  # noqa: F401 its own library must be there to be limited
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        yield

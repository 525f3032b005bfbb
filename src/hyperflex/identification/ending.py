"""How a search ended: success, status and message, as scipy's OptimizeResult has them."""

CONVERGED, NOT_CONVERGED, INTERRUPTED = "converged", "not converged", "interrupted"
OUT_OF_TIME = "time budget exceeded"


class Ended:
    """A result with a `message`: ``converged``, ``not converged``, ``interrupted`` (Ctrl-C; the best so far).

    Or ``time budget exceeded``: the best so far as well.
    """

    message: str

    @property
    def success(self) -> bool:
        """Whether the search converged."""
        return self.message == CONVERGED

    @property
    def status(self) -> int:
        """0: success. 1: not converged, or nothing found. 2: ended by Ctrl-C."""
        return 0 if self.success else 2 if self.message == INTERRUPTED else 1

    def ending(self) -> dict[str, bool | int | str]:
        """Return success, status and message, for JSON and TOML."""
        return {"success": self.success, "status": self.status, "message": self.message}


def alone(starts: int, agree: int) -> str:
    """Return a warning where of several starts none but the best came to this fit."""
    if starts == 1 or agree > 1:
        return ""
    return (
        f"Of {starts} starts one alone came to this fit, which may be a local optimum: give a better guess, or shorter "
        "windows (window=...)."
    )

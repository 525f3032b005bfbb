"""Serial ports: what is wrong with one that cannot be opened, in one line with the fix."""

import errno

from hyperflex.errors import DriveError


def open_problem(port: str, error: BaseException) -> DriveError:
    """Return the error of a port that could not be opened, with its cause and what to do.

    Parameters
    ----------
    port : str
        Its path, as given.
    error : BaseException
        Of pyserial or of a library above it: the first OSError with a number in its chain of causes counts.
    """
    from serial.tools import list_ports

    cause: BaseException | None = error
    while cause is not None and getattr(cause, "errno", None) is None:
        cause = cause.__cause__ or cause.__context__
    number = getattr(cause, "errno", None)
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        here = ", ".join(sorted(found.device for found in list_ports.comports())) or "none"
        what = f"there is no such port. Ports of this machine: {here}"
    elif number in (errno.EACCES, errno.EPERM):
        what = "no permission. Join the group that owns the port (sudo usermod -aG dialout $USER) and log in again"
    elif number in (errno.EBUSY, errno.EAGAIN):
        what = "another program uses the port. Close that program first"
    else:
        what = f"it cannot be opened ({error})"
    return DriveError(f"{port}: {what}.")

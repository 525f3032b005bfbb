"""The zero of a drive, kept in a small file: the raw angle at which the arm hangs down."""

from dataclasses import asdict, dataclass
from typing import Self
from urllib.parse import parse_qs

from hyperflex import checks, files
from hyperflex.errors import InvalidInput

TABLE = "zero"  # of a file


@dataclass(frozen=True)
class DriveZero:
    """The zero of a drive.

    Parameters
    ----------
    raw : float
        Raw angle of the shaft, rad, at which the arm hangs down: `zero` of :class:`hyperflex.hardware.Drive`.
    direction : {1, -1}
        As of :class:`hyperflex.hardware.Drive`.
    motor : str
        The drive that it belongs to.
    """

    raw: float
    direction: int = 1
    motor: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "raw", checks.number("raw angle of the zero", self.raw, unit="rad"))
        if self.direction not in (1, -1):
            raise InvalidInput("direction of a drive", got=self.direction, allowed="1 or -1")

    def check(self, address: str) -> None:
        """Refuse a motor (an address, as of :func:`hyperflex.hardware.open_link`) that it does not belong to.

        Port and id count; a zero without a motor belongs to any. Raises InvalidInput.
        """
        if self.motor and _port_and_id(self.motor) != _port_and_id(address):
            raise InvalidInput(
                "the zero belongs to another motor",
                got=address,
                allowed=self.motor,
                fix="Set that of this motor with hyperflex motor zero",
            )

    def to_toml(self, path: files.PathLike) -> None:
        """Write it to a TOML file, wholly or not at all."""
        files.write_toml(path, {TABLE: asdict(self)})

    @classmethod
    def from_toml(cls, path: files.PathLike) -> Self:
        """Read it from a TOML file. Raises FileProblem or InvalidInput."""
        table = files.read_toml(path).get(TABLE)
        fix = "Make one with hyperflex motor zero"
        if not isinstance(table, dict) or "raw" not in table:
            raise InvalidInput(f"{path} has no zero of a drive", allowed=f"a table [{TABLE}] with raw", fix=fix)
        checks.keys(f"the table [{TABLE}] of {path}", table, ["raw", "direction", "motor"])
        return cls(**table)


def _port_and_id(address: str) -> tuple[str, list[str]]:
    place, _, query = address.partition("?")
    return place, parse_qs(query).get("id", [])

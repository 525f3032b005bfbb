"""The rope: a planar chain of rigid links with per-link properties."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks, files
from hyperflex.checks import Array
from hyperflex.core.chain.articulated_body import MUTUAL, ONE_SIDED, Chain
from hyperflex.core.chain.articulated_body import joints as write_joints
from hyperflex.core.read_only import read_only
from hyperflex.errors import InvalidInput, located
from hyperflex.model.properties import LINK_NAMES, LINK_PROPERTIES, PROPERTIES

MOST_LINKS = 100_000  # far above any use, so that a typing error cannot fill the memory
DENSITIES = (0.01, 1e5)  # kg/m^3: a hundredth of air's, and four times that of the densest metal
TOTALS = ("length", "mass")  # in a file, of the whole rope or of each link, as its key states
GRAVITY = (0.0, -9.81)  # m/s^2
FrictionModel = Literal["relative", "printed"]
FRICTION_MODELS = ("relative", "printed")


@dataclass(frozen=True, eq=False, init=False)
class Rope:
    """A rope as a chain of n rigid links; also a tapered whip, or a real pendulum.

    Joint i connects link i - 1 to link i; joint 0 connects the rope to the arm (or to the wall). All arrays are (n,); a
    single number applies to all links.

    Parameters
    ----------
    length : (n,) array_like
        Link lengths, joint to joint, m. At least one of `length` and `mass` must be an array; its size is n.
    mass : (n,) array_like
        Link masses, kg.
    com : (n,) array_like, optional
        Distance of each centre of mass from the motor-side joint, m; by default half the length.
    inertia : (n,) array_like, optional
        About the centre of mass, kg m^2; by default the cylinder's m (3 r^2 + l^2) / 12.
    friction : (n,) array_like
        Viscous friction of the joints (eta), N m s/rad.
    dry_friction : (n,) array_like
        Coulomb friction of the joints, N m: its full value in a turning joint, at most this value in a sticking one.
    stiffness, rest_angle : (n,) array_like
        Joint stiffness, N m/rad, and the relative angle at which it is at rest, rad.
    drag : (n,) array_like
        Quadratic air drag of the links, kg/m^2: force per length and per squared velocity across the link, which is
        half of air density x drag coefficient x diameter (0.5 x 1.2 x 1.2 x 5 mm: 0.0036); 0 for none.
    max_bend : (n,) array_like
        Joint limits: greatest difference of the relative angle from `rest_angle`, rad; inf for none.
    tip_mass : float
        Point mass at the far end of the last link, kg.
    gravity : (2,) array_like
        Gravity, x to the right and y upwards, m/s^2.
    friction_model : {"relative", "printed"}
        Whether joint friction acts on both links of a joint (physical), or on the outer one only, as the paper's
        equation (4) prints it.
    radius : float
        Radius of the rope, m, for the default inertia, contact and drawing; 0 is allowed.
    name : str
        For reports.

    Raises
    ------
    InvalidInput
        If a value is not finite, has the wrong sign or the wrong shape, or a link has neither mass nor inertia.

    Examples
    --------
    >>> import hyperflex as hf
    >>> whip = hf.Rope(length=[0.1, 0.1, 0.1], mass=[0.03, 0.02, 0.01], friction=1e-4)
    >>> whip.n_links
    3
    """

    length: Array
    mass: Array
    com: Array
    inertia: Array
    friction: Array
    dry_friction: Array
    stiffness: Array
    rest_angle: Array
    drag: Array
    max_bend: Array
    tip_mass: float
    gravity: Array
    friction_model: FrictionModel
    radius: float
    name: str

    def __init__(
        self,
        length: ArrayLike,
        mass: ArrayLike,
        com: ArrayLike | None = None,
        inertia: ArrayLike | None = None,
        friction: ArrayLike = 0.0,
        dry_friction: ArrayLike = 0.0,
        stiffness: ArrayLike = 0.0,
        rest_angle: ArrayLike = 0.0,
        drag: ArrayLike = 0.0,
        max_bend: ArrayLike = np.inf,
        tip_mass: float = 0.0,
        gravity: ArrayLike = GRAVITY,
        friction_model: FrictionModel = "relative",
        radius: float = 0.0,
        name: str = "",
    ) -> None:
        given: dict[str, Any] = {each: value for each, value in locals().items() if each in LINK_NAMES}
        n = _number_of_links(given)
        r = checks.number("radius", radius, sign="nonnegative", unit="m")
        for each in LINK_PROPERTIES:
            value = given[each.name]
            if each.name == "com" and value is None:
                value = 0.5 * self.length
            elif each.name == "inertia" and value is None:
                value = self.mass * (3.0 * r**2 + self.length**2) / 12.0
            bounds: dict[str, Any] = {"sign": each.sign, "unit": each.unit, "infinite": each.default == np.inf}
            array = checks.array(f"rope {each.name}", value, (n,), scalar=True, **bounds)
            object.__setattr__(self, each.name, array)
        for field, value in (
            ("radius", r),
            ("tip_mass", checks.number("tip_mass", tip_mass, sign="nonnegative", unit="kg")),
            ("gravity", checks.array("gravity", gravity, (2,), unit="m/s^2")),
            ("friction_model", checks.choice("friction_model", friction_model, FRICTION_MODELS)),
            ("name", checks.text("rope name", name)),
        ):
            object.__setattr__(self, field, value)
        if r > 0.5 * self.total_length:
            most = f"up to half its length, {0.5 * self.total_length:g} m: 2.5 mm are 0.0025"
            raise InvalidInput("rope radius makes it thicker than it is long", got=r, allowed=most)
        checks.meant("rope length", self.length.sum(), "m")
        empty = self.inertia + self.mass * self.com**2 <= 0.0
        empty[-1] &= self.tip_mass <= 0.0
        if empty.any():
            raise InvalidInput(
                f"link {int(np.argmax(empty))} has no inertia about its joint",
                got=0.0,
                allowed="a mass away from the joint, or an inertia > 0, for every link",
            )

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a pickled or copied rope and make its arrays read-only again."""
        for name, value in state.items():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            object.__setattr__(self, name, value)

    @classmethod
    def uniform(
        cls,
        length: float,
        mass: float,
        n_links: int,
        radius: float = 0.0,
        inertia: float | None = None,
        friction: float | None = None,
        drag_coefficient: float = 0.0,
        air_density: float = 1.204,
        **others: Any,
    ) -> "Rope":
        """Divide a uniform cable into equal links.

        Parameters
        ----------
        length, mass : float
            Of the whole cable, m and kg.
        n_links : int
            Number of links, at least 1.
        radius : float
            Of the cable, m; may be 0.
        inertia : float, optional
            Of one link about its centre of mass, kg m^2; by default the cylinder's.
        friction : float
            Viscous friction of each joint, N m s/rad. It must be given: without friction (0.0) a widely swinging rope
            becomes an unpredictable tangle within seconds. For one material it is inversely proportional to the length
            of a link.
        drag_coefficient, air_density : float
            Of the cable across the wind (a cylinder's is about 1.2) and of the air, kg/m^3 (default: at 20 degrees
            Celsius and 1013 hPa): they give `drag`; without a coefficient there is none.
        **others
            Any other field of :class:`Rope`, for instance ``friction_model="printed"``.

        Raises
        ------
        InvalidInput
            As :class:`Rope` does.

        Examples
        --------
        The paper's cable:

        >>> import hyperflex as hf
        >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
        >>> f"{cable.inertia[0]:.3e}"
        '3.372e-07'
        """
        if friction is None:
            allowed = "a number >= 0, in N m s/rad"
            fix = "A cable 5 mm thick in links of 40 mm has 5e-4 (hyperflex.identify measures it); 0.0 for none"
            raise InvalidInput("friction of the joints is missing", allowed=allowed, fix=fix)
        n = checks.count("n_links", n_links, most=MOST_LINKS)
        total = checks.number("length", length, sign="positive", unit="m")
        weight = checks.number("mass", mass, sign="nonnegative", unit="kg")
        link_mass = np.full(n, weight / n)
        checks.keys("a rope", others, Rope.__dataclass_fields__)
        r = checks.number("radius", radius, sign="nonnegative", unit="m")
        if coefficient := checks.number("drag_coefficient", drag_coefficient, sign="nonnegative"):
            if "drag" in others or not r:
                allowed = "with a radius > 0, and without drag"
                raise InvalidInput("drag_coefficient cannot be used", got=coefficient, allowed=allowed)
            others["drag"] = coefficient * checks.number("air_density", air_density, sign="positive") * r
        check_density(total, weight, r)
        checks.meant("rope mass over length", weight / total, "kg/m")
        return cls(np.full(n, total / n), link_mass, radius=radius, inertia=inertia, friction=friction, **others)

    @property
    def n_links(self) -> int:
        """Number of links."""
        return int(self.length.size)

    @property
    def total_length(self) -> float:
        """Length of the straight rope, m."""
        return float(self.length.sum())

    @property
    def total_mass(self) -> float:
        """Mass of all links and of the tip mass, kg."""
        return float(self.mass.sum() + self.tip_mass)

    @property
    def link_ends(self) -> Array:
        """Distance of the far end of each link from the first joint along the rope (n,), m."""
        return np.cumsum(self.length)

    @property
    def link_middles(self) -> Array:
        """Distance of the middle of each link from the first joint along the rope (n,), m."""
        return self.link_ends - 0.5 * self.length

    @property
    def limited(self) -> bool:
        """Whether a joint has a limit."""
        return bool(np.isfinite(self.max_bend).any())

    @property
    def g(self) -> float:
        """Size of gravity, m/s^2."""
        return float(np.hypot(*self.gravity))

    @property
    def hanging_angle(self) -> float:
        """Link angle at which the rope hangs along gravity, rad (0 without gravity)."""
        gx, gy = self.gravity
        return float(np.arctan2(gx, -gy)) if (gx or gy) else 0.0

    def joints(self, q: Array, base: Array) -> Array:
        """Return the joints (..., n + 1, 2), m, from `base` (..., 2) to the tip, at link angles q (..., n), rad."""
        shape = np.shape(q)[:-1]
        angles = checks.array("q", q, (*shape, self.n_links), unit="rad", gaps=True)
        base = checks.array("base", base, (*shape, 2), unit="m", gaps=True)
        places = np.empty((*shape, self.n_links + 1, 2))
        rows = angles.reshape(-1, self.n_links), base.reshape(-1, 2), places.reshape(-1, self.n_links + 1, 2)
        write_joints(self.length, *rows)
        return places

    def joint_velocities(self, q: Array, qd: Array, velocity: Array) -> Array:
        """Return the velocities (..., n + 1, 2), m/s, of the joints, the tip last.

        Angles q, rad, and rates qd (..., n), rad/s; `velocity` (..., 2), m/s, is that of the first joint.
        """
        steps = (self.length * qd)[..., None] * unit_across(q)
        return np.cumsum(np.concatenate([velocity[..., None, :], steps], axis=-2), axis=-2)

    def mass_points(self, q: Array, qd: Array, base: Array, velocity: Array) -> tuple[Array, Array]:
        """Return positions, m, and velocities, m/s, of the links' centres of mass and of the tip (..., n + 1, 2).

        Angles `q` (..., n), rad, and rates `qd`, rad/s; `base`, m, and `velocity`, m/s, (..., 2) of the first joint.
        """
        places, velocities = self.joints(q, base), self.joint_velocities(q, qd, velocity)
        places[..., :-1, :] += self.com[:, None] * unit_along(q)
        velocities[..., :-1, :] += (self.com * qd)[..., None] * unit_across(q)
        return places, velocities

    def replace(self, **changes: Any) -> "Rope":
        """Return a rope with the fields named in `changes` replaced; com and inertia stay unless named."""
        checks.keys("a rope", changes, Rope.__dataclass_fields__)
        return replace(self, **changes)

    def with_bend_radius(self, radius: float) -> "Rope":
        """Return the rope with joint limits that allow its axis to bend to a circle of `radius`, m, and no tighter.

        A joint's limit is 2 atan(l / (2 radius)), with l half of both its links' lengths: a polygon whose sides touch
        the circle in their middles. The first joint is a hinge, and keeps its limit.
        """
        r = checks.number("radius", radius, sign="positive", unit="m")
        limits = bend_limits(4.0 * r / (self.length[:-1] + self.length[1:]))
        return self.replace(max_bend=np.append(self.max_bend[0], limits))

    def __eq__(self, other: object) -> bool:
        """Whether all properties are equal, bit for bit."""
        return isinstance(other, Rope) and all(
            np.array_equal(getattr(self, f.name), getattr(other, f.name)) for f in fields(self)
        )

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        name = f"{self.name}, " if self.name else ""
        links = f"{self.n_links} link{'' if self.n_links == 1 else 's'}"
        return f"Rope({name}{links}, {self.total_length:.4g} m, {self.total_mass:.4g} kg)"

    def _repr_html_(self) -> str:
        from hyperflex.report import rope_html

        return rope_html(self)

    def chain(self) -> Chain:
        """Return the arrays of the kernels."""
        chain = Chain(
            **{each.field: getattr(self, each.name) for each in LINK_PROPERTIES},
            tip_mass=self.tip_mass,
            gx=float(self.gravity[0]),
            gy=float(self.gravity[1]),
            reaction=MUTUAL if self.friction_model == "relative" else ONE_SIDED,
        )
        return read_only(chain)

    def table(self) -> dict[str, Any]:
        """Return the ``[rope]`` table of a TOML file; equal entries are written once."""
        content: dict[str, Any] = {"n_links": self.n_links}
        for each in fields(self):
            name, value = each.name, getattr(self, each.name)
            if name in LINK_NAMES and bool((value == value[0]).all()):
                content[f"link_{name}" if name in TOTALS else name] = float(value[0])
            else:
                content[name] = value.tolist() if isinstance(value, np.ndarray) else value
        return content

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> "Rope":
        """Build a rope from a ``[rope]`` table, see docs/how-to/files.md.

        Length and mass are arrays with one entry per link, or ``total_length`` and ``total_mass`` of the whole rope, or
        ``link_length`` and ``link_mass`` of each of ``n_links`` equal links.
        """
        content = dict(checks.mapping("the rope table", table))
        checks.keys("the rope table", content, table_keys())
        sizes = [np.size(content[name]) for name in LINK_NAMES if np.ndim(content.get(name, 0.0)) == 1]
        if "n_links" not in content and not sizes:
            raise InvalidInput("rope table lacks n_links", allowed="n_links = 50, or arrays with one entry a link")
        n = checks.count("rope n_links", content.pop("n_links", sizes[0] if sizes else None), most=MOST_LINKS)
        for name in TOTALS:
            given = [key for key in (name, f"total_{name}", f"link_{name}") if key in content]
            allowed = f"one of total_{name} (of the whole rope), link_{name} (of each link) or {name} (an array)"
            if len(given) != 1:
                raise InvalidInput(f"rope table gives the {name} {len(given)} times", got=given, allowed=allowed)
            value = content.pop(given[0])
            if np.ndim(value) == 0:
                if given[0] == name and n > 1:
                    raise InvalidInput(f"rope {name} is one number for {n} links", got=value, allowed=allowed)
                each = PROPERTIES[name]
                number = checks.number(f"rope {given[0]}", value, sign=each.sign, unit=each.unit)
                value = np.full(n, number / n if given[0].startswith("total") else number)
            content[name] = value
        if (size := np.size(content["length"])) != n:
            raise InvalidInput("rope n_links differs from its arrays", got=n, allowed=f"{size}, as length has")
        check_density(content["length"], content["mass"], content.get("radius", 0.0))
        return cls(**content)

    def to_toml(self, path: str | Path) -> None:
        """Write the rope to the TOML file `path`, wholly or not at all."""
        files.write_toml(path, {"rope": self.table()})

    @classmethod
    def from_toml(cls, path: str | Path) -> "Rope":
        """Read a rope from the ``[rope]`` table of the TOML file `path`.

        Raises
        ------
        FileProblem, InvalidInput
            If the file cannot be read, has no such table, or the table does not describe a rope.
        """
        content = files.read_toml(path)
        if not isinstance(content.get("rope"), Mapping):
            raise InvalidInput(f"{path} has no [rope] table", got=sorted(content), allowed="a table named rope")
        warn_of_grade(path, content)
        with located(str(path), files.toml_words):
            return cls.from_table(content["rope"])


def unit_along(angle: ArrayLike, axis: int = -1) -> Array:
    """Return unit vectors along links or arms, away from the motor, at angles (...), rad; x and y are on `axis`."""
    return np.stack([np.sin(angle), -np.cos(angle)], axis=axis)


def unit_across(angle: ArrayLike, axis: int = -1) -> Array:
    """Return unit vectors across links or arms, in positive sense, at angles (...), rad; x and y are on `axis`."""
    return np.stack([np.cos(angle), np.sin(angle)], axis=axis)


def swing_rate(rope: Rope) -> float:
    """Return sqrt(g / L), rad/s: the approximate angular frequency of a swing."""
    return float(np.sqrt(np.hypot(*rope.gravity) / rope.total_length))


def warn_of_grade(path: str | Path, content: Mapping[str, Any]) -> None:
    """Warn (UserWarning) of a rope in a file whose identification is graded "do not use"."""
    found = content.get("identification")
    if isinstance(found, Mapping) and found.get("grade") == "do not use":
        text = f"{path}: the identification of this rope is graded 'do not use'. {found.get('message', '')}"
        warnings.warn(text, stacklevel=3)


def table_keys() -> list[str]:
    """Return the keys that a ``[rope]`` table may have."""
    return [*Rope.__dataclass_fields__, "n_links", *(f"{kind}_{name}" for kind in ("total", "link") for name in TOTALS)]


def bend_ratios(max_bend: Array) -> Array:
    """Return twice the bend radius of joints over the length that each represents; 0 for a joint without a limit."""
    return np.where(max_bend < np.pi, 1.0 / np.tan(0.5 * np.minimum(max_bend, np.pi)), 0.0)


def bend_limits(ratios: Array) -> Array:
    """Return the joint limits, rad, for such ratios; inf for 0."""
    return np.where(ratios > 0.0, 2.0 * np.arctan2(1.0, ratios), np.inf)


def check_density(length: Any, mass: Any, radius: Any) -> None:
    """Refuse an impossible density: most likely grams were given for kilograms, or mm for m."""
    try:
        r, total_length, total = float(radius), float(np.sum(length)), float(np.sum(mass))
    except (TypeError, ValueError, OverflowError):
        return  # refused by a separate check
    volume = np.pi * r**2 * total_length
    if r <= 0.5 * total_length and volume > 0.0 < total and not DENSITIES[0] <= total / volume <= DENSITIES[1]:
        raise InvalidInput(
            "length, mass and radius of the rope make an impossible density",
            got=f"{total / volume:.3g} kg/m^3",
            allowed="0.01 to 100,000 kg/m^3; cords have some 1000, steel has 7900",
            fix="Give length and radius in m and mass in kg: 2.5 mm are 0.0025, 125 g are 0.125",
        )


def _number_of_links(values: Mapping[str, ArrayLike | None]) -> int:
    sizes: dict[str, int] = {}
    for name, value in values.items():
        try:
            shape = np.shape(value)  # type: ignore[arg-type]
        except ValueError:
            raise InvalidInput(f"rope {name} is ragged", got=value, allowed="a number, or an array (n,)") from None
        if len(shape) == 1:
            sizes[name] = shape[0]
    if not sizes:
        raise InvalidInput(
            "a rope of numbers alone does not say how many links it has",
            allowed="an array with one entry a link for at least one property",
            fix="Write length=[0.6] for one link of 0.6 m; "
            "Rope.uniform(length, mass, n_links, friction=...) cuts a rope into equal links (in a file: n_links)",
        )
    if len(set(sizes.values())) != 1 or 0 in sizes.values():
        raise InvalidInput(
            "rope arrays have different numbers of links",
            got=sizes,
            allowed="arrays (n,) of one length n >= 1, and single numbers",
            fix="Give length = [...] with one entry a link (of equal links: n_links in a file, Rope.uniform in Python)",
        )
    return next(iter(sizes.values()))

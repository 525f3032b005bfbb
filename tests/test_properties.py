"""The table of properties: each row is in files, fits, derivatives, reports and the notation."""

from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.core.chain.articulated_body import Chain
from hyperflex.identification import lumped, ratios
from hyperflex.identification.model import Parameters, common_factor, in_common_factor, parse
from hyperflex.model import divided
from hyperflex.model.properties import FREE_PROPERTIES, LINK_PROPERTIES, PROPERTIES, RATIOS, RESISTANCES, parse_label
from hyperflex.model.refine import with_links
from hyperflex.report.identification.tables import numbers, parameters_table, rope_table
from hyperflex.report.units import readable_unit
from tests.refusals import refuses

VALUES = {
    "length": [0.2, 0.3, 0.25],
    "mass": [0.02, 0.03, 0.01],
    "com": [0.09, 0.16, 0.12],
    "inertia": [7e-5, 2e-4, 6e-5],
    "friction": [2e-4, 1e-4, 3e-4],
    "dry_friction": [1e-4, 3e-4, 2e-4],
    "stiffness": [2e-3, 1e-3, 4e-3],
    "rest_angle": [0.1, -0.2, 0.3],
    "drag": [3e-3, 4e-3, 2e-3],
    "max_bend": [np.inf, 1.5, 2.0],
}
ROPE = hf.Rope(**VALUES, tip_mass=0.005, radius=0.004)
EACH = pytest.mark.parametrize("each", LINK_PROPERTIES, ids=[each.name for each in LINK_PROPERTIES])
FREE_LINKS = [each for each in LINK_PROPERTIES if each.form]


def one(name: str) -> hf.Rope:
    """The rope with nothing but its body and this property."""
    rest = {each.name: each.default for each in LINK_PROPERTIES if each.default is not None and each.name != name}
    return ROPE.replace(**rest)


@EACH
def test_it_is_a_field_of_the_rope_and_of_the_chain(each):
    assert each.name in {field.name for field in fields(hf.Rope)}
    np.testing.assert_array_equal(getattr(ROPE.chain(), each.field), VALUES[each.name])
    assert Chain._fields.index(each.field) == LINK_PROPERTIES.index(
        each
    )  # the lanes of a batch go by the table's order
    if each.default is not None:
        plain = hf.Rope(VALUES["length"], VALUES["mass"])
        np.testing.assert_array_equal(getattr(plain, each.name), each.default)


@EACH
def test_it_goes_through_files(each, tmp_path):
    for rope in (ROPE, one(each.name), one(each.name).replace(**{each.name: VALUES[each.name][2]})):
        rope.to_toml(tmp_path / "rope.toml")
        assert hf.Rope.from_toml(tmp_path / "rope.toml") == rope
        setup = hf.Setup.loads(hf.Setup(rope, duration=1.0).dumps())  # as a trajectory in NetCDF keeps it
        assert setup.rope == rope
        assert hf.Arm(friction=1e-3).chain(rope).length.size == 4


@EACH
def test_its_bounds_are_kept(each):
    bad = {"any": [np.nan, np.inf], "nonnegative": [-1.0, np.nan], "positive": [0.0, -1.0]}[each.sign]
    for value in bad:
        refuses(each.name, ROPE.replace, **{each.name: [value, *VALUES[each.name][1:]]})


@pytest.mark.parametrize("each", FREE_LINKS, ids=[each.name for each in FREE_LINKS])
def test_it_can_be_free(each):
    """x to the value and back, and the derivative of the rope with x by differences."""
    parameters = Parameters(ROPE, parse(ROPE, [each.name]))
    x = parameters.start
    np.testing.assert_allclose(getattr(parameters.rope(x), each.name), VALUES[each.name], rtol=1e-14)
    step = 1e-6
    for k, part in parameters.parts(x):
        up, down = (getattr(parameters.rope(x + d * np.eye(3)[k]), each.name) for d in (step, -step))
        np.testing.assert_allclose(part[each.name], (up - down) / (2.0 * step), rtol=1e-8, atol=1e-12)
    assert [parse_label(label) for label in parameters.labels] == [(each.name, k, "") for k in range(3)]
    for law in ("shared", "inner", "factor", "taper"):
        assert len(parse(ROPE, [f"{each.name}:{law}"])) == 1


def test_what_cannot_be_free_is_refused():
    for name in PROPERTIES.keys() - FREE_PROPERTIES.keys():
        refuses("unknown name", parse, ROPE, [name])
    for wrong in ("friction[1]:shared", "friction[-1]", "friction:all", "", "friction[1", 3):
        assert parse_label(wrong) is None


@EACH
def test_people_read_it_with_its_unit(each):
    free = {each.name} if each.form else set()
    labels = tuple(f"{name}[{k}]" for name in free for k in range(3))
    spread = {name: np.abs(np.array(VALUES[name])) * 0.01 for name in free}
    values = {name: np.array(VALUES[name]) for name in free}
    starts = np.array([VALUES[name][k] for name in free for k in range(3)])
    found = SimpleNamespace(parameters=labels, starts=starts, values=values, std=spread, intervals={})
    (column,) = [
        k for k, name in enumerate(rope_table(ROPE, found).header) if name.startswith(each.name.replace("_", " "))
    ]
    unit = readable_unit(each.name, VALUES[each.name])
    assert rope_table(ROPE, found).header[column].endswith(f", {unit.name}")
    assert float(rope_table(ROPE, found).rows[2][column]) * unit.size == pytest.approx(VALUES[each.name][2], rel=1e-3)
    for number, row in zip(numbers(found), parameters_table(found, ROPE).rows, strict=True):
        assert row[1] == f"{each.words}, link {number.place}"
        assert row[2].endswith(unit.name.replace(" ", "\u00a0"))


@pytest.mark.parametrize("each", RESISTANCES, ids=[each.name for each in RESISTANCES])
def test_it_goes_with_the_common_factor(each):
    """Everything free, nothing known: all that resists grows with the moments, and its ratio stays."""
    words = ["mass:factor", "inertia:factor", "tip_mass", f"{each.name}:factor"]
    rope = one(each.name)
    parameters = Parameters(rope, parse(rope, words))
    found = common_factor(parameters, parameters.start, np.eye(4))
    assert found is not None
    assert in_common_factor(parameters, parameters.start, np.eye(4)).all()
    moved = parameters.rope(parameters.start + 0.01 * found)
    name = f"{each.symbol}/p1"
    assert lumped(moved)[0][0] != lumped(rope)[0][0]
    np.testing.assert_allclose(ratios(moved)[name], ratios(rope)[name], rtol=1e-4)
    assert readable_unit(name, 1.0).name == RATIOS[name].unit.replace("^2", "²").replace("^3", "³")


def test_pieces_of_a_link_are_the_same_rope():
    """Each rule of division: shared properties keep their sum, equal ones their mean, joints their value per length."""
    rope = ROPE.replace(com=0.5 * ROPE.length)
    for fine in (divided(rope, 4), with_links(rope, 15)):
        fine_ends, ends = np.cumsum(fine.length), np.cumsum(rope.length)
        for each in LINK_PROPERTIES:
            old, new = getattr(rope, each.name), getattr(fine, each.name)
            if each.cut == "shared":
                assert new.sum() == pytest.approx(old.sum(), rel=1e-12)
            elif each.cut == "alike":
                assert (new * fine.length).sum() == pytest.approx((old * rope.length).sum(), rel=1e-12)
            elif each.cut == "stays":
                assert new.sum() == pytest.approx(old.sum(), rel=1e-12)
                assert np.count_nonzero(new) == np.count_nonzero(old)
            elif each.cut in ("bending", "limit", "joint"):
                assert new[0] == old[0]
                stands = {"bending": 1.0, "limit": -1.0, "joint": 0.0}[each.cut]
                here = int(np.abs(fine_ends - ends[0]).argmin()) + 1  # the rope's second joint, if the cut keeps it
                if abs(fine_ends[here - 1] - ends[0]) < 1e-12:
                    short, long = (0.5 * (a[k - 1] + a[k]) for a, k in ((fine.length, here), (rope.length, 1)))
                    was, now = old[1], new[here]
                    if each.cut == "limit":  # the least radius of the bend, half of both links over this tangent
                        was, now = np.tan(0.5 * was), np.tan(0.5 * now)
                    assert now * short**stands == pytest.approx(was * long**stands, rel=1e-9)


def test_the_notation_tells_each_with_its_unit():
    text = (Path(__file__).parents[1] / "docs" / "notation.md").read_text("utf-8")
    for each in (*LINK_PROPERTIES, PROPERTIES["tip_mass"]):
        assert f"| `{each.name}` | {each.unit.replace('^2', '²')} |" in text


def test_drag_from_a_diameter_and_a_coefficient():
    """Half of the air's density x coefficient x diameter."""
    rope = hf.Rope.uniform(1.0, 0.1, 4, radius=0.003, drag_coefficient=1.1, air_density=1.3, friction=0.0)
    np.testing.assert_allclose(rope.drag, 0.5 * 1.3 * 1.1 * 0.006, rtol=1e-14)
    assert not hf.Rope.uniform(1.0, 0.1, 4, radius=0.003, friction=0.0).drag.any()
    for wrong in ({"drag_coefficient": 1.0}, {"drag_coefficient": 1.0, "radius": 0.003, "drag": 1e-3}):
        refuses("drag_coefficient", hf.Rope.uniform, 1.0, 0.1, 4, friction=0.0, **wrong)

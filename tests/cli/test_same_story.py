"""The output, the JSON, the page and the exit code of ``hyperflex identify`` agree."""

import html
import json
import re

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import files, identification

PAIR = hf.Rope(length=[0.3, 0.25], mass=[0.1, 0.06], com=[0.14, 0.13], inertia=[8e-4, 3.5e-4], friction=[3e-4, 1e-4])
CASES = {  # exit code, grade, what is free, a factor of the times, and what the first line says
    "held": (0, "usable for ratios", "friction[0],friction[1]", 1.0, "proportional to held masses"),
    "ratios": (0, "usable for ratios", "inertia,com,friction", 1.0, "unknown common factor"),
    "wrong": (5, "do not use", "inertia,com,friction", 1.1, "clock or lengths"),
}


def text_of(page: str) -> str:
    """The text of a page without tags."""
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", re.sub(r"(?s)<(style|script).*?</\1>", " ", page))).split())


@pytest.mark.parametrize(
    "name", ["wrong", *(pytest.param(case, marks=pytest.mark.nightly) for case in ("held", "ratios"))]
)
def test_print_json_page_and_exit_code_tell_the_same(hyperflex, tmp_path, monkeypatch, name):
    exit_code, grade, free, factor, words = CASES[name]
    t = np.arange(300) / 50.0
    q = hf.simulate(PAIR, duration=t[-1], t_eval=t, q0=[0.9, 0.6]).q
    q = q + 2e-3 * np.random.default_rng(0).standard_normal(q.shape)
    files.write_table(tmp_path / "swing.csv", ["t", "th1", "th2"], np.column_stack([factor * t, q]))
    PAIR.replace(friction=5e-4).to_toml(tmp_path / "guess.toml")
    identify, found = identification.identify, []

    def once(*arguments, **options):
        found.extend([] if found else [identify(*arguments, **options)])
        return found[0]

    monkeypatch.setattr(identification, "identify", once)
    arguments = ["identify", tmp_path / "swing.csv", "--rope", tmp_path / "guess.toml", "--time-unit", "s"]
    arguments += ["--unit", "rad", "--free", free, "-o", tmp_path / "out"]
    code, printed, _ = hyperflex(*arguments)
    json_code, told, _ = hyperflex(*arguments, "--json")
    figures = json.loads(told)
    assert code == json_code == exit_code
    assert figures["grade"] == grade
    assert figures["findings"][0]["kind"] == words

    kept = json.loads((tmp_path / "out" / "identification.json").read_text("utf-8"))
    assert {key: figures[key] for key in kept} == kept
    shown = {
        "print(result)": " ".join(str(found[0]).split()),
        "command line": " ".join(printed.split()),
        "page": text_of((tmp_path / "out" / "report.html").read_text("utf-8")),
    }
    first = found[0].report().splitlines()[0]
    for where, text in shown.items():
        assert text.startswith(first) or where == "page", where
        for line in found[0].report(full=where == "page").splitlines():
            assert line.strip() in text, (where, line)

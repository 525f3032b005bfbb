"""Tables and pages: complete in one file, escaped, and true to what was measured."""

import re

import pytest

from hyperflex.paper import READINGS, Claim
from hyperflex.report.page import Film, Picture, Section, TextTable, markdown, write_page
from hyperflex.report.player import player_html

PNG = b"\x89PNG\r\n\x1a\n"


def test_markdown_is_aligned_and_escapes_bars():
    text = markdown(TextTable(("a", "long name"), (("|x|", "1"), ("2", "3"))))
    assert text == "| a     | long name |\n|-------|-----------|\n| \\|x\\| | 1         |\n| 2     | 3         |"


def test_a_claim_may_bound_from_above():
    assert Claim("C9", "s", READINGS[0], 0.5, 1.0, relation="<=").holds
    assert not Claim("C9", "s", READINGS[0], 1.5, 1.0, relation="<=").holds


def test_a_page_is_one_file_that_escapes_and_fetches_nothing(tmp_path):
    table = TextTable(("name", "verdict"), (("<script>", "holds"),))
    sections = [Section("A & B", text=("x < y",), pictures=(Picture(PNG, 'say "cheese"'),), table=table, notes=("n",))]
    write_page(tmp_path / "page.html", "Title", "Lead", "simulated", sections)
    text = (tmp_path / "page.html").read_text("utf-8")
    assert "A &amp; B" in text
    assert "x &lt; y" in text
    assert "<script>" not in text
    assert 'class="good"' in text
    assert re.findall(r'(?:src|href)="(?!data:)', text) == []
    assert not re.search("https?:", text)


def test_on_a_phone_charts_scroll_and_other_pictures_fit(tmp_path):
    pictures = (Picture(PNG, "a chart"), Picture(PNG, "a strobe", chart=False))
    write_page(tmp_path / "page.html", "Title", "Lead", "simulated", [Section("A", pictures=pictures)])
    text = (tmp_path / "page.html").read_text("utf-8")
    assert re.findall(r'<figure( class="chart")?><img.*alt="(.*?)"', text) == [
        (' class="chart"', "a chart"),
        ("", "a strobe"),
    ]
    assert ".chart { overflow-x: auto; }" in text


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_a_page_keeps_to_itself_and_to_the_browsers_theme(browser, short_cast, tmp_path, dark):
    """Its policy lets nothing be fetched, and lets the player within it run; page and player are both light or dark.

    A browser may tell a frame the colours of its page after the scripts of the frame ran, so every theme is reported.
    """
    says = "const say = () => parent.postMessage([player.times.length, document.documentElement.dataset.theme], '*'); "
    says += "new MutationObserver(say).observe(document.documentElement, { attributes: true }); say();"
    film = player_html(short_cast, title="a cast", autoplay=False).replace("</body>", f"<script>{says}</script></body>")
    sections = [Section("A", verdict=(True, "fine"), pictures=(Film(film, "film"), Picture(PNG, "a chart")))]
    write_page(tmp_path / "page.html", "Title", "Lead", "simulated", sections)
    browser.open((tmp_path / "page.html").as_uri(), dark=dark)
    ground = "getComputedStyle(document.body).backgroundColor"
    assert browser.evaluate(ground) == ("rgb(12, 19, 34)" if dark else "rgb(244, 246, 249)")
    asked = "fetch('data:,x').then(() => 'fetched', () => 'refused')"
    assert browser.evaluate(asked) == "refused"
    theme = "dark" if dark else "light"
    wait = f"timer = setTimeout(() => done(data), data[1] === '{theme}' ? 300 : 20000)"  # ms; another may follow
    again = "document.querySelector('iframe').srcdoc += ' ';"
    heard = f"let timer; onmessage = ({{ data }}) => {{ clearTimeout(timer); {wait}; }}; {again}"
    assert browser.evaluate(f"new Promise((done) => {{ {heard} }})") == [short_cast.t.size, theme]

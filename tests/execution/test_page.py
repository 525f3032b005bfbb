"""The page of a run: its contents and its stop button."""

import json
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from urllib.request import Request, urlopen

import numpy as np
import pytest

from hyperflex.execution import MotionStream, RunPage
from tests.execution.ideal_link import ideal_drive
from tests.execution.test_run import short_plan


def test_the_page_shows_the_arm_and_the_phase(tmp_path: Path) -> None:
    with RunPage(short_plan()) as page, MotionStream(partial(ideal_drive, tmp_path / "notes")) as stream:
        seen = SimpleNamespace(spots=[(0.0, np.zeros((2, 2))), (0.1, np.ones((1, 2)))])
        page.attach(stream, lambda: None, seen)
        stream.enable()
        time.sleep(0.3)
        page.say("the cast runs")
        with urlopen(f"{page.address}state") as answer:
            shown = json.load(answer)
        with urlopen(page.address) as answer:
            assert b'id="stop"' in answer.read()
    assert (shown["motor"], shown["phase"]) == ("a drive", "the cast runs")
    assert shown["now"]["angle"] == pytest.approx(0.3)
    assert len(shown["past"]) > 5
    assert shown["markers"] == [[[1.0, 1.0]]]


def press(page: RunPage, answered: dict[str, bool]) -> None:
    """Press the stop button, keep the answer, and wait for the interrupt."""
    with urlopen(Request(f"{page.address}stop", method="POST")) as answer:
        answered.update(json.load(answer))
    time.sleep(5.0)


def test_the_stop_button_switches_the_torque_off_and_interrupts_the_program(tmp_path: Path) -> None:
    notes, confirmed = tmp_path / "notes", {}
    with RunPage(short_plan()) as page, MotionStream(partial(ideal_drive, notes)) as stream:
        page.attach(stream, lambda: None)
        stream.enable()
        with pytest.raises(KeyboardInterrupt):
            press(page, confirmed)
        assert notes.read_text().split()[-2:] == ["off", "closed"]
    assert confirmed in ({"off": True}, {})  # the interrupt may come before the answer is read

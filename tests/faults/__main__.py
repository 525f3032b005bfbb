"""Thousands of faults: every test of faults with many examples, every call and command interrupted at random times.

python -m tests.faults                         the nightly form; its table goes into docs/how-to/faults.md
python -m tests.faults --examples 0 --seeds 0  what the ordinary suite tries, printed alone
"""

import argparse
import json
import os
import re
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

import pytest

from tests.faults.counting import Tally

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "how-to" / "faults.md"
SECTION = re.compile(r"\n## Faults that are tested\n.*\Z", re.S)
PATHS = ("tests/faults", "tests/core/test_cache.py", "tests/test_bad_input.py", "tests/cli/test_bad_files.py")


def interrupt(tally: Tally, seeds: int) -> None:
    """Interrupt every call and every command at `seeds` random times."""
    words = [sys.executable, "-m", "tests.faults.interrupting", "--seeds", str(seeds)]
    with subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, text=True) as helper:
        assert helper.stdout
        for line in helper.stdout:
            name, _, told = line.partition("\t")
            wrong = json.loads(told)["faults"]
            sys.stdout.write(f"{line}\n" if wrong else f"{name}: as it should\n")
            sys.stdout.flush()
            kind = "commands: Ctrl-C or SIGTERM" if name.startswith("hyperflex ") else "calls of Python: Ctrl-C"
            tally.add(f"{kind} at random times", 1, bool(wrong))
    if helper.returncode:
        tally.add("the helper that sends signals", 1, 1)


def section(tally: Tally, asked: str, seconds: float) -> str:
    """Return the section of the page."""
    sys.path.insert(0, str(ROOT / "benchmarks"))
    import machine

    return (
        "\n## Faults that are tested\n\n"
        "`make nightly` tries these faults. It fails if one ends in a traceback, a crash, a hang, half a file, a lost "
        "result, or a partial result that is not marked as one. `make test` tries a part "
        f"of them, the same in each run.\n\n{tally.table()}\n\n{datetime.now(UTC):%Y-%m-%d}, {asked}, in "
        f"{seconds / 60.0:.0f} minutes. {machine.sentence(machine.describe())}\n"
    )


def main() -> int:
    """Try all, print the table, write it into the page; return 1 where a fault did not end as it should."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--examples", type=int, default=150, help="of each property test; 0: as in the ordinary suite")
    parser.add_argument(
        "--seeds", type=int, default=30, help="random times at which each call and command is interrupted"
    )
    chosen = parser.parse_args()
    if chosen.examples:
        os.environ["HYPERFLEX_FAULTS"] = str(chosen.examples)
    os.chdir(ROOT)
    tally, begin = Tally(), time.monotonic()
    status = pytest.main(["-q", "-p", "no:cacheprovider", *PATHS], plugins=[tally])
    if chosen.seeds:
        interrupt(tally, chosen.seeds)
    sys.stdout.write(f"\n{tally.table()}\n")
    if chosen.examples and chosen.seeds:
        asked = f"{chosen.examples} examples of each property, each call and command interrupted {chosen.seeds} times"
        text = SECTION.sub("", PAGE.read_text("utf-8"))
        PAGE.write_text(text + section(tally, asked, time.monotonic() - begin), "utf-8")
    return int(status != pytest.ExitCode.OK or tally.wrong.total() > 0)


if __name__ == "__main__":
    sys.exit(main())

"""Write docs/cli.md from what the commands print under ``--help``: ``python docs/generate_cli.py``."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

PAGE = Path(__file__).parent / "cli.md"
HEAD = """\
# Command line

Every command takes `--json`: it then prints one JSON object on standard output and nothing else there. Progress and
complaints go to standard error. A command that fails prints `{"error": ..., "type": ...}` under `--json`; Ctrl-C and
SIGTERM give `"error": "interrupted"` ([Interruptions](how-to/faults.md#interruption)).

Exit codes: 0 done, 1 a bug in hyperflex (with a traceback on standard error), 2 refused or failed with a message, 3 the
fit of `identify` did not converge (the rope is written and marked so), 4 `cast` found no throw that winds and holds, or
`whip` or `insert` no strokes that do what is asked (the best is written, with the reason), 5 a fit that is not to be
used, 130 and 143 interrupted by Ctrl-C and by SIGTERM (what was done is kept, and marked so). Files, and the folders of
`identify`, `cast`, `whip`, `insert`, `reproduce` and `demo`, are written whole or not at all; an output that is one of
the inputs is refused.

This page is what `--help` prints (`python docs/generate_cli.py` writes it).
"""


def help_of(*command: str) -> str:
    """Return what ``hyperflex COMMAND --help`` prints, 96 columns wide."""
    code = "import sys; sys.argv[0] = 'hyperflex'; from hyperflex.cli import main; main()"
    plain = os.environ | {"COLUMNS": "96", "NO_COLOR": "1", "TERM": "dumb"}
    call = [sys.executable, "-c", code, *command, "--help"]
    text = subprocess.run(call, env=plain, capture_output=True, text=True, check=True).stdout
    return "\n".join(line.rstrip() for line in text.strip().splitlines())


def page() -> str:
    """Return the whole page."""
    from hyperflex.cli.app import app

    parts = [HEAD, f"```text\n{help_of()}\n```\n"]
    for command in app.registered_commands:
        name = command.name or command.callback.__name__.replace("_", "-")
        parts.append(f"## hyperflex {name}\n\n```text\n{help_of(name)}\n```\n")
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

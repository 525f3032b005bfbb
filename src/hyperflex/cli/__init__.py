"""The command line: each command parses its arguments, makes one call and prints the result, or prints it as JSON."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command line and exit with its code: 0 done, 2 refused or failed with a message, 130 interrupted."""
    from hyperflex.cli.app import run

    sys.exit(run(sys.argv[1:]))

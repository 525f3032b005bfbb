"""The command line: each command parses its arguments, makes one call and prints the result, or prints it as JSON."""

import signal
import sys

from hyperflex import interruption


def main() -> None:
    """Run the command line and exit with its code, see :func:`hyperflex.cli.app.run`."""
    try:
        with interruption.handle_signals(signal.SIGTERM), interruption.deferred():  # half loaded, nothing can be said
            from hyperflex.cli.app import run

        code = run(sys.argv[1:])
    except KeyboardInterrupt:  # while the program was still being loaded, or for the second time
        sys.stderr.write("hyperflex: Interrupted.\n")
        if "--json" in sys.argv:
            sys.stdout.write('{"error": "interrupted", "type": "Interrupted"}\n')
        code = 128 + interruption.number()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # all output is complete: nothing can be interrupted
    exec("")  # clears Python's mark of an interrupt in some exec, for which it would end by SIGINT in place of the code
    sys.exit(code)

"""MkDocs hook: pages that are made while the site is built, from the commands' help and from a benchmark's results."""

from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parents[1] / "benchmarks" / "results" / "wrong-input.md"
WIDTH = 96  # characters of a line of help
HEAD = """\
# Command line

Every command takes `--json`: it then prints one JSON object on standard output and nothing else there. Progress and
messages go to standard error. A result has `success`, `status` and `warnings`. A command that fails prints `error`, the
message, and its `type` as well; Ctrl-C and SIGTERM give `"error": "interrupted"` ([Interruptions](how-to/faults.md)).

| exit code | meaning |
|---|---|
| 0 | success |
| 1 | a bug in hyperflex, with a traceback on standard error |
| 2 | an error, with a message |
| 3 | the fit of `identify` did not converge, or the time of it or of `simulate` was over; the result is marked |
| 4 | no plan of `cast`, `whip` or `insert` succeeded; the best is written with the reason |
| 5 | the result of `identify` must not be used |
| 130, 143 | interrupted by Ctrl-C, by SIGTERM; what was complete is kept and marked |

Files, and the folders of `identify`, `cast`, `whip`, `insert`, `reproduce` and `demo`, are written whole or not at all;
an output that is one of the inputs is refused.
"""


def on_files(files: Any, config: Any) -> Any:
    """Add the pages to the site's files."""
    from mkdocs.structure.files import File

    pages = {"cli.md": command_line(), "wrong-input.md": RESULTS.read_text("utf-8")}
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    return files


def command_line() -> str:
    """Return the page with the help of each command."""
    import typer

    from hyperflex.cli.app import app

    group: Any = typer.main.get_command(app)
    context = group.context_class(group, info_name="hyperflex", terminal_width=WIDTH)
    parts = [HEAD, f"```text\n{group.get_help(context)}\n```\n"]
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        own = command.context_class(command, info_name=f"hyperflex {name}", terminal_width=WIDTH)
        parts.append(f"## hyperflex {name}\n\n```text\n{command.get_help(own)}\n```\n")
    return "\n".join(parts)

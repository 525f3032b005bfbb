"""``hyperflex play``: a page in the browser to swing, cast and look, live."""

import contextlib
import sys
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from hyperflex.cli import output
from hyperflex.errors import InvalidInput


def play(
    setup: Annotated[
        Path | None, typer.Argument(help="TOML file of a set-up or a plan to begin with. [default: the paper's cable]")
    ] = None,
    folder: Annotated[
        Path, typer.Option("--folder", "-f", help="What the page may read from and save to, and nothing else.")
    ] = Path(),
    port: Annotated[int, typer.Option(help="Port of the page; 0: any that is free.")] = 0,
    host: Annotated[str, typer.Option(help="Address to listen at; by default this machine alone.")] = "127.0.0.1",
    allow: Annotated[
        list[str] | None,
        typer.Option(help="A further host:port by which browsers may ask, several times; others get 403."),
    ] = None,
    no_open: Annotated[bool, typer.Option("--no-open", help="Print the address, but open no browser.")] = False,
    json: output.Json = False,
) -> None:
    """Swing, cast and look in the browser, live: drag the target, change rope and arm, plan, scrub what was seen.

    Ctrl-C ends it. Planning runs in a process of its own. The page asks nothing of any other host, and is given to
    this machine alone unless --host and --allow say otherwise: whoever it is given to can save files in the folder.
    """
    from hyperflex.model import Setup
    from hyperflex.planning import read_limits
    from hyperflex.play import Folder, PlayServer, Session

    if setup is not None and setup.suffix.lower() == ".nc":
        fix = f"See a run with hyperflex view {setup}; in the page, Open takes one from the folder"
        raise InvalidInput("play begins with a set-up", got=str(setup), allowed="a TOML file", fix=fix)
    session = Session()
    if setup is not None:
        session.play(Setup.from_toml(setup), "file", limits=read_limits(setup))
    with PlayServer(Folder(folder), session, port=port, host=host, allow=allow or ()) as server:
        cable = f"the paper's cable ({session.scene()['rope']}); hyperflex play SETUP.toml shows another"
        shown = setup or cable
        sys.stderr.write(f"hyperflex: at {server.address}; Ctrl-C ends it. It shows {shown}\n")
        if json:
            output.print_json({"address": server.address, "port": server.port, "folder": folder}, one_line=True)
        if not no_open:
            with contextlib.suppress(webbrowser.Error):
                webbrowser.open(server.address)
        server.wait()

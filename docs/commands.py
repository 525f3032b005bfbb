"""What a page of the documentation tells its reader to do: files to write and commands to run."""

import re
import shlex
from pathlib import Path


def settings(page: Path) -> list[str]:
    """Return the TOML files of a page, in order."""
    return re.findall(r"^```toml\n(.*?)^```", page.read_text("utf-8"), re.M | re.S)


def commands(page: Path) -> list[list[str]]:
    """Return the arguments of each command in a page's blocks of the language ``shell``, without the program's name."""
    blocks = re.findall(r"^```shell\n(.*?)^```", page.read_text("utf-8"), re.M | re.S)
    return [shlex.split(line)[1:] for block in blocks for line in block.splitlines()]

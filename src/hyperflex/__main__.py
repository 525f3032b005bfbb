"""``python -m hyperflex``: the command line."""

from hyperflex.cli import main

if __name__ == "__main__":
    main()

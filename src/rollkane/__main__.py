"""The command line, as ``python -m rollkane``."""

from .cli import main

if __name__ == "__main__":
    main()

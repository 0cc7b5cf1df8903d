"""``python -m sassgis`` is the command line."""

from sassgis.cli import main

if __name__ == "__main__":
    main()

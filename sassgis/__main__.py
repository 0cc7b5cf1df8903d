"""``python -m sassgis`` is the command line."""

import sys
from pathlib import Path

if __name__ == "__main__":
    # Python looks for modules in the current folder first, which may be anybody's project.
    here = Path.cwd()
    if not sys.flags.safe_path and here != Path(__file__).resolve().parent.parent:
        sys.path[:1] = [folder for folder in sys.path[:1] if Path(folder) != here]

    from sassgis.cli import main

    main()

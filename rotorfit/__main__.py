"""The command line as a process of its own: the script ``rotorfit`` and ``python -m rotorfit``."""

from __future__ import annotations

import gc


def main() -> int:
    """Run the command line of this process. Returns the exit code."""
    # New objects after which Python looks for unused ones, in place of 700. Nearly all that imports and drawing make
    # stays: looking through it again and again takes a tenth of a fit's time.
    gc.set_threshold(100_000)
    from rotorfit.cli.main import main as run

    try:
        return run()
    finally:
        gc.freeze()  # the process ends: its memory goes as a whole, not object by object


if __name__ == "__main__":
    raise SystemExit(main())

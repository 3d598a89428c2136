"""``python -m rotorfit`` is the same as ``rotorfit``."""

from rotorfit.cli.main import main

if __name__ == "__main__":
    raise SystemExit(main())

"""``python -m ppt_rl``: the command ``ppt-rl``."""

from ppt_rl.cli import main

if __name__ == "__main__":
    main()

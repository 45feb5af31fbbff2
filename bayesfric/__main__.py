"""``python -m bayesfric``."""

from bayesfric.commands.cli import main

# the processes of a fleet import this, under another name
if __name__ == "__main__":
    main()

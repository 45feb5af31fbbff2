"""``python -m bayesfric``."""

from bayesfric.cli import main

main()

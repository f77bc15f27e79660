"""``python -m bayes_impedance`` is the command ``bayes-impedance``."""

import sys

from bayes_impedance.commands.cli import main

if __name__ == "__main__":  # worker processes import this module, too
    sys.exit(main())

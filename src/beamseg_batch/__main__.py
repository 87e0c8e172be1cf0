"""``python -m beamseg_batch`` is the command ``beamseg``."""

from beamseg_batch.cli.main import main

if __name__ == "__main__":
    main()

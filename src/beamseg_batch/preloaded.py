"""What every worker process has at hand from its first moment on.

Imported by the process that they are forked from, and by nothing else: it loads the
compiled search once for all of them.
"""

import gc

from beamseg_batch.config import RunConfig
from beamseg_batch.warming import warm_up

__all__: list[str] = []

warm_up(RunConfig())
gc.freeze()  # so that collecting garbage does not copy memory that the workers share
